"""`template_jit` against `template`: the same bits, on whatever Dr.Jit runs on."""

from __future__ import annotations

import numpy as np
import pytest

from inim.display import DISPLAYS, Display
from inim.errors import UsageError
from inim.generators import HOLE, NO_LENS, find_sources, generate, prepare
from inim.generators.raycast.cells import cell_rays
from inim.image.rgbd import RGBD
from tests import oracle
from tests.conftest import no_cuda, small_display
from tests.unit.test_template_forms import STRADDLING, VIRTUAL, picture

pytestmark = pytest.mark.usefixtures("renderer")

CONVERGING = {"elemental_pitch_mm": 1.001}
FEW_PIXELS = {"panel_columns": 150, "panel_rows": 100}  # more than the array covers


def assert_same(display: Display, rgbd: RGBD) -> np.ndarray:
    found = find_sources(rgbd, display, "template_jit")
    assert found.dtype == np.int32
    assert np.array_equal(found, find_sources(rgbd, display, "template"))
    shown = generate(rgbd, display, "template_jit")
    expected = generate(rgbd, display, "template")
    assert shown.dtype == expected.dtype and shown.tobytes() == expected.tobytes()
    return found


@pytest.mark.parametrize("rgba", [False, True], ids=["linear", "rgba"])
@pytest.mark.parametrize(
    ("per_pitch", "lenses", "pixels", "mode"),
    [
        (1, (7, 5), 8, {}),
        (2, (50, 3), 7, STRADDLING),
        (4, (1, 1), 7, VIRTUAL),
        (5, (97, 2), 8, {}),
    ],
)
def test_displays_that_share_directions_show_the_same_bits(per_pitch, lenses, pixels, mode, rgba):
    display = small_display(*lenses, pixels=pixels, **mode)
    assert (assert_same(display, picture(display, per_pitch, rgba=rgba)) >= 0).any()


@pytest.mark.parametrize(
    "display",
    [
        small_display(9, 7, **CONVERGING),
        small_display(9, 7, pixels=7, **VIRTUAL, **CONVERGING),
        small_display(9, 7, **STRADDLING, **FEW_PIXELS),
        DISPLAYS["phone"],
    ],
    ids=["converging", "virtual", "wide panel", "phone"],
)
def test_displays_that_share_none_show_the_same_bits(display):
    for rgba in (False, True):
        assert (assert_same(display, picture(display, 2, rgba=rgba)) >= 0).any()


@pytest.mark.parametrize("changes", [{}, CONVERGING], ids=["shared directions", "none shared"])
def test_depths_at_which_rays_leave_cells_are_reached_to_the_last_bit(changes):
    """Exits themselves, as float32, and the floats next to them: ties, and the least misses."""
    display = small_display(15, 9, **changes)
    rgbd = picture(display, 2)
    random = np.random.default_rng(5)
    rays, _ = cell_rays(rgbd.shape, rgbd.pixel_mm, display)
    ray = random.integers(len(rays.start), size=10**6)
    border = random.integers(rgbd.shape[1] + 1, size=ray.size)
    moving = rays.slope[ray] != 0
    ray, border = ray[moving], border[moving]
    exits = ((border * rays.scale - rays.start[ray]) / rays.slope[ray]).astype(np.float32)
    low, high = display.depth_range_mm
    exits = exits[(exits > low) & (exits < high)]
    aside = random.choice(np.float32([-np.inf, 0, np.inf]), exits.size)
    exits = np.where(aside == 0, exits, np.nextafter(exits, aside))
    depth = random.choice(exits, rgbd.shape)
    assert_same(display, RGBD(rgbd.color, depth, rgbd.covered, rgbd.pixel_mm))


def test_pixels_under_no_lens_are_told_from_holes_and_left_black():
    display = small_display(9, 7, **FEW_PIXELS)
    rgbd = picture(display, 2, rgba=True)
    bare = find_sources(rgbd, display, "template_jit") == NO_LENS
    assert bare.any() and not bare.all()
    assert not generate(rgbd, display, "template_jit")[bare].any()


