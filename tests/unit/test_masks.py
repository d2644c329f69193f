"""With a pixel mask, generators show in its pixels what they show in full, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from inim.display import DISPLAYS, Display
from inim.errors import UsageError
from inim.generators import (
    HOLE,
    MASKED,
    NO_LENS,
    Algorithm,
    algorithm_summary,
    find_sources,
    generate,
    hole_fraction,
    prepare,
)
from inim.generators.base import PixelList
from inim.generators.raycast.cells import cell_rays
from inim.generators.raycast.columns import SURFACE, columns_of
from inim.generators.raycast.ray_by_ray import RayByRay, first_hit
from inim.generators.template import ray_by_ray
from inim.image.rgbd import RGBD, Layer, LayeredRGBD
from inim.pipeline.stages.plugin_guard import run_generator
from tests.conftest import small_display

ALGORITHMS = [
    "template",
    "template:samples=4",
    "layered:samples=1",
    "layered:samples=2",
    "gu2020",
    "wang2024",
    "wang2024:matching=ray",
    "li2012:fill=hidden",
    "template:samples=2:fill=all",
]
SEPARABLE = [
    {},
    {"focal_length_mm": 3.3, "gap_mm": 3.0},
    {"pixel_pitch_mm": 0.0636},
    {"elemental_pitch_mm": 1.013},
    {"panel_columns": 70, "panel_rows": 101, "pixel_pitch_mm": 0.0636},
    {"subpixels": "rgb-stripe"},
    {"subpixels": "pentile", "pixel_pitch_mm": 0.09, "shift_x_mm": 0.3},
]
OTHERS = [
    {"rotation_deg": 3.0},
    {"lattice": "hexagonal", "subpixels": "rgb-stripe"},
    {"tilt_x_deg": 1.0, "shift_y_mm": 0.2},
]
ANYWHERE = ("template", "template:samples=4", "layered:samples=1", "layered:samples=2", "gu2020")


@st.composite
def cases(draw):
    """An algorithm, a display that it serves, a picture and a mask."""
    algorithm = draw(st.sampled_from(ALGORITHMS))
    changes = draw(st.sampled_from(SEPARABLE + (OTHERS if algorithm in ANYWHERE else [])))
    columns, rows = draw(st.integers(1, 45)), draw(st.integers(1, 5))
    display = small_display(columns, rows, draw(st.integers(3, 9)), **changes)
    rgbd = noise(display, draw(st.integers(1, 4)), draw(st.integers(0, 99)), draw(st.booleans()))
    if algorithm.startswith("layered") and draw(st.booleans()):
        rgbd = with_a_layer_behind(rgbd, display)
    return algorithm, display, rgbd, draw_mask(draw, display)


def noise(display: Display, per_pitch: int, seed: int, coded: bool) -> RGBD:
    """Random colours at random depths, a third of the pixels empty."""
    random = np.random.default_rng(seed)
    shape = display.capture_shape(per_pitch)
    color = random.integers(1, 256, (*shape, 4 if coded else 3)).astype(np.uint8)
    return RGBD(
        color if coded else color / np.float32(255),
        random.uniform(*display.depth_range_mm, shape).astype(np.float32),
        random.random(shape) < 0.67,
        display.pitch_mm / per_pitch,
    )


def with_a_layer_behind(rgbd: RGBD, display: Display) -> LayeredRGBD:
    """Fronts a tenth of the range deep, and a second surface behind half of them, all the way."""
    random = np.random.default_rng(rgbd.shape[0])
    low, high = display.depth_range_mm
    back = rgbd.depth_mm - np.float32((high - low) / 10)
    covered = rgbd.covered & (random.random(rgbd.shape) < 0.5)
    behind = Layer(rgbd.color[::-1, ::-1], back, np.full_like(back, -np.inf), covered)
    return LayeredRGBD(rgbd.color, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm, back, (behind,))


def draw_mask(draw, display: Display) -> np.ndarray:
    """Nothing, everything, scattered pixels, or stretches of a row as an eye sees them."""
    random = np.random.default_rng(draw(st.integers(0, 99)))
    kind = draw(st.sampled_from(["share", "drift"]))
    if kind == "share":
        share = draw(st.sampled_from([0.0, 0.02, 0.3, 1.0]))
        return random.random(display.eia_shape) < share
    mask = np.zeros(display.eia_shape, bool)
    row = np.arange(display.eia_shape[0]) * random.integers(1, 7) % display.eia_shape[0]
    mask[row[: 1 + len(row) // 3]] = random.random(display.eia_shape[1]) < 0.5
    return mask


@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(cases())
def test_pixels_of_a_mask_are_those_of_the_whole_panel(case):
    check_masked(*case)


@pytest.mark.slow
@settings(deadline=None, max_examples=500, suppress_health_check=[HealthCheck.too_slow])
@given(cases())
def test_pixels_of_a_mask_are_those_of_the_whole_panel_in_hundreds_of_cases(case):
    check_masked(*case)


def check_masked(algorithm: str, display: Display, rgbd: RGBD, mask: np.ndarray) -> None:
    whole = generate(rgbd, display, algorithm)
    made = prepare(display, algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm, mask=mask)
    for out in (None, np.full_like(whole, 7)):
        shown = made.generate(rgbd, out)
        assert out is None or shown is out
        assert shown.dtype == whole.dtype and shown.shape == whole.shape
        assert np.array_equal(shown[mask], whole[mask])
        assert not shown[~mask].any()
    sources, asked = find_sources(rgbd, display, algorithm), made.sources(rgbd)
    assert np.array_equal(asked[mask], sources[mask])
    assert np.array_equal(asked[~display.lensed], sources[~display.lensed])
    assert (asked[~mask & display.lensed] == MASKED).all()


@pytest.mark.parametrize("name", ["nominal", "phone"])
def test_an_eye_s_pixels_on_the_real_displays(name):
    """One pixel under every lens, drifting; both forms of the exact path, a stream of pictures."""
    display = DISPLAYS[name]
    mask = np.ix_(_seen(display.rows, -20.0, display), _seen(display.columns, 35.0, display))
    asked = np.zeros(display.eia_shape, bool)
    asked[mask] = True
    assert 0.002 < asked.mean() < 0.005
    made = prepare(display, shape=display.capture_shape(2), pixel_mm=0.5, mask=asked)
    for seed in (1, 2):
        rgbd = noise(display, 2, seed, coded=False)
        alone = ray_by_ray(display, rgbd.shape, rgbd.pixel_mm).sources(rgbd)
        assert np.array_equal(made.sources(rgbd)[asked], alone[asked])


def _seen(axis, eye_mm: float, display: Display, distance_mm: float = 400.0) -> np.ndarray:
    """Panel pixels of an axis that an eye sees through lens centres."""
    x = axis.centre_mm - (eye_mm - axis.centre_mm) * display.gap_mm / distance_mm
    off = np.abs(axis.position_mm - x)
    return np.flatnonzero((off <= display.pixel_pitch_mm / 2) & (axis.lens >= 0))


@pytest.mark.parametrize("masked", [False, True])
def test_a_picture_leaves_nothing_for_the_next(masked):
    """What a generator holds of one picture, or form of it, does not show in another's EIA."""
    display = small_display(20, 6, 5)
    mask = np.random.default_rng(1).random(display.eia_shape) < 0.4 if masked else None
    plain = [noise(display, 2, seed, coded=False) for seed in range(3)]
    coded = [noise(display, 2, seed, coded=True) for seed in range(3)]
    pictures = [plain[0], plain[1], coded[0], coded[1], plain[2], coded[2], plain[2]]
    grid = {"shape": plain[0].shape, "pixel_mm": plain[0].pixel_mm}
    made = prepare(display, mask=mask, **grid)
    for rgbd in pictures:
        alone = prepare(display, mask=mask, **grid)
        assert np.array_equal(made.generate(rgbd), alone.generate(rgbd))
        assert np.array_equal(made.sources(rgbd), alone.sources(rgbd))


