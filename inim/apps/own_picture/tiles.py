"""Rendering of a camera's samples, as tiles, into the orthographic cells of the display's picture.

Each sample is a tile that covers its camera pixel. Tiles of one surface share their corners, so
that the map cannot open gaps between them. At the edge of a surface the corners separate, and the
surface behind or a hole is visible. Two neighbours belong to one surface if the slope between them
is at most the given limit. This decides which of the four samples at a corner share it.

A cell takes the tile nearest to the viewer at its centre, and the depth of that tile there. Depth
is interpolated within one surface only. The cell's colour is the mean, in linear light, of the
samples in it that belong to this surface, which avoids aliasing of fine pictures; without such
samples it is the tile's colour.
"""

from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from inim.apps.own_picture.tile_kernels import draw_bands, place, write_cells
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.system.backend.kernels import share_rows

# Steps of light of the table of codes. The darkest codes are 20 steps apart.
_LIGHT_STEPS = 2**16 - 1
# Bands of samples, and their least number of rows: more windows take more memory.
_MOST_BANDS, _LEAST_ROWS = 16, 64


class TileFrame(NamedTuple):
    """Mapping of samples to the display frame.

    Sample (i, j) of value q is at ``x = ax (j - cx) w + ox``, ``y = -ay (i - cy) w + oy`` with
    w = 1 / q if `perspective`, else 1. Its z is ``offset_mm + slope q``, or ``+ slope / q`` if
    `over_q`, clipped to `low_mm` .. `high_mm`. Cells are `cell_mm` wide.
    """

    ax: float
    ay: float
    cx: float
    cy: float
    ox: float
    oy: float
    perspective: bool
    over_q: bool
    offset_mm: float
    slope: float
    low_mm: float
    high_mm: float
    cell_mm: float
    #: Range to which samples are clipped; samples out of range are omitted if `drop`.
    q_low: float
    q_high: float
    #: Neighbours belong to one surface if their q differ by at most ``tolerance + tolerance_share
    #: min(q)``.
    tolerance: float
    tolerance_share: float
    drop: bool


class Places(NamedTuple):
    """Places of samples (H, W), in cells of the display's picture.

    * `cells`, (H, W) int32: ``row * width + column`` of the cell of each sample; -1 if there is
      none or the sample is omitted.
    * `ends`, (H, 2) float64: least and greatest q of each row of samples; inf and -inf if it has
      none.
    * `clipped`, (H,) int64: number of samples out of range in each row.
    """

    cells: np.ndarray
    ends: np.ndarray
    clipped: np.ndarray


class Windows(NamedTuple):
    """Cells of each band of samples, drawn on its own: those that its tiles may cover.

    * `first`, (bands + 1,) int64: first row of samples of each band, and H.
    * `top`, (bands,) int64: row of cells at the top of its window.
    * `start`, (bands + 1,) int64: where the rows of its window begin in `depth` and `owner`.
    * `depth`, (n, width) float64: display depth of the nearest tile; -inf without a tile.
    * `owner`, (n, width) int32: number of the tile's sample; any without a tile.
    """

    first: np.ndarray
    top: np.ndarray
    start: np.ndarray
    depth: np.ndarray
    owner: np.ndarray


@dataclass(frozen=True)
class TileImage:
    """Cells of the display's picture."""

    #: (rows, columns, 3) float32, linear RGB; or (rows, columns, 4) uint8, sRGB with alpha
    color: NDArray[np.float32] | NDArray[np.uint8]
    depth_mm: NDArray[np.float32]  #: (rows, columns) float32
    covered: NDArray[np.bool_]  #: (rows, columns) bool
    clipped: int  #: Number of samples out of range.


def draw_tiles(
    q: NDArray[np.float32],
    color: np.ndarray,
    frame: TileFrame,
    shape: tuple[int, int],
    same_mm: float,
    *,
    as_shown: bool = False,
) -> TileImage:
    """Draw samples into cells.

    * `q`, (H, W) float32: inverse distances, or depths; NaN where missing.
    * `color`, (H, W, 3) uint8 sRGB, or float32 linear RGB
    * `shape`, (rows, columns): number of cells, centred on the display's axis.
    * `same_mm`: maximum depth difference between a cell and the samples that contribute to its
      colour.
    * `as_shown`: give the cells' colours as a player sends them to the panel.
    """
    rows = len(q)
    places = Places(np.empty(q.shape, np.int32), np.empty((rows, 2)), np.empty(rows, np.int64))
    share_rows(place, rows, q, frame, shape, *places)
    windows = _windows_of(places.ends, frame, shape)
    share_rows(draw_bands, len(windows.top), q, frame, shape, windows)
    image = TileImage(
        np.zeros((*shape, 4), np.uint8) if as_shown else np.zeros((*shape, 3), np.float32),
        np.zeros(shape, np.float32),
        np.zeros(shape, np.bool_),
        int(places.clipped.sum()),
    )
    light = _light_of_codes() if color.dtype == np.uint8 else None
    codes = _codes_of_light() if as_shown else None
    cells = image.color, image.depth_mm, image.covered
    share_rows(
        write_cells, shape[0], q, color, light, codes, frame, same_mm, places.cells, windows, *cells
    )
    return image


def _windows_of(ends: np.ndarray, frame: TileFrame, shape: tuple[int, int]) -> Windows:
    """Windows of bands of samples, of `Places.ends`."""
    rows, (height, width) = len(ends), shape
    first = np.array([*range(0, rows, max(_LEAST_ROWS, -(-rows // _MOST_BANDS))), rows])
    top, size = np.zeros(len(first) - 1, np.int64), np.zeros(len(first) - 1, np.int64)
    for band, (begin, end) in enumerate(pairwise(first)):
        near = ends[max(begin - 1, 0) : end + 1]  # corners are shared
        q = np.array([near[:, 0].min(), near[:, 1].max()])
        if q[0] <= q[1]:
            w = 1.0 / q if frame.perspective else np.ones(2)
            edges = np.array([begin - 0.5, end - 0.5])[:, None]
            v = (frame.ay * (edges - frame.cy) * w - frame.oy) / frame.cell_mm + 0.5 * height
            # A cell more, for rounding.
            top[band], bottom = np.clip([np.floor(v.min()) - 1, np.ceil(v.max()) + 1], 0, height)
            size[band] = bottom - top[band]
    start = np.concatenate([[0], np.cumsum(size)])
    cells = int(start[-1]), width
    return Windows(first, top, start, np.empty(cells), np.empty(cells, np.int32))


def linear_light(color: np.ndarray) -> NDArray[np.float32]:
    """Linear RGB of uint8 sRGB, or of linear RGB itself."""
    if color.dtype == np.uint8:
        linear: NDArray[np.float32] = _light_of_codes()[color]
        return linear
    return np.asarray(color, np.float32)


@cache
def _light_of_codes() -> np.ndarray:
    """Linear light of each 8-bit code, (256,) float32."""
    return linear_from_srgb(np.arange(256) / 255)


@cache
def _codes_of_light() -> np.ndarray:
    """8-bit code of each light from 0 to 1 in equal steps, (n,) uint8."""
    return srgb_to_uint8(srgb_from_linear(np.linspace(0, 1, _LIGHT_STEPS + 1)))
