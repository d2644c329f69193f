"""Sides: the faces of solids that a parallel camera sees edge-on, and their light.

A face along the camera's rays has no pixel. Where a solid is taller than its neighbour, oblique
display rays meet its side, which may look different from its front: the base of a bust is dark. A
solid therefore gets side colours if it is open to the side over more of its depth than the
display's steepest ray crosses within a pixel.

Its front becomes a sheet, which rays from above meet, and its body a stack of pieces below, which
only rays from the side meet. No ray ends at a different place: the pieces fill the space of the
solid.

A piece's colour is the mean over the display rays that reach it: through any point of
the walls between its pixel and the four neighbours, at any slope of the display's pixels,
and unobstructed from the viewer to the centre of the neighbouring pixel, which the
camera saw to be empty. From there a ray meets the side, up to half a pixel in front of
the wall or behind it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from inim.backend.kernels import compiled
from inim.display import Display
from inim.render.rays import SeparableRays
from inim.render.scene import FittedScene
from inim.render.trace import Light, first_not_light

#: Of a side as tall as the depth range. A panel pixel sees |z| P_D / g across, and of a side, by
#: the steepest ray, 2 g / P times that: at the central depth plane of `nominal` a tenth of its
#: range, whatever its picture's pixels are.
PIECES = 10
# The pixels beside one: rows down and columns right.
_BESIDE = np.array([(0, -1), (0, 1), (-1, 0), (1, 0)])
# Rays that enter a wall are the more, the more aslant they are; those that graze it start far off.
_LEAST_SHARE = 1e-3


@dataclass(frozen=True)
class Sides:
    """Pieces of all sides, ordered by rows, columns and depths, nearest first.

    Attributes
    ----------
    slopes : (2,) float
        Slopes of the display's steepest rays, horizontally and vertically.
    solid, row, column : (pieces,) int32
        Number of the solid in its pixel, and the pixel.
    front_mm, back_mm : (pieces,) float32
        Display z. A solid's last piece ends at the solid's back.
    low_mm, high_mm : (pieces, 4) float32
        Tallest gap next to a piece, left, right, above and below; equal without a gap.
    """

    slopes: tuple[float, float]
    solid: NDArray[np.int32]
    row: NDArray[np.int32]
    column: NDArray[np.int32]
    front_mm: NDArray[np.float32]
    back_mm: NDArray[np.float32]
    low_mm: NDArray[np.float32]
    high_mm: NDArray[np.float32]

    @classmethod
    def of(
        cls,
        front_mm: NDArray[np.float32],
        back_mm: NDArray[np.float32],
        display: Display,
        pixel_mm: float,
    ) -> Sides:
        """The sides of solids.

        Parameters
        ----------
        front_mm, back_mm : (solids, rows, columns) float32
            Nearest first; fronts are -inf where there is none.
        display : Display
        pixel_mm : float
            Of the picture.
        """
        slopes = display.steepest_slopes
        low, high = display.depth_range_mm
        pieces = np.zeros(front_mm.shape, np.int32)
        _count_pieces(front_mm, back_mm, pixel_mm / max(slopes), (high - low) / PIECES, pieces)
        return cls(slopes, *_cut_into_pieces(front_mm, back_mm, pieces))

    @cached_property
    def walls(self) -> NDArray[np.int64]:
        """(n, 2): a piece, and to which side it is open, of all that are."""
        return np.argwhere(self.low_mm < self.high_mm)

    @property
    def is_first(self) -> NDArray[np.bool_]:
        """(pieces,): which begin a solid's side."""
        return _differs_from_previous(self.row, self.column, self.solid)

    @property
    def order(self) -> NDArray[np.int64]:
        """(pieces,): how many pieces are before each in its pixel."""
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
                for down, right in _BESIDE:
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
    lows, highs = np.empty((2, most, len(_BESIDE)), np.float32)
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
                    for i, (down, right) in enumerate(_BESIDE):
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


def side_light(fitted: FittedScene, rays: SeparableRays, sides: Sides, seen_only: bool) -> Light:
    """Function that returns the light of samples on the walls of sides, one pixel per wall.

    Parameters
    ----------
    fitted : FittedScene
    rays : SeparableRays
        Rays of the depth camera.
    sides : Sides
    seen_only : bool
        Return 1 for a sample that reaches its wall unobstructed, instead of its light. The others
        are 0 in both cases. Equal seeds draw equal samples.
    """
    camera = fitted.camera(rays)
    piece, beside = sides.walls.T
    down, right = _BESIDE[beside].T
    row, column = sides.row[piece], sides.column[piece]
    pixel_mm = abs(rays.x.place_step_mm)
    slope_x, slope_y = (dr.opaque(mi.Float, slope) for slope in sides.slopes)
    start, half = dr.opaque(mi.Float, rays.start_mm), dr.opaque(mi.Float, pixel_mm / 2)

    def table(values: np.ndarray) -> Any:
        return mi.Float(np.asarray(values, np.float32))

    tables = [
        table(values)
        for values in (
            rays.x.place_mm[column], rays.y.place_mm[row], right, -down,
            sides.low_mm[piece, beside], sides.high_mm[piece, beside],
        )
    ]  # fmt: skip

    def light(index: Any, sampler: Any) -> Any:
        within = sampler.next_2d()
        x, y, across, up, low, high = (dr.gather(mi.Float, t, index) for t in tables)
        along, level = sampler.next_2d()
        # A wall is as wide as a ray's slope towards it lets it appear.
        towards = dr.sqrt(dr.maximum(within.x, _LEAST_SHARE))
        offset = 2 * within.y - 1
        is_left_or_right = across != 0
        run_x = dr.select(is_left_or_right, -across * towards, offset) * slope_x
        run_y = dr.select(is_left_or_right, offset, -up * towards) * slope_y
        # From a point of the wall back to the middle of the pixel beside, and to the viewer.
        place = (2 * along - 1) * half
        x += dr.select(is_left_or_right, across * half, place)
        y += dr.select(is_left_or_right, place, up * half)
        z = dr.lerp(low, high, level)
        before = half / dr.select(is_left_or_right, dr.abs(run_x), dr.abs(run_y))
        depth = start - z
        ray, length = camera.world_rays([x - run_x * depth, y - run_y * depth], [run_x, run_y])
        hit = first_not_light(fitted.scene, ray)
        is_unobstructed = ~hit.is_valid() | (hit.t >= (depth - before) * length)
        if seen_only:
            return mi.Color3f(dr.select(is_unobstructed, mi.Float(1), mi.Float(0)))
        radiance_sample = fitted.integrator.sample(
            fitted.scene, sampler, mi.RayDifferential3f(ray), active=is_unobstructed
        )[0]
        return dr.select(is_unobstructed, radiance_sample, 0)

    return light
