"""Columns: the solids of a picture, cell by cell, each from a front to a back.

A picture gives the position of its surface but not the thickness of the object. One of four rules
decides on the backs (docs/theory/templates.md, "The backs of columns"):

`SURFACE`
    The lowest of the eight neighbours on the same surface, and at least `THICKNESS_PX` picture
    pixels behind the front. A ray that passes behind a surface and has no later hit shows the last
    cell on its path, as if that cell's surface continued.
`SEEN`
    The same rule, but the hidden region stays a hole, for a later fill (`raycast.fill`).
`SOLID`
    Columns without a back.
`LAYERS`
    The solids of a layered depth image (`inim.image.rgbd.LayeredRGBD`), in order; for a
    picture without layers, `SURFACE`.
"""

import math
from dataclasses import dataclass

import numpy as np

from inim.image.rgbd import RGBD, Layer, LayeredRGBD
from inim.system.backend.kernels import compiled, share_rows

SURFACE, SEEN, SOLID, LAYERS = "surface", "seen", "solid", "layers"

#: Millimetres of depth to the millimetre up to which neighbours are one surface.
STEEPEST = 20.0
#: How far back a column reaches at least, in picture pixels.
THICKNESS_PX = 10.0


@dataclass(frozen=True)
class Columns:
    """Columns of a picture.

    * `end`: true if columns have backs, so that rays may pass behind them.
    * `continue_behind`: true if a ray that passed behind a column without a later hit shows the
      last cell on its path.
    """

    layers: tuple[Layer, ...]
    end: bool
    continue_behind: bool


def visible_depth(layer: Layer) -> np.ndarray:
    """Front of a layer, (H, W) float32; -inf where there is none."""
    return np.where(layer.covered, layer.front_mm, np.float32(-np.inf))


def columns_of(rgbd: RGBD, rule: str) -> Columns:
    """The columns of a picture by one of the four rules."""
    if rule == LAYERS and isinstance(rgbd, LayeredRGBD):
        return Columns(rgbd.layers, end=True, continue_behind=False)
    if rule == SOLID:
        # A view of one number: nothing reads it where columns do not end.
        back = np.broadcast_to(np.float32(-np.inf), rgbd.shape)
    else:
        back = surface_backs(rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
    layer = Layer(rgbd.color, rgbd.depth_mm, back, rgbd.covered)
    return Columns((layer,), end=rule != SOLID, continue_behind=rule not in (SOLID, SEEN))


def surface_backs(depth_mm: np.ndarray, covered: np.ndarray, pixel_mm: float) -> np.ndarray:
    """Back of each pixel's column by the rule of `SURFACE`.

    * `depth_mm`, (H, W) float32: depth in the display frame; larger is nearer.
    * `covered`: (H, W) bool.

    Returns (H, W) float32: inf at uncovered pixels.
    """
    rows, columns = depth_mm.shape
    steps = np.float32(STEEPEST * pixel_mm), np.float32(STEEPEST * pixel_mm * math.sqrt(2))
    front = np.full((rows + 2, columns + 2), -np.inf, np.float32)
    np.copyto(front[1:-1, 1:-1], depth_mm, where=covered)
    back = np.empty((rows, columns), np.float32)
    share_rows(_end, rows, *steps, np.float32(THICKNESS_PX * pixel_mm), front, back)
    return back


@compiled
def _end(first, end, straight, diagonal, thickness, front, back):  # type: ignore[no-untyped-def]
    """Fill rows of `back`; `front` has a border without surfaces."""
    for i in range(first, end):
        above, middle, below = front[i], front[i + 1], front[i + 2]
        for j in range(back.shape[1]):
            here = middle[j + 1]
            low = here - thickness
            low = _lower(low, here, above[j], diagonal)
            low = _lower(low, here, above[j + 1], straight)
            low = _lower(low, here, above[j + 2], diagonal)
            low = _lower(low, here, middle[j], straight)
            low = _lower(low, here, middle[j + 2], straight)
            low = _lower(low, here, below[j], diagonal)
            low = _lower(low, here, below[j + 1], straight)
            low = _lower(low, here, below[j + 2], diagonal)
            back[i, j] = low if low > -np.inf else np.float32(np.inf)


@compiled
def _lower(low, here, beside, most):  # type: ignore[no-untyped-def]
    """The neighbour if it is lower and on the same surface as `here`, otherwise the previous
    lowest.
    """
    joined = beside if here - beside <= most else low
    return joined if joined < low else low
