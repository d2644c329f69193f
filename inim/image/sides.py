"""Sides: the faces of solids that a parallel camera sees edge-on, as pieces with own colours.

A solid has a side if it is open to the side over more of its depth than the display's steepest ray
crosses within a pixel. Its front becomes a sheet, which rays from above meet, and its body a stack
of pieces below, which only rays from the side meet. No ray ends at a different place: the pieces
fill the space of the solid.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from inim.image.rgbd import Layer, LayeredRGBD
from inim.system.backend.kernels import compiled

#: Of a side as tall as the depth range. A panel pixel sees |z| P_D / g across, and of a side, by
#: the steepest ray, 2 g / P times that: at the central depth plane of `nominal` a tenth of its
#: range, whatever its picture's pixels are.
PIECES = 10
# The pixels beside one: rows down and columns right.
BESIDE = np.array([(0, -1), (0, 1), (-1, 0), (1, 0)])


@dataclass(frozen=True)
class Sides:
    """Pieces of all sides, ordered by rows, columns and depths, nearest first."""

    #: Slopes of the display's steepest rays, horizontally and vertically.
    slopes: tuple[float, float]
    #: (pieces,) int32: number of the solid in its pixel, and the pixel.
    solid: NDArray[np.int32]
    row: NDArray[np.int32]
    column: NDArray[np.int32]
    #: (pieces,) float32: display z. A solid's last piece ends at the solid's back.
    front_mm: NDArray[np.float32]
    back_mm: NDArray[np.float32]
    #: (pieces, 4) float32: tallest gap next to a piece, left, right, above and below; equal without
    #: a gap.
    low_mm: NDArray[np.float32]
    high_mm: NDArray[np.float32]

    @classmethod
    def of(
        cls,
        front_mm: NDArray[np.float32],
        back_mm: NDArray[np.float32],
        depth_range_mm: tuple[float, float],
        slopes: tuple[float, float],
        pixel_mm: float,
    ) -> Sides:
        """The sides of solids.

        * `front_mm`, `back_mm`, (solids, rows, columns) float32: nearest first; fronts are -inf
          where there is none.
        * `depth_range_mm`, (low, high): of the display.
        * `slopes`: as in the fields.
        * `pixel_mm`: of the picture.
        """
        low, high = depth_range_mm
        pieces = np.zeros(front_mm.shape, np.int32)
        _count_pieces(front_mm, back_mm, pixel_mm / max(slopes), (high - low) / PIECES, pieces)
        return cls(slopes, *_cut_into_pieces(front_mm, back_mm, pieces))

    @cached_property
    def walls(self) -> NDArray[np.int64]:
        """Open pieces and their open sides, (n, 2)."""
        return np.argwhere(self.low_mm < self.high_mm)

    @property
    def is_first(self) -> NDArray[np.bool_]:
        """Mask of the pieces that begin a solid's side, (pieces,)."""
        return _differs_from_previous(self.row, self.column, self.solid)

    @property
    def order(self) -> NDArray[np.int64]:
        """Number of pieces before each piece in its pixel, (pieces,)."""
        place = np.arange(len(self.row))
        order: NDArray[np.int64] = place - np.maximum.accumulate(
            place * _differs_from_previous(self.row, self.column)
        )
        return order


def _differs_from_previous(*names: np.ndarray) -> NDArray[np.bool_]:
    """Mask of entries that differ from the previous entry in any of the names."""
    new = np.ones(len(names[0]), bool)
    new[1:] = np.any([np.diff(values) != 0 for values in names], axis=0)
    return new


@compiled
def _tallest_gap(front, back, row, column, low, high):  # type: ignore[no-untyped-def]
    """The tallest gap of a pixel's solids within a span of depths: its lower and upper end."""
    solids, rows, columns = front.shape
    begin, end, top = high, high, high
    if 0 <= row < rows and 0 <= column < columns:
        for k in range(solids):
            if front[k, row, column] <= low:
                break
            if top - front[k, row, column] > end - begin:
                begin, end = front[k, row, column], top
            top = min(top, back[k, row, column])
    if top - low > end - begin:
        begin, end = low, top
    return begin, end


