"""Positions where views flip: a sweep of the eye across the edge of the viewing zone."""

import math

import numpy as np
import pytest

from inim.display import DISPLAYS, Viewpoint

# The panel goes on beyond the array, so that the outermost lenses have neighbours to show too.
DISPLAY = DISPLAYS["nominal"].replace(
    lens_columns=9, lens_rows=7, panel_columns=13 * 17, panel_rows=11 * 17
)
DISTANCE_MM = 400.0
# Odd, so that a view pixel looks at the middle of each lens.
PER_LENS = 5


def ramps(axis: int) -> np.ndarray:
    """An EIA whose elemental images all rise from 0 to 1 along one axis (1: rightwards)."""
    pixels = round(DISPLAY.pixels_per_lens)
    rise = (np.arange(pixels) + 0.5) / pixels
    rows, columns = DISPLAY.eia_shape
    along = np.tile(rise, DISPLAY.eia_shape[axis] // pixels)
    plane = np.broadcast_to(along[:, None] if axis == 0 else along, (rows, columns))
    return np.repeat(plane[..., None], 3, axis=-1).astype(np.float32)


def lens_values(scene, x_mm: float, y_mm: float) -> np.ndarray:
    """Light of each lens's middle towards an eye, (lens rows, lens columns)."""
    eye = Viewpoint("eye", x_mm, y_mm, DISTANCE_MM)
    view = scene.view(eye, pixels_per_lens=PER_LENS, spp=16, seed=0)
    middle = PER_LENS // 2
    return view[middle::PER_LENS, middle::PER_LENS, 0]


@pytest.mark.parametrize("lens_model", ["pinhole", "thin", "thick"])
@pytest.mark.parametrize(("axis", "sign"), [(1, +1), (1, -1), (0, +1), (0, -1)])
def test_the_first_lens_flips_at_the_position_of_the_formula(lens_model, axis, sign):
    from inim.render import variant
    from inim.render.reconstruct import DisplayScene

    variant.use("auto")
    limit_mm = DISPLAY.flip_limit_mm(DISTANCE_MM)[1 - axis]
    limit_deg = math.degrees(math.atan(limit_mm / DISTANCE_MM))
    scene = DisplayScene(ramps(axis), DISPLAY, lens_model)
    step_deg = 0.125
    flipped_deg = None
    for angle in limit_deg + np.arange(-16, 17) * step_deg:
        offset = sign * DISTANCE_MM * math.tan(math.radians(angle))
        values = lens_values(scene, *((offset, 0.0) if axis == 1 else (0.0, offset)))
        # Within the zone, all lenses look at nearly the same place of their elemental images.
        middle = values[DISPLAY.lens_rows // 2, DISPLAY.lens_columns // 2]
        odd = np.abs(values - middle) > 0.5
        if odd.any():
            flipped_deg = angle
            break
    assert flipped_deg is not None, "no lens ever flipped"
    assert abs(flipped_deg - limit_deg) <= 0.5
    # It is the lens farthest from the eye, which sees it at the steepest angle.
    flipped = np.unique(np.nonzero(odd)[axis])
    far_end = 0 if (sign > 0) == (axis == 1) else values.shape[axis] - 1
    assert far_end in flipped
    assert len(flipped) < values.shape[axis] / 2