def test_a_surface_that_all_rays_start_behind_is_hit_by_all():
    """Runs above the nearest surface are passed over, but never a ray's last one."""
    display = small_display(6, 5, 7)
    far = np.full(display.capture_shape(3), display.depth_range_mm[0], np.float32)
    covered = np.ones(far.shape, bool)
    rgbd = RGBD(np.ones((*far.shape, 3), np.float32), far, covered, 1 / 3)
    listed = RayByRay(display, far.shape, 1 / 3, SURFACE, pixels=PixelList.of(display.lensed))
    assert np.array_equal(listed.sources(rgbd)[0], find_sources(rgbd, display).ravel())
    nothing = RGBD(rgbd.color, far, ~covered, 1 / 3)
    assert (listed.sources(nothing) == HOLE).all()


@pytest.mark.parametrize("name", ["nominal", "phone"])
def test_rays_over_the_runs_of_their_axes_hit_what_they_hit_walked_alone(name):
    """`first_hit` computes every border afresh, for each ray."""
    display = DISPLAYS[name]
    rgbd = noise(display, 2, 4, coded=False)
    found = ray_by_ray(display, rgbd.shape, rgbd.pixel_mm).sources(rgbd)
    across, down = cell_rays(rgbd.shape, rgbd.pixel_mm, display)
    columns = columns_of(rgbd, SURFACE)
    met = (columns.fronts(), columns.backs(), columns.continue_behind)
    random = np.random.default_rng(1)
    lensed = np.flatnonzero(display.lensed)
    for i, j in zip(*np.divmod(random.choice(lensed, 2000), found.shape[1]), strict=True):
        ray = (across.start[j], across.slope[j], across.scale)
        ray += (down.start[i], down.slope[i], down.scale)
        assert found[i, j] == first_hit(*met, *ray, *display.depth_range_mm)


