# Kernels have no types of their own.
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
"""Colours of rays, interpolated between the pixels of their source's surface.

The point at which a ray meets the surface is the ray's position at the depth of the source, moved
to the border of the source's pixel if it is outside. The colour is interpolated bilinearly between
the centres of the four nearest pixels. Pixels of another surface have no weight, and the weights
of the others are divided by their sum.

Everything that depends on the picture only is tabulated once per picture: the eight neighbours of
each pixel on its surface. The colour of a pixel is a vector of red, green, blue and 1: its last
part adds up to the weight of the pixels that were read, and a missing neighbour is zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from inim.display import Display
from inim.generators.base import Ray
from inim.generators.raycast.cells import PictureRays
from inim.generators.raycast.columns import STEEPEST
from inim.generators.raycast.light import WHITE, code_table, neighbour_layer
from inim.generators.raycast.simd import (
    LANES,
    add,
    choose,
    last4,
    less,
    load,
    load4,
    minus,
    over,
    plus,
    same,
    same4,
    store,
    times,
)
from inim.image.rgbd import RGBD
from inim.system.backend.kernels import compiled, share_rows

# Panel pixels whose rays are interpolated at once: their positions stay in the first cache.
_CHUNK = 4 * LANES


class Interpolation:
    """Interpolation between the pixels of a picture.

    * `front`, (layers, H, W) float32: depth in mm; -inf where there is no surface.
    """

    def __init__(self, rgbd: RGBD, display: Display, front: np.ndarray) -> None:
        self._rgbd, self._display = rgbd, display
        self._surfaces = _Surfaces.of(front, rgbd.pixel_mm)

    def writer(
        self, light: np.ndarray, opacity: np.ndarray | None, squared: bool, rays: Sequence[Ray]
    ) -> Callable[[slice, np.ndarray, np.ndarray], None]:
        """Function that writes mean colours of rays, from the sources of some panel rows.

        * `light`, (n, 4) float32: linear RGB of the pixels, or its square roots, and 1.
        * `opacity`, (n,) float32: of the pixels; all are opaque if omitted.
        * `squared`: interpolated colours are square roots of light.
        """
        lines, texels = _Lines(self._rgbd, self._display, rays), _with_hole(light)
        alphas = None
        if opacity is not None:
            parts = (opacity, opacity, opacity, np.ones_like(opacity))
            alphas = _with_hole(np.stack(parts, axis=1))

        def write(rows: slice, sources: np.ndarray, out: np.ndarray) -> None:
            count, arguments = len(out), (sources, *lines.of(rows, sources), *self._surfaces)
            if out.dtype != np.uint8:
                share_rows(_write_light, count, *arguments, texels, squared, out)
                return
            share_rows(_write_codes, count, *arguments, texels, squared, code_table(), out)
            if alphas is not None:
                mean = np.empty((*out.shape[:2], 3), np.float32)
                share_rows(_write_light, count, *arguments, alphas, False, mean)
                out[..., 3] = np.rint(mean[..., 0] * np.float32(255))

        return write


def _with_hole(colours: np.ndarray) -> np.ndarray:
    """Colours (n, 4) with that of a hole in front, flat."""
    return np.concatenate([np.zeros((1, 4), np.float32), colours]).reshape(-1)


class _Lines:
    """Rays of all panel pixels over a picture; see `of`."""

    def __init__(self, rgbd: RGBD, display: Display, rays: Sequence[Ray]) -> None:
        self._rays = [
            PictureRays(display, rgbd.shape, rgbd.pixel_mm, ray.pixel_offset) for ray in rays
        ]
        self._is_separable = display.is_separable
        if self._is_separable:
            self._u, self._v = (
                np.stack([_parts(*axis.in_cells) for axis in of_axis])
                for of_axis in zip(*(rays.axes for rays in self._rays), strict=True)
            )

    def of(self, rows: slice, sources: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns u and rows v of the rays of some panel rows, in picture pixels.

        * `sources`, (rays, rows, columns) int32: rays between columns without a source are zero.

        Returned values:
        * `u`, (rays, rows or 1, 3, columns) float32: whole part and fraction, less 1/2, at depth 0;
          and slope. The columns are padded.
        * `v`, (rays, rows, 3, columns) float32: only `LANES` columns if all have the same row.
        """
        if self._is_separable:
            v = self._v[:, :, rows].transpose(0, 2, 1)[..., None]
            u = np.pad(self._u[:, None], [(0, 0)] * 3 + [(0, LANES - 1)])
            return u, np.repeat(v, LANES, axis=3)
        hit = np.flatnonzero((sources >= 0).any(axis=(0, 1)))
        columns = slice(hit[0], hit[-1] + 1) if len(hit) else slice(0, 0)
        rays, length, width = sources.shape
        lines = np.zeros((2, rays, length, 3, width + LANES - 1), np.float32)
        for ray, of_ray in enumerate(self._rays):
            u0, du, v0, dv = of_ray.block(rows, columns)[:4]
            for line, (start, slope) in zip(lines, ((u0, du), (v0, dv)), strict=True):
                line[ray, ..., columns] = _parts(start, slope, axis=1)
        return lines[0], lines[1]


