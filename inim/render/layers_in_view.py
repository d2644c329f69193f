"""Which layers some ray of a display can meet: what lies deeper and is closed in needs no colour.

A layer behind the front surface is in view if a ray gets behind what is before it. So the places
where rays may be are followed from the viewer's side into the depth, slice by slice. A cell has 8
by 8 of them, a bit each of a word. A slice is so thin that no ray of the display gets farther in it
than to the next place: from one slice to the next they spread to all places beside them, and where
a solid is, there are none. What has no such place, in any slice that it reaches through, no ray
meets: to leave it out changes no pixel.

Too much is let in, never too little: paths that bend within the display's cone of directions, and
what passes through solids thinner than a slice, such as sheets.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from inim.display import Display

__all__ = ["in_view"]

# Along a cell.
_PLACES = 8
# Of a place, the most that a ray crosses in a slice: below one, so that rounding adds none.
_CROSSED = 0.99
_EVERYWHERE = np.uint64(2**64 - 1)
# Rows are bytes, the upper one lowest; in a row the left place is the lowest bit.
_LEFT = np.uint64(0x0101010101010101)
_RIGHT = np.uint64(0x8080808080808080)


def in_view(
    front_mm: NDArray[np.float32], back_mm: NDArray[np.float32], display: Display, pixel_mm: float
) -> NDArray[np.bool_]:
    """Where a layer is not hidden from all rays of a display.

    Parameters
    ----------
    front_mm, back_mm : (layers, rows, columns) float32
        Nearest first; fronts are -inf where there is no layer.
    display : Display
    pixel_mm : float
        A cell.

    Returns
    -------
    (layers, rows, columns) bool
        The front surface always is; False where there is no layer.
    """
    seen = np.isfinite(front_mm)
    if not seen[1:].any():
        return seen
    deeper = np.any(seen[1:], axis=0, keepdims=True)[0]
    z_min, z_max = display.depth_range_mm
    # Samples may start beside a pixel's centre, anywhere within it.
    slope = max(display.steepest_slopes) + display.pixel_pitch_mm / display.gap_mm
    travel = (z_max - z_min) * slope / pixel_mm  # cells
    bounds = np.linspace(z_max, z_min, 2 + int(travel * _PLACES / _CROSSED))
    # From farther away no ray gets there.
    part = (slice(None), *_around(deeper, math.ceil(travel) + 1))
    seen[part] = _met(front_mm[part], back_mm[part], bounds)
    return seen


def _around(cells: NDArray[np.bool_], margin: int) -> tuple[slice, slice]:
    """Rows and columns that hold all cells, and so many more on each side."""
    rows, columns = (np.flatnonzero(cells.any(axis=axis)) for axis in (1, 0))
    return (
        slice(max(rows[0] - margin, 0), rows[-1] + margin + 1),
        slice(max(columns[0] - margin, 0), columns[-1] + margin + 1),
    )


def _met(
    front: NDArray[np.float32], back: NDArray[np.float32], bounds: np.ndarray
) -> NDArray[np.bool_]:
    """`in_view`, followed through slices between some depths, from near to far."""
    seen = np.isfinite(front)
    cells = np.flatnonzero(seen[1:].any(axis=0))
    fronts, backs = (values.reshape(len(values), -1)[1:, cells] for values in (front, back))
    found = np.zeros(fronts.shape, bool)
    rays = np.full(front.shape[1:], _EVERYWHERE)
    across = np.empty_like(rays)
    top = np.inf  # whatever a ray begins in, it meets
    for end in bounds[1:]:
        _spread_across(rays, across)
        _spread_down(across, rays)
        found |= (fronts >= end) & (backs <= top) & (rays.reshape(-1)[cells] != 0)
        rays[(front[0] >= end) & (back[0] <= end)] = 0
        rays.reshape(-1)[cells[((fronts >= end) & (backs <= end)).any(axis=0)]] = 0
        top = end
    seen.reshape(len(seen), -1)[1:, cells] &= found
    return seen


@numba.njit(cache=True, nogil=True)
def _spread_across(rays, out):  # type: ignore[no-untyped-def]
    """Rays spread to the places left and right of theirs; around the cells they are everywhere."""
    one, seven = np.uint64(1), np.uint64(7)
    rows, columns = rays.shape
    for r in range(rows):
        for c in range(columns):
            own = rays[r, c]
            before = rays[r, c - 1] if c > 0 else _EVERYWHERE
            after = rays[r, c + 1] if c + 1 < columns else _EVERYWHERE
            own |= (own & ~_RIGHT) << one | (own & ~_LEFT) >> one
            out[r, c] = own | (before & _RIGHT) >> seven | (after & _LEFT) << seven


@numba.njit(cache=True, nogil=True)
def _spread_down(rays, out):  # type: ignore[no-untyped-def]
    """Rays spread to the places above and below theirs."""
    row, last = np.uint64(8), np.uint64(56)
    rows, columns = rays.shape
    for r in range(rows):
        for c in range(columns):
            own = rays[r, c]
            before = rays[r - 1, c] if r > 0 else _EVERYWHERE
            after = rays[r + 1, c] if r + 1 < rows else _EVERYWHERE
            out[r, c] = own | own << row | own >> row | before >> last | after << last