@compiled
def _count_pieces(front, back, least, tall, pieces):  # type: ignore[no-untyped-def]
    """Number of pieces, at most `tall` each, of every solid that is open by more than `least`."""
    for k in range(front.shape[0]):
        for r in range(front.shape[1]):
            for c in range(front.shape[2]):
                high, low = front[k, r, c], back[k, r, c]
                if high == -np.inf or high - low <= least:
                    continue
                for down, right in BESIDE:
                    begin, end = _tallest_gap(front, back, r + down, c + right, low, high)
                    if end - begin > least:
                        pieces[k, r, c] = max(1, np.ceil((high - low) / tall))
                        break


@compiled
def _cut_into_pieces(front, back, pieces):  # type: ignore[no-untyped-def]
    """Cut solids into pieces as tall as each other, and leave out those that are open nowhere.

    The arrays of `Sides`.
    """
    most, n = pieces.sum(), 0
    solid, row, column = np.empty((3, most), np.int32)
    fronts, backs = np.empty((2, most), np.float32)
    lows, highs = np.empty((2, most, len(BESIDE)), np.float32)
    for r in range(front.shape[1]):
        for c in range(front.shape[2]):
            for k in range(front.shape[0]):
                first, step = n, (front[k, r, c] - back[k, r, c]) / max(1, pieces[k, r, c])
                for p in range(pieces[k, r, c]):
                    high = np.float32(front[k, r, c] - p * step)
                    low = np.float32(front[k, r, c] - (p + 1) * step)
                    if p == pieces[k, r, c] - 1:
                        low = back[k, r, c]
                    is_open = False
                    for i, (down, right) in enumerate(BESIDE):
                        lows[n, i], highs[n, i] = _tallest_gap(
                            front, back, r + down, c + right, low, high
                        )
                        is_open |= lows[n, i] < highs[n, i]
                    if not is_open:
                        continue
                    solid[n], row[n], column[n] = k, r, c
                    fronts[n], backs[n] = high, back[k, r, c]
                    if n > first:
                        backs[n - 1] = high
                    n += 1
    return (
        solid[:n].copy(), row[:n].copy(), column[:n].copy(), fronts[:n].copy(), backs[:n].copy(),
        lows[:n].copy(), highs[:n].copy(),
    )  # fmt: skip


def with_sides(
    solids: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    sides: Sides,
    light: NDArray[np.float32],
    has_light: NDArray[np.bool_],
    pixel_mm: float,
) -> LayeredRGBD:
    """Layered depth image of solids and their sides.

    A solid with a side is a sheet, and the pieces of its side are separate layers behind it. A
    piece without light has the colour of the previous layer.

    * `solids`: (solids, rows, columns) float32, -inf where there is none; and (..., 3) linear RGB.
    * `light`, (pieces, 3) float32
    * `has_light`, (pieces,) bool
    """
    front_mm, back_mm, colors = solids
    exists = front_mm > -np.inf
    first = np.zeros(exists.shape, np.int64)
    np.add.at(first, (sides.solid, sides.row, sides.column), 1)
    first = np.arange(len(exists))[:, None, None] + first.cumsum(axis=0) - first
    layer = sides.solid + 1 + sides.order
    layers = 1 + max(first[exists].max(initial=0), layer.max(initial=0))

    def stacked(of_solids: np.ndarray, of_pieces: np.ndarray | bool) -> np.ndarray:
        """(layers, rows, columns, ...): each solid, and behind it the pieces of its side."""
        values = np.zeros((layers, *of_solids.shape[1:]), of_solids.dtype)
        _, row, column = np.nonzero(exists)
        values[first[exists], row, column] = of_solids[exists]
        values[layer, sides.row, sides.column] = of_pieces
        return values

    color = stacked(colors, light)
    covered, front = stacked(exists, True), stacked(front_mm, sides.front_mm)
    ends, top = back_mm.copy(), sides.is_first
    ends[sides.solid[top], sides.row[top], sides.column[top]] = sides.front_mm[top]
    back = stacked(ends, sides.back_mm)
    unseen = covered & ~stacked(exists, has_light)
    for k in range(1, layers):  # what no ray comes to looks like what is before it
        color[k][unseen[k]] = color[k - 1][unseen[k]]
    deeper = [Layer(color[k], front[k], back[k], covered[k]) for k in range(1, layers)]
    return LayeredRGBD(color[0], front[0], covered[0], pixel_mm, back[0], tuple(deeper))
