"""`template` in all its forms: shared or ray by ray, RGBA or linear, samples, masks, threads."""

from __future__ import annotations

from fractions import Fraction

import numba
import numpy as np
import pytest

from inim.display import DISPLAYS, Display
from inim.errors import UsageError
from inim.generators import HOLE, find_sources, generate, prepare
from inim.generators.base import MASKED, NO_LENS
from inim.generators.raycast.columns import SOLID, SURFACE
from inim.generators.raycast.direction_lists import shares_directions
from inim.generators.raycast.non_integer_pitch import NonIntegerPitch
from inim.generators.raycast.ray_by_ray import AxisRuns, RayByRay, doubtful_pixels
from inim.generators.raycast.shared_directions import SharedDirections
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.image.rgbd import RGBD
from tests import oracle
from tests.conftest import small_display


def picture(display: Display, per_pitch: int, *, rgba: bool = False, seed: int = 1) -> RGBD:
    """A smooth relief with spikes, holes and random colours over a display's whole range."""
    rows, columns = display.capture_shape(per_pitch)
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:rows, :columns] / max(rows, columns)
    low, high = display.depth_range_mm
    relief = 0.5 + 0.35 * np.sin(9 * x) * np.cos(7 * y)
    relief = np.where(random.random((rows, columns)) < 0.03, random.random((rows, columns)), relief)
    depth = low + (high - low) * relief
    covered = (np.hypot(x - 0.5, y - 0.45) < 0.35) & (random.random((rows, columns)) < 0.98)
    if rgba:
        color = random.integers(1, 256, (rows, columns, 4), dtype=np.uint8)
    else:
        color = random.random((rows, columns, 3), dtype=np.float32)
    return RGBD(color, depth, covered, float(Fraction(display.pitch_mm) / per_pitch))


VIRTUAL = {"focal_length_mm": 3.3, "gap_mm": 3.0}
STRADDLING = {"depth_min_mm": -9.0, "depth_max_mm": 11.0}


@pytest.mark.parametrize("per_pitch", [1, 2, 4, 5])
@pytest.mark.parametrize("lenses", [(1, 1), (7, 5), (50, 3), (97, 2)])
@pytest.mark.parametrize("pixels", [7, 8])
@pytest.mark.parametrize("mode", [{}, VIRTUAL, STRADDLING], ids=["real", "virtual", "straddling"])
@pytest.mark.parametrize("rule", [SURFACE, SOLID])
def test_lists_shared_by_all_lenses_give_every_ray_its_own_source(
    per_pitch, lenses, pixels, mode, rule
):
    display = small_display(*lenses, pixels=pixels, **mode)
    rgbd = picture(display, per_pitch)
    shared = SharedDirections(display, rgbd.shape, rgbd.pixel_mm, rule)
    alone = RayByRay(display, rgbd.shape, rgbd.pixel_mm, rule)
    assert np.array_equal(shared.sources(rgbd), alone.sources(rgbd))


@pytest.mark.parametrize("per_pitch", [1, 2, 5])
@pytest.mark.parametrize("lenses", [(1, 1), (7, 5), (81, 3), (163, 2)])
@pytest.mark.parametrize("pixel_mm", [0.0636, 1 / 8, 1 / 7, 0.21])
@pytest.mark.parametrize("mode", [{}, VIRTUAL, STRADDLING], ids=["real", "virtual", "straddling"])
@pytest.mark.parametrize("rule", [SURFACE, SOLID])
def test_non_integer_pitch_gives_every_ray_its_own_source(per_pitch, lenses, pixel_mm, mode, rule):
    """Any pixel ratio, whole ones among them: every corner is a tie there."""
    display = small_display(*lenses, pixel_pitch_mm=pixel_mm, **mode)
    rgbd = picture(display, per_pitch)
    found = NonIntegerPitch(display, rgbd.shape, rgbd.pixel_mm, rule)
    alone = RayByRay(display, rgbd.shape, rgbd.pixel_mm, rule)
    assert np.array_equal(found.sources(rgbd), alone.sources(rgbd))


@pytest.mark.parametrize(
    "changes",
    [
        {"elemental_pitch_mm": 1.013},
        {"elemental_pitch_mm": 0.99, "pixel_pitch_mm": 0.07},
        {"panel_columns": 70, "panel_rows": 40},
        {"panel_columns": 140, "panel_rows": 111},
    ],
)
def test_non_integer_pitch_serves_panels_and_elemental_images_of_any_size(changes):
    display = small_display(12, 10, **changes)
    rgbd = picture(display, 4)
    found = NonIntegerPitch(display, rgbd.shape, rgbd.pixel_mm, SURFACE)
    alone = RayByRay(display, rgbd.shape, rgbd.pixel_mm, SURFACE)
    assert np.array_equal(found.sources(rgbd), alone.sources(rgbd))