def _parts(start: np.ndarray, slope: np.ndarray, axis: int = 0) -> np.ndarray:
    """Rays whose whole part keeps the digits of float32 for the position in a cell."""
    whole = np.floor(start)
    return np.stack([whole, start - whole - 0.5, slope], axis=axis).astype(np.float32)


class _Surfaces(NamedTuple):
    """Surfaces of a picture as tables of its sources; the first entry of each is that of a hole.

    * `head`, (n x 4,) float32: depth, column and row of each source.
    * `near`, (n x 8,) int32: first number, in a table of four to each source, of the neighbours on
      the same surface: on the left and right, above and below, and on the four diagonals in this
      order, rows first; 0 where there is none.
    """

    head: np.ndarray
    near: np.ndarray

    @classmethod
    def of(cls, front: np.ndarray, pixel_mm: float) -> _Surfaces:
        # Zeros take no memory until they are written: most layers are nearly empty.
        head = np.zeros(4 * (front.size + 1), np.float32)
        near = np.zeros(8 * (front.size + 1), np.int32)
        lines = front.shape[0] * front.shape[1]
        share_rows(_survey, lines, front, np.float32(STEEPEST * pixel_mm), head, near)
        return cls(head, near)


@compiled
def _survey(begin, end, front, steepest, head, near):
    """Fill the tables of `_Surfaces`."""
    _, rows, columns = front.shape
    diagonal = steepest * np.float32(np.sqrt(2.0))
    for line in range(begin, end):
        layer, row = divmod(line, rows)
        for column in range(columns):
            depth = front[layer, row, column]
            if depth == -np.inf:
                continue
            place = 1 + line * columns + column
            head[4 * place], head[4 * place + 1], head[4 * place + 2] = depth, column, row
            for k in range(8):
                down = 0 if k < 2 else 2 * (k - 2) - 1 if k < 4 else k // 2 * 2 - 5
                right = 2 * k - 1 if k < 2 else 0 if k < 4 else k % 2 * 2 - 1
                r, c = row + down, column + right
                reach = steepest if k < 4 else diagonal
                neighbour = neighbour_layer(front, r, c, depth, reach)
                if neighbour >= 0:
                    near[8 * place + k] = 4 * (1 + (neighbour * rows + r) * columns + c)


@compiled
def _write_light(begin, end, sources, u, v, head, near, texels, squared, out):
    """Mean light of the rays of some rows, (rows, columns, 3)."""
    share = np.float32(1) / np.float32(len(sources))
    total, scratch = np.empty(4 * _CHUNK, np.float32), np.empty(_SCRATCH * _CHUNK, np.float32)
    tables = head, near, texels, squared, scratch, np.empty(_CHUNK, np.uint32), total
    for i in range(begin, end):
        for first in range(0, sources.shape[2], _CHUNK):
            count = _sum_light(sources, i, first, u, v, *tables)
            for j in range(count):
                for c in range(3):
                    out[i, first + j, c] = share * total[4 * j + c]


