# Kernels have no types of their own.
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
"""Colours of rays, interpolated between the pixels of their source's surface.

The point at which a ray meets the surface is the ray's position at the depth of the source, moved
to the border of the source's pixel if it is outside. The colour is interpolated bilinearly between
the centres of the four nearest pixels. Pixels of another surface have no weight, and the weights
of the others are divided by their sum.

Everything that depends on the picture only is tabulated once per picture: which of the eight
neighbours of each pixel are on its surface, and in which layer. The colour of a pixel is a vector
of red, green, blue and 1; that of a hole or a missing neighbour is zero.

Loops over pixels contain no slices of arrays: counting the references to each slice takes longer
than the arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from inim.display import Display
from inim.generators.base import Ray
from inim.generators.raycast.cells import PictureRays
from inim.generators.raycast.columns import STEEPEST
from inim.generators.raycast.light import code_table, encode_mean, neighbour_layer
from inim.generators.raycast.simd import (
    LANES,
    add,
    and_flags,
    as_float,
    choose,
    differ,
    every4,
    less,
    load,
    load4,
    minus,
    multiply,
    over,
    plus,
    same,
    same4,
    shift_right,
    store,
    times,
)
from inim.image.rgbd import RGBD
from inim.system.backend.kernels import compiled, share_rows
from inim.system.errors import UsageError


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
            count, arguments = len(out), (sources, *lines.of(rows, sources), self._surfaces)
            if out.dtype != np.uint8:
                share_rows(_write_light, count, *arguments, texels, squared, out)
                return
            codes = out.view(np.uint32)[..., 0]
            share_rows(_write_codes, count, *arguments, texels, squared, code_table(), codes)
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


# Byte of a neighbour that is in the layer of its source.
_SAME_LAYER = 128


class _Surfaces(NamedTuple):
    """Surfaces of a picture as a table of its sources; the first entry is that of a hole.

    * `table`, (n x 4,) uint32, of each source: the bits of its float32 depth; its row and column,
      which is in the lowest `column_bits`; the layers of its neighbours on the same surface, on
      the left and right, above and below; and those on the diagonals in this order, rows first.
      The layer of a neighbour is a byte: `_SAME_LAYER` plus the difference, or 0 for no neighbour.
    * `columns`, `pixels`: of a layer.
    """

    table: np.ndarray
    column_bits: int
    columns: int
    pixels: int

    @classmethod
    def of(cls, front: np.ndarray, pixel_mm: float) -> _Surfaces:
        layers, rows, columns = front.shape
        if layers > _SAME_LAYER:
            raise UsageError(
                f"the picture has {layers} layers; colours between pixels need at most "
                f"{_SAME_LAYER}: use colour=averaged"
            )
        # Zeros take no memory until they are written: most layers are nearly empty.
        table = np.zeros(4 * (front.size + 1), np.uint32)
        surfaces = cls(table, (columns - 1).bit_length(), columns, rows * columns)
        steepest = np.float32(STEEPEST * pixel_mm)
        share_rows(_survey, layers * rows, front, front.view(np.uint32), steepest, surfaces)
        return surfaces


@compiled
def _survey(begin, end, front, depth_bits, steepest, surfaces):
    """Fill the table of `_Surfaces`."""
    table, (_, rows, columns) = surfaces.table, front.shape
    diagonal = steepest * np.float32(np.sqrt(2.0))
    for line in range(begin, end):
        layer, row = divmod(line, rows)
        for column in range(columns):
            depth = front[layer, row, column]
            if depth == -np.inf:
                continue
            place = 4 * (1 + line * columns + column)
            table[place] = depth_bits[layer, row, column]
            table[place + 1] = row << surfaces.column_bits | column
            for k in range(8):
                down = 0 if k < 2 else 2 * (k - 2) - 1 if k < 4 else k // 2 * 2 - 5
                right = 2 * k - 1 if k < 2 else 0 if k < 4 else k % 2 * 2 - 1
                reach = steepest if k < 4 else diagonal
                neighbour = neighbour_layer(front, row + down, column + right, depth, reach)
                if neighbour >= 0:
                    byte = np.uint32(_SAME_LAYER + neighbour - layer)
                    table[place + 2 + k // 4] |= byte << np.uint32(k % 4 * 8)


@compiled
def _write_light(begin, end, sources, u, v, surfaces, texels, squared, out):
    """Mean light of the rays of some rows, (rows, columns, 3)."""
    share = np.float32(1) / np.float32(len(sources))
    for i in range(begin, end):
        total = _sum_light(sources, i, u, v, surfaces, texels, squared)
        for j in range(out.shape[1]):
            for c in range(3):
                out[i, j, c] = share * total[4 * j + c]


@compiled
def _write_codes(begin, end, sources, u, v, surfaces, texels, squared, table, out):
    """Mean codes of the rays of some rows, (rows, columns) uint32: RGBA, red in the lowest byte."""
    share = np.float32(1) / np.float32(len(sources))
    for i in range(begin, end):
        total = _sum_light(sources, i, u, v, surfaces, texels, squared)
        encode_mean(total, share, table, out[i])


@compiled
def _sum_light(sources, i, u, v, surfaces, texels, squared):
    """Sums of the light of the rays of a panel row, (columns x 4,) float32, padded."""
    line, four, table = np.uintp(i), np.uintp(4), surfaces.table
    column_bits = same(np.uint32(surfaces.column_bits))
    column_mask = same(np.uint32((1 << surfaces.column_bits) - 1))
    total = np.zeros(4 * sources.shape[2] + LANES, np.float32)
    entries = np.empty(4 * LANES, np.uint32)
    depths = entries.view(np.float32)
    # Of the colours of the source and its three neighbours towards the ray; the sum of the weights.
    places, weights = np.empty((4, LANES), np.uint32), np.empty((5, LANES), np.float32)
    for first in range(0, sources.shape[2], LANES):
        start, count = np.uintp(first), min(LANES, sources.shape[2] - first)
        for ray in range(len(sources)):
            number, last = np.uintp(ray), np.int32(-1)
            for index in range(count):
                last = max(last, sources[number, line, start + np.uintp(index)])
            if last < 0:
                continue
            for index in range(count):
                j = np.uintp(index)
                source = max(sources[number, line, start + j], np.int32(-1))
                place = four * np.uintp(source + np.int32(1))
                places[0, j] = place
                store(entries, four * j, load4(table, place))
            depth, cell = every4(depths, np.uintp(0)), every4(entries, np.uintp(1))
            across = np.uintp((ray * u.shape[1] + min(i, u.shape[1] - 1)) * 3 * u.shape[3])
            x = _from_centre(u, across + start, depth, as_float(and_flags(cell, column_mask)))
            down = np.uintp((ray * v.shape[1] + i) * 3 * v.shape[3])
            down += start if v.shape[3] > LANES else np.uintp(0)
            y = _from_centre(v, down, depth, as_float(shift_right(cell, column_bits)))
            sides, diagonals = every4(entries, np.uintp(2)), every4(entries, np.uintp(3))
            _weigh(x, y, sides, diagonals, surfaces, places, weights)
            for index in range(count):
                j = np.uintp(index)
                light = plus(
                    plus(
                        times(same4(weights[0, j]), load4(texels, np.uintp(places[0, j]))),
                        times(same4(weights[1, j]), load4(texels, np.uintp(places[1, j]))),
                    ),
                    plus(
                        times(same4(weights[2, j]), load4(texels, np.uintp(places[2, j]))),
                        times(same4(weights[3, j]), load4(texels, np.uintp(places[3, j]))),
                    ),
                )
                light = over(light, same4(weights[4, j]))
                if squared:
                    light = times(light, light)
                here = four * (start + j)
                store(total, here, plus(light, load4(total, here)))
    return total


@compiled
def _from_centre(lines, place, depth, cell):
    """Distance of rays, at some depths, from the centres of some columns or rows of cells."""
    width = np.uintp(lines.shape[3])
    start = plus(minus(load(lines, place), cell), load(lines, place + width))
    return plus(start, times(load(lines, place + width + width), depth))


@compiled
def _weigh(x, y, sides, diagonals, surfaces, places, weights):
    """Write the places of neighbours, after those of the sources, and the weights of both.

    * `x`, `y`: of the rays, from the centres of their sources.
    * `sides`, `diagonals`: words of the table with the layers of neighbours.
    """
    half, zero, unit = same(np.float32(0.5)), same(np.float32(0)), same(np.float32(1))
    right, below = less(zero, x), less(zero, y)
    x, y = choose(right, x, minus(zero, x)), choose(below, y, minus(zero, y))
    x, y = choose(less(x, half), x, half), choose(less(y, half), y, half)
    corner = times(x, y)
    beside, under = minus(x, corner), minus(y, corner)
    own = minus(minus(unit, y), beside)
    row, layer = 4 * surfaces.columns, 4 * surfaces.pixels
    place = add(load(places, np.uintp(0)), same(np.uint32(-_SAME_LAYER * layer)))
    in_row, down = add(place, _number(right, 4, -4)), _number(below, row, -row)
    by_side, by_row, lower = _number(right, 8, 0), _number(below, 16, 0), _number(below, 24, 16)
    out = places, weights, layer
    beside = _keep(1, beside, shift_right(sides, by_side), in_row, *out)
    under = _keep(2, under, shift_right(sides, lower), add(place, down), *out)
    diagonals = shift_right(diagonals, add(by_side, by_row))
    corner = _keep(3, corner, diagonals, add(in_row, down), *out)
    store(weights, np.uintp(0), own)
    store(weights, np.uintp(4 * LANES), plus(plus(own, beside), plus(under, corner)))


@compiled
def _number(flags, yes, no):
    """One of two whole numbers, by flags."""
    return choose(flags, same(np.uint32(yes)), same(np.uint32(no)))


@compiled
def _keep(number, weight, layers, place, places, weights, layer_size):
    """Write a row of places and weights of neighbours; returns the weights, 0 where there is none.

    * `layers`: in the lowest byte.
    * `place`: in the layer of byte 0.
    """
    layer, zero, at = and_flags(layers, same(np.uint32(255))), same(np.uint32(0)), number * LANES
    place = add(place, multiply(layer, same(np.uint32(layer_size))))
    is_present = differ(layer, zero)
    weight = choose(is_present, weight, same(np.float32(0)))
    store(places, np.uintp(at), choose(is_present, place, zero))
    store(weights, np.uintp(at), weight)
    return weight