def test_exits_that_float32_cannot_order_are_walked_in_float64():
    """Two borders met 1e-8 mm apart: one float32, two depths; the ray is found and done apart."""
    rows = AxisRuns(np.array([0, 2]), np.array([0, 1]), np.array([20.0, 10.0]))
    near, same = 20.0 - 1e-8, 20.0
    for exit_mm, doubtful in ((near, [0]), (same, []), (21.0, [])):
        columns = AxisRuns(np.array([0, 2]), np.array([0, 1]), np.array([exit_mm, 10.0]))
        assert np.flatnonzero(doubtful_pixels(rows, columns)).tolist() == doubtful


def test_a_prepared_generator_forgets_the_picture_before():
    display = small_display()
    one, other = (picture(display, 4, seed=s) for s in (1, 2))
    made = prepare(display, shape=one.shape, pixel_mm=one.pixel_mm)
    first = made.generate(one)
    made.generate(other)
    nothing = RGBD(one.color, one.depth_mm, np.zeros(one.shape, bool), one.pixel_mm)
    assert not made.generate(nothing).any()
    assert np.array_equal(made.generate(one), first)


def test_a_picture_smaller_than_the_array_leaves_the_rest_empty():
    display = small_display(60, 9)
    whole = picture(display, 2)
    inner = RGBD(
        whole.color[6:-6, 40:-40], whole.depth_mm[6:-6, 40:-40], whole.covered[6:-6, 40:-40], 0.5
    )
    shared = SharedDirections(display, inner.shape, 0.5, SURFACE)
    alone = RayByRay(display, inner.shape, 0.5, SURFACE)
    assert np.array_equal(shared.sources(inner), alone.sources(inner))


@pytest.mark.parametrize("display", [small_display(20, 9), DISPLAYS["phone"]], ids=["17", "15.7"])
def test_rgba_shows_the_same_sources_with_alpha_0_where_there_is_none(display):
    rgbd = picture(display, 2, rgba=True)
    sources = find_sources(rgbd, display)
    shown = generate(rgbd, display)
    assert shown.dtype == np.uint8 and shown.shape == (*display.eia_shape, 4)
    hit = sources >= 0
    assert np.array_equal(shown[hit], rgbd.color.reshape(-1, 4)[sources[hit]])
    assert not shown[~hit].any()
    assert (shown[hit][:, 3] > 0).all() and (sources == HOLE).any()


def test_out_is_filled_and_returned_and_a_wrong_one_refused():
    display = small_display()
    for rgba in (False, True):
        rgbd = picture(display, 2, rgba=rgba)
        out = np.full((*display.eia_shape, 4 if rgba else 3), 77, rgbd.color.dtype)
        assert generate(rgbd, display, out=out) is out
        assert np.array_equal(out, generate(rgbd, display))
        for wrong in (out[:-1], out.astype(np.float64), out[:, ::-1], np.asfortranarray(out)):
            with pytest.raises(UsageError, match="out"):
                generate(rgbd, display, out=wrong)


def test_threads_change_nothing():
    display = small_display(53, 17)
    rgbd = picture(display, 4, rgba=True)
    before = numba.get_num_threads()
    try:
        results = []
        for threads in {1, before}:
            numba.set_num_threads(threads)
            results.append(generate(rgbd, display))
    finally:
        numba.set_num_threads(before)
    assert all(np.array_equal(r, results[0]) for r in results)


A = Fraction(1, 4)
# Centres of the quarters of a pixel, (down, right) of its centre, in pixels.
PLACES = {2: [(-A, -A), (A, A)], 4: [(-A, -A), (-A, A), (A, -A), (A, A)]}