def test_a_fractional_number_of_picture_pixels_per_pitch_shows_the_same_bits():
    display = small_display(20, 9)
    whole = picture(display, 3, rgba=True)
    assert_same(display, RGBD(whole.color, whole.depth_mm, whole.covered, 0.3))


@pytest.mark.parametrize("changes", [{}, CONVERGING], ids=["shared directions", "none shared"])
def test_a_picture_smaller_than_the_array_shows_the_same_bits_and_holes_beyond_it(changes):
    display = small_display(60, 9, **STRADDLING, **changes)
    whole = picture(display, 2, rgba=True)
    parts = (a[6:-6, 40:-40] for a in (whole.color, whole.depth_mm, whole.covered))
    found = assert_same(display, RGBD(*parts, whole.pixel_mm))
    assert (found == HOLE).mean() > 0.3


def test_sources_are_those_of_the_exact_oracle():
    display = small_display(5, 4)
    for per_pitch in (3, 4):
        rgbd = picture(display, per_pitch)
        found = find_sources(rgbd, display, "template_jit")
        assert np.array_equal(found, oracle.exact_sources(rgbd, display))


@pytest.mark.parametrize("changes", [{}, CONVERGING], ids=["shared directions", "none shared"])
def test_a_prepared_generator_forgets_the_picture_before(changes):
    display = small_display(**changes)
    one, other = (picture(display, 4, rgba=True, seed=s) for s in (1, 2))
    made = prepare(display, "template_jit", shape=one.shape, pixel_mm=one.pixel_mm)
    first = made.generate(one)
    assert not np.array_equal(made.generate(other), first)
    nothing = RGBD(one.color, one.depth_mm, np.zeros(one.shape, bool), one.pixel_mm)
    assert not made.generate(nothing).any()
    assert np.array_equal(made.generate(one), first)


@pytest.mark.parametrize("rgba", [False, True], ids=["linear", "rgba"])
def test_out_is_filled_and_returned_and_a_wrong_one_refused(rgba):
    display = small_display()
    rgbd = picture(display, 2, rgba=rgba)
    out = np.full((*display.eia_shape, 4 if rgba else 3), 77, rgbd.color.dtype)
    assert generate(rgbd, display, "template_jit", out=out) is out
    assert np.array_equal(out, generate(rgbd, display, "template"))
    for wrong in (out[:-1], out.astype(np.float64), out[:, ::-1]):
        with pytest.raises(UsageError, match="out"):
            generate(rgbd, display, "template_jit", out=wrong)


def test_a_picture_of_another_size_is_refused():
    display = small_display()
    made = prepare(display, "template_jit", shape=(40, 50), pixel_mm=0.5)
    for rgba in (False, True):
        with pytest.raises(UsageError, match="prepared for 40 x 50"):
            made.generate(picture(display, 2, rgba=rgba))


WHY_NO_CUDA = no_cuda()


@pytest.mark.skipif(bool(WHY_NO_CUDA), reason=WHY_NO_CUDA)
def test_cuda_shows_the_same_bits():
    import mitsuba as mi

    from inim.render import variant

    before = mi.variant()
    try:
        variant.use("cuda")
        for display in (DISPLAYS["nominal"], DISPLAYS["phone"], small_display(9, 7, **VIRTUAL)):
            for rgba in (False, True):
                assert_same(display, picture(display, 4, rgba=rgba))
    finally:
        mi.set_variant(before)


@pytest.mark.parametrize(
    ("changes", "says"),
    [({"rotation_deg": 1.0}, "rotation_deg"), ({"subpixels": "rgb-stripe"}, "rgb-stripe")],
)
def test_displays_it_would_show_wrongly_are_refused(changes, says):
    display = small_display(4, 3, pixels=7, **changes)
    with pytest.raises(UsageError, match=says):
        prepare(display, "template_jit", shape=(16, 16), pixel_mm=0.5)