@compiled
def _write_codes(begin, end, sources, u, v, head, near, texels, squared, table, out):
    """Mean codes of the rays of some rows, (rows, columns, 4) with alpha."""
    share = np.float32(1) / np.float32(len(sources))
    total, scratch = np.empty(4 * _CHUNK, np.float32), np.empty(_SCRATCH * _CHUNK, np.float32)
    tables = head, near, texels, squared, scratch, np.empty(_CHUNK, np.uint32), total
    for i in range(begin, end):
        row = out[i].reshape(-1)
        for first in range(0, sources.shape[2], _CHUNK):
            count = _sum_light(sources, i, first, u, v, *tables)
            for j in range(count):
                here, place = np.uintp(4 * j), np.uintp(4 * (first + j))
                for c in range(3):
                    light = min(share * total[here + np.uintp(c)], np.float32(1))
                    step = np.uintp(light * np.float32(WHITE) + np.float32(0.5))
                    row[place + np.uintp(c)] = table[step]
                alpha = share * total[here + np.uintp(3)] * np.float32(255)
                row[place + np.uintp(3)] = np.uint8(alpha + np.float32(0.5))


# Numbers of a pixel of a chunk: depth, column and row of its source; weights of the pixels around
# the ray.
_SCRATCH = 7


@compiled
def _sum_light(sources, i, first, u, v, head, near, texels, squared, scratch, side, total):
    """Add up the light of the rays of a chunk of a panel row, from a first pixel on; its length.

    `side` receives the sides of the sources that rays are on, 1 if on the right and 2 if below.
    """
    rays, _, columns = sources.shape
    count, part = min(_CHUNK, columns - first), np.uintp(_CHUNK)
    weight = scratch[3 * _CHUNK :]
    half, zero, unit = same(np.float32(0.5)), same(np.float32(0)), same(np.float32(1))
    no_side, right_side, lower_side = same(np.uint32(0)), same(np.uint32(1)), same(np.uint32(2))
    least, four = same4(np.float32(1e-30)), np.uintp(4)
    total[:] = 0
    for ray in range(rays):
        sources_of_ray, any_source = sources[ray, i, first:], False
        for index in range(count):
            j = np.uintp(index)
            entry = np.uintp(max(sources_of_ray[j], np.int32(-1)) + np.int32(1))
            any_source |= bool(entry > 0)
            for number in range(3):
                here = j + np.uintp(number * _CHUNK)
                scratch[here] = head[entry * four + np.uintp(number)]
        if not any_source:
            continue
        across, down = u[ray, min(i, u.shape[1] - 1)], v[ray, i]
        for begin in range(0, count, LANES):
            j, panel = np.uintp(begin), np.uintp(first + begin)
            depth = load(scratch, j)
            x = _from_centre(across, panel, depth, load(scratch, j + part))
            row = panel if v.shape[3] > LANES else np.uintp(0)
            y = _from_centre(down, row, depth, load(scratch, j + part + part))
            right, below = less(zero, x), less(zero, y)
            store(
                side, j, add(choose(right, right_side, no_side), choose(below, lower_side, no_side))
            )
            x, y = choose(right, x, minus(zero, x)), choose(below, y, minus(zero, y))
            x, y = choose(less(x, half), x, half), choose(less(y, half), y, half)
            diagonal = times(x, y)
            horizontal = minus(x, diagonal)
            store(weight, j, minus(minus(unit, y), horizontal))
            store(weight, j + part, horizontal)
            store(weight, j + part + part, minus(y, diagonal))
            store(weight, j + part + part + part, diagonal)
        for index in range(count):
            j = np.uintp(index)
            place = np.uintp(max(sources_of_ray[j], np.int32(-1)) + np.int32(1)) * four
            sides = np.uintp(side[j])
            numbers = place + place
            beside = np.uintp(near[numbers + (sides & np.uintp(1))])
            under = np.uintp(near[numbers + (sides >> np.uintp(1)) + np.uintp(2)])
            opposite = np.uintp(near[numbers + sides + four])
            light = plus(
                plus(
                    times(same4(weight[j]), load4(texels, place)),
                    times(same4(weight[j + part]), load4(texels, beside)),
                ),
                plus(
                    times(same4(weight[j + part + part]), load4(texels, under)),
                    times(same4(weight[j + part + part + part]), load4(texels, opposite)),
                ),
            )
            of_surface = last4(light)
            light = over(light, choose(less(of_surface, least), least, of_surface))
            if squared:
                light = times(light, light)
            here = j * four
            store(total, here, plus(light, load4(total, here)))
    return count


@compiled
def _from_centre(line, panel, depth, cell):
    """Distance of rays, at some depths, from the centres of some columns or rows of cells."""
    flat, width = line.reshape(-1), np.uintp(line.shape[1])
    start = plus(minus(load(flat, panel), cell), load(flat, panel + width))
    return plus(start, times(load(flat, panel + width + width), depth))