@pytest.mark.parametrize("samples", [2, 4])
@pytest.mark.parametrize("mode", [{}, VIRTUAL, {"pixel_pitch_mm": 0.0636}])
def test_samples_are_the_mean_of_rays_through_the_pixel_s_quarters(samples, mode, monkeypatch):
    """Against the exact oracle, its rays moved inside their pixels, their lenses kept."""
    display = small_display(4, 3, **mode)
    rgbd = picture(display, 4)
    palette = np.concatenate([rgbd.color.reshape(-1, 3), np.zeros((1, 3), np.float32)])
    expected = np.zeros((*display.eia_shape, 3))
    still = oracle.all_rays
    step = oracle.stated(display.pixel_pitch_mm) / oracle.stated(display.gap_mm)
    for down, right in PLACES[samples]:

        def moved(rgbd, display, down=down, right=right):
            rows, columns = still(rgbd, display)
            cell = oracle.stated(rgbd.pixel_mm)
            return tuple(
                oracle.Rays(r.lens, r.start, [s - by * step / cell for s in r.slope])
                for r, by in ((rows, down), (columns, right))
            )

        monkeypatch.setattr(oracle, "all_rays", moved)
        sources = oracle.exact_sources(rgbd, display)
        expected += palette[np.where(sources >= 0, sources, len(palette) - 1)] / samples
    shown = generate(rgbd, display, f"template:samples={samples}")
    assert np.abs(shown - expected).max() < 1e-6


def test_samples_average_light_not_code_values():
    display = small_display(4, 4)
    rgbd = picture(display, 4, rgba=True)
    linear = linear_from_srgb(rgbd.color[..., :3] / np.float32(255))
    bright = RGBD(linear, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
    coded = generate(rgbd, display, samples=4)[..., :3] / 255
    assert (
        np.abs(coded - srgb_from_linear(generate(bright, display, samples=4))).max()
        < 0.5 / 255 + 1e-4
    )


@pytest.mark.parametrize("samples", [2, 4])
def test_codes_are_those_of_the_mean_light_to_the_last_bit(samples):
    """Against the colour module's own formulas on every pixel's rays; alpha is no light."""
    display = small_display(6, 5)
    rgbd = picture(display, 4, rgba=True)
    covered = rgbd.covered & (np.arange(rgbd.shape[1]) < rgbd.shape[1] // 2)  # or few rays agree
    rgbd = RGBD(rgbd.color, rgbd.depth_mm, covered, rgbd.pixel_mm)
    made = prepare(display, f"template:samples={samples}", shape=rgbd.shape, pixel_mm=rgbd.pixel_mm)
    sources = made.samples(rgbd)
    palette = np.append(rgbd.color.reshape(-1, 4), np.zeros((1, 4), np.uint8), axis=0)
    codes = palette[np.where(sources >= 0, sources, -1)] / np.float32(255)
    light = np.concatenate([linear_from_srgb(codes[..., :3]), codes[..., 3:]], axis=-1)
    mean = light[0] / np.float32(samples)
    for ray in light[1:]:
        mean = mean + ray / np.float32(samples)
    expected = np.append(srgb_from_linear(mean[..., :3]), mean[..., 3:], axis=-1)
    shown = made.generate(rgbd)
    assert np.array_equal(shown, srgb_to_uint8(expected))
    agree = (sources == sources[0]).all(axis=0)
    assert 0.1 < agree.mean() < 0.9, "or the test says nothing"
    assert np.array_equal(shown[agree], palette[np.where(sources[0] >= 0, sources[0], -1)][agree])


def test_sources_of_several_samples_are_those_of_the_centres():
    display = small_display()
    rgbd = picture(display, 3)
    assert np.array_equal(find_sources(rgbd, display, samples=4), find_sources(rgbd, display))


@pytest.mark.parametrize("display", [small_display(20, 9), DISPLAYS["phone"]], ids=["17", "15.7"])
def test_a_mask_finds_just_its_pixels(display):
    rgbd = picture(display, 2)
    mask = np.random.default_rng(4).random(display.eia_shape) < 0.03
    found = find_sources(rgbd, display, mask=mask)
    everything = find_sources(rgbd, display)
    assert np.array_equal(found[mask], everything[mask])
    rest = found[~mask]
    assert set(np.unique(rest)) <= {MASKED, NO_LENS}
    assert not generate(rgbd, display, mask=mask)[~mask].any()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"samples": 3}, "samples = 3"),
        ({"samples": "many"}, "samples = 'many'"),
        ({"smaples": 4}, "no option 'smaples'; its options are samples"),
    ],
)
def test_wrong_options_are_named(options, words):
    display = small_display()
    with pytest.raises(UsageError, match=words):
        generate(picture(display, 2), display, **options)


def test_a_picture_of_another_size_is_refused():
    display = small_display()
    made = prepare(display, shape=(40, 50), pixel_mm=0.5)
    with pytest.raises(UsageError, match="prepared for 40 x 50"):
        made.generate(picture(display, 2))


def test_only_arrays_with_parallel_pixels_share_lists():
    assert shares_directions(DISPLAYS["nominal"])
    assert not shares_directions(DISPLAYS["phone"])
    converging = small_display(pixels=8, elemental_pitch_mm=1.001)
    assert not shares_directions(converging)