def test_a_hole_counts_among_the_pixels_asked_for_only():
    display = small_display(9, 4, 5)
    rgbd = noise(display, 2, 3, coded=False)
    whole = find_sources(rgbd, display)
    mask = (whole == HOLE) | (np.arange(whole.size).reshape(whole.shape) % 3 == 0)
    asked = find_sources(rgbd, display, mask=mask)
    share = np.count_nonzero(whole == HOLE) / np.count_nonzero(mask & display.lensed)
    assert hole_fraction(asked) == share > hole_fraction(whole)
    made = prepare(display, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm, mask=mask)
    eia, _, empty = run_generator("template", made, rgbd, display, mask)
    assert np.array_equal(empty, mask & (whole < 0))
    assert np.array_equal(eia, made.generate(rgbd))


class Bright:
    """A generator by others, without a mask and with one place to write to."""

    def __init__(self, display: Display) -> None:
        self.place = np.ones((*display.eia_shape, 3), np.float32)

    def generate(self, rgbd, out=None):
        return self.place


def test_a_generator_that_knows_no_mask_is_run_in_full(monkeypatch):
    def prepare_bright(display, shape, pixel_mm):
        return Bright(display)

    monkeypatch.setattr(
        "inim.generators.find_algorithm", lambda name: Algorithm(name, prepare_bright, own=False)
    )
    display = small_display(5, 4, 3)
    mask = np.random.default_rng(1).random(display.eia_shape) < 0.4
    made = prepare(display, "bright", shape=(8, 10), pixel_mm=0.5, mask=mask)
    rgbd = noise(display, 2, 1, coded=False)
    assert np.array_equal(made.generate(rgbd), np.repeat(mask[..., None], 3, axis=-1))
    assert np.array_equal(
        run_generator("bright", made, rgbd, display, mask)[0], made.generate(rgbd)
    )
    assert made._whole.place.all()


@pytest.mark.parametrize(
    "mask",
    [np.ones((3, 3), bool), np.ones(small_display().eia_shape, np.uint8)],
    ids=["shape", "type"],
)
@pytest.mark.parametrize("algorithm", ["template", "li2012"])
def test_what_is_no_mask_of_the_panel_is_refused(mask, algorithm):
    display = small_display()
    with pytest.raises(UsageError, match=r"it must be bool of the panel's \(80, 96\)"):
        prepare(display, algorithm, shape=(4, 4), pixel_mm=1.0, mask=mask)


def test_a_mask_is_no_option_of_an_algorithm():
    display = small_display()
    assert "mask" not in algorithm_summary("template")[0]
    with pytest.raises(UsageError, match="has no option 'mask'"):
        prepare(display, "template:mask=all", shape=(4, 4), pixel_mm=1.0)


def test_what_is_beside_the_array_is_never_shown():
    display = small_display(5, 4, 7, panel_columns=50, panel_rows=40)
    mask = np.ones(display.eia_shape, bool)
    rgbd = noise(display, 2, 5, coded=True)
    found = find_sources(rgbd, display, mask=mask)
    assert np.array_equal(found == NO_LENS, ~display.lensed)
    assert not generate(rgbd, display, mask=mask)[~display.lensed].any()
