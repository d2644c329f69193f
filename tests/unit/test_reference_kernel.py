"""The reference kernel gathers where it says: against float64 rays of the display model."""

import numpy as np
import pytest

from inim.pipeline.timing import threads
from inim.system.backend import kernels
from tests.conftest import small_display

DISPLAYS = {
    "nominal": (small_display(12, 12, pixels=17), 0.2),
    "even": (small_display(6, 4, pixels=8), 0.25),
    "15.7 pixels": (
        small_display(7, 5, pixel_pitch_mm=0.0636, panel_columns=120, panel_rows=70), 0.2,
    ),
    "virtual": (small_display(6, 5, pixels=9, gap_mm=2.5), 0.3),
    "focused": (
        small_display(6, 5, pixels=9, gap_mm=3.0, depth_min_mm=5.0, depth_max_mm=15.0), 0.2,
    ),
    "elemental pitch": (small_display(6, 5, pixels=9, elemental_pitch_mm=1.02), 0.2),
}  # fmt: skip
# A place so near a border between cells may fall to either side of it in float32.
_BORDER = 1e-3


def where_rays_meet_the_plane(display, shape, pixel_mm):
    """Row and column places in picture pixels, float64, from the display's own rays."""
    low, high = display.depth_range_mm
    z = display.central_depth_mm if np.isfinite(display.central_depth_mm) else (low + high) / 2
    column, row = display.columns, display.rows
    x = column.centre_mm + column.slope * z
    y = row.centre_mm + row.slope * z
    return shape[0] / 2 - y / pixel_mm, shape[1] / 2 + x / pixel_mm


@pytest.mark.parametrize("name", DISPLAYS)
def test_addresses_are_those_of_float64_rays(renderer, name):
    from inim.render.reference_kernel import ReferenceKernel

    display, pixel_mm = DISPLAYS[name]
    shape = display.capture_shape(round(1 / pixel_mm))
    color = np.zeros((*shape, 4), np.uint8)
    addresses = ReferenceKernel(color, display, pixel_mm).addresses()
    row, column = where_rays_meet_the_plane(display, shape, pixel_mm)
    lensed = (display.rows.lens >= 0)[:, None] & (display.columns.lens >= 0)[None, :]
    r, c = (
        np.clip(np.floor(place), 0, cells - 1).astype(int)
        for place, cells in zip((row, column), shape, strict=True)
    )
    differs = lensed & (addresses != r[:, None] * shape[1] + c[None, :])
    near = [np.abs(place - np.rint(place)) < _BORDER for place in (row, column)]
    doubtful = near[0][:, None] | near[1][None, :]
    print(f"{name}: {differs.sum()} of {lensed.sum()} differ, all at borders between cells")
    assert not (differs & ~doubtful).any()
    # The bound leaves room for a few columns of ties, not for a wrong formula.
    assert differs.sum() <= 0.05 * lensed.sum()


def test_it_gathers_the_picture_s_own_words(renderer):
    from inim.render.reference_kernel import ReferenceKernel

    display = small_display(4, 4, pixels=17)
    shape = display.capture_shape(3)
    color = np.random.default_rng(0).integers(0, 256, (*shape, 4), np.uint8)
    kernel = ReferenceKernel(color, display, 1 / 3)
    words = np.asarray(kernel.run()).reshape(display.eia_shape)
    assert (words == color.view(np.uint32).ravel()[kernel.addresses()]).all()


def test_threads_hold_for_both_and_are_given_back(renderer):
    import drjit as dr

    before = kernels._thread_count, dr.thread_count()
    with threads(1) as count:
        assert (count, kernels._thread_count, dr.thread_count()) == (1, 1, 1)
    assert (kernels._thread_count, dr.thread_count()) == before
