# Kernels have no types of their own.
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
"""Colours of rays, evaluated after their sources: nearest pixel, interpolated or averaged.

Definition. The sources of an algorithm do not depend on the colour. ``nearest`` copies the colour
of the source. The others also read its neighbours on the same surface: covered pixels whose depth
differs by no more than `STEEPEST` times their distance; of several layers the nearest in depth.

Interpolation (``linear``, ``smooth``). The point at which a ray meets the surface is the ray's
position at the depth of the source, moved to the border of the source's pixel if it is outside. The
colour is interpolated bilinearly between the centres of the four nearest pixels. Pixels of another
surface have no weight, and the weights of the others are divided by their sum.

Footprint (``averaged``, ``smooth``). A ray stands for a rectangle of the panel: the emitting area
of its pixel or sub-pixel, divided by the number of samples. At depth z its image has a width of
w = |z| / g times that of the rectangle. Colours are averaged over this width, in linear light, on
the picture: each pixel has one depth, and so one width. The average is a diffusion. Its variance
along each axis is w^2 / 12, in picture pixels, minus the variance that the picture's pixel
already has: 1/12 if the nearest pixel is copied, and 1/6 if colours are interpolated. Pass
k = 0, 1, 2, ... adds the differences to the four neighbours at a distance of s = 2^k pixels, each
with half of the pass's variance divided by s^2. It contributes at most s^2 / 4. The first
passes are used up first.

``linear`` interpolates linear light. ``smooth`` averages linear light and interpolates its square
roots, which are close to code values: dark pixels next to bright ones keep their weight. Where the
variance is negative (at least -1/6), one pass over the square roots sharpens them, which
compensates the blur of interpolation.

The mean over the rays of a pixel is taken in linear light, as always; a hole counts as black.

Everything that depends on the picture only is tabulated once per picture: the eight neighbours of
each pixel on its surface, and averaged colours. All ways to find sources share the kernels below,
which take the sources of some panel rows, so their colours agree bit for bit. The colour of a pixel
is a vector of red, green, blue and 1: its last part adds up to the weight of the pixels that were
read, and a missing neighbour is zero.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from inim.backend.kernels import compiled, prange
from inim.display import Display
from inim.display.pixels import SUBPIXELS, pixel_rays, row_blocks
from inim.generators.base import Ray
from inim.generators.raycast.cells import cell_rays, non_separable_cell_rays
from inim.generators.raycast.columns import STEEPEST
from inim.generators.raycast.light import (
    code_table,
    decode_light,
    mean_codes,
    mean_light,
    pack_light,
)
from inim.generators.raycast.simd import (
    LANES,
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
from inim.image.noisy_image import row_bands
from inim.image.rgbd import RGBD

NEAREST, LINEAR, AVERAGED, SMOOTH = "nearest", "linear", "averaged", "smooth"

# Variance that the picture's pixel, or the interpolation, already has.
_VARIANCE = {AVERAGED: 1 / 12, SMOOTH: 1 / 6}
# Sources at once, of all rays: they stay in the cache that the threads share.
_SOURCES_AT_ONCE = 2**22
# Panel pixels whose rays are interpolated at once: their positions stay in the first cache.
_CHUNK = 4 * LANES

#: Writes the mean colours of rays, from the sources of some panel rows.
_Writer = Callable[[slice, np.ndarray, np.ndarray], None]


def show_colours(
    rgbd: RGBD, display: Display, colour: str, rays: Sequence[Ray], out: np.ndarray
) -> None:
    """Write the mean colours of the rays of every pixel.

    Parameters
    ----------
    rgbd : RGBD
    display : Display
    colour : {"nearest", "linear", "averaged", "smooth"}
    rays : sequence of Ray
        One, two or four rays for each of their `channels`.
    out : (rows, columns, 3) float32 or (rows, columns, 4) uint8
        Alpha is the mean of the channels.
    """
    groups: dict[tuple[int, ...], list[Ray]] = {}
    for ray in rays:
        groups.setdefault(ray.channels, []).append(ray)
    picture = _Picture(rgbd, display, colour)
    coded = out.dtype == np.uint8
    alpha = np.full(out.shape[:2], 1, np.uint16) if coded and len(groups) > 1 else None
    for channels, group in groups.items():
        searches = [ray.generator.search(rgbd) for ray in group]
        write = picture.writer(channels, group)
        bands = list(_bands(display, out.shape[:2], len(group)))
        sources = np.empty((len(group), _length(bands[0]), out.shape[1]), np.int32)
        for rows in bands:
            band = sources[:, : _length(rows)]
            for search, of_ray in zip(searches, band, strict=True):
                search(rows, of_ray)
            write(rows, band, out[rows])
        if alpha is not None:
            alpha += out[..., 3] * np.uint16(len(channels))
    if alpha is not None:
        out[..., 3] = alpha // 3


def _bands(display: Display, shape: tuple[int, int], rays: int) -> Iterator[slice]:
    """Rows of a result that are processed at once."""
    if shape == display.eia_shape and not display.is_separable:
        return row_blocks(display)
    return row_bands(shape[0], shape[1] * rays, _SOURCES_AT_ONCE)


def _length(rows: slice) -> int:
    return int(rows.stop - rows.start)


class _Picture:
    """Colours of one picture; see `show_colours`."""

    def __init__(self, rgbd: RGBD, display: Display, colour: str) -> None:
        self._rgbd, self._display, self._colour = rgbd, display, colour
        self._coded = rgbd.color.dtype == np.uint8
        palette = rgbd.palette.reshape(-1, rgbd.color.shape[2])
        if colour == NEAREST and not self._coded:
            self._light = palette
            return
        self._light = decode_light(palette)
        if colour == NEAREST:
            return
        self._opacity = self._light[:, 3].copy()
        self._light[:, 3] = 1
        no_depth = np.float32(-np.inf)
        self._front = np.stack(
            [np.where(layer.covered, layer.front_mm, no_depth) for layer in rgbd.layers]
        )
        if colour in (LINEAR, SMOOTH):
            self._surfaces = _Surfaces.of(self._front, rgbd.pixel_mm)

    def writer(self, channels: tuple[int, ...], rays: Sequence[Ray]) -> _Writer:
        """Function that writes the mean colours of rays to their channels."""
        selected = np.isin(np.arange(3), channels)
        light = self._light
        if self._colour in _VARIANCE:
            pixel_mm, present = self._rgbd.pixel_mm, _VARIANCE[self._colour]
            footprint = _footprint(self._display, pixel_mm, channels, len(rays))
            light = diffused(self._front, light, footprint, pixel_mm, present)
            if self._colour == SMOOTH:
                np.sqrt(light, out=light)
                light = sharpened(self._front, light, footprint, pixel_mm, present)
        if self._colour in (LINEAR, SMOOTH):
            return self._interpolating_writer(light, rays, selected)
        if not self._coded:
            return lambda _, sources, out: mean_light(sources, light, selected, out)
        if self._colour == AVERAGED:
            light[:, 3] = self._opacity
        words = np.zeros(len(light) + 1, np.uint64)
        pack_light(light, words[1:])
        return lambda _, sources, out: mean_codes(
            sources, words, code_table(), selected, out.view(np.uint32)[..., 0]
        )

    def _interpolating_writer(
        self, light: np.ndarray, rays: Sequence[Ray], selected: np.ndarray
    ) -> _Writer:
        squared = self._colour == SMOOTH
        texels = np.zeros((len(light) + 1, 4), np.float32)
        texels[1:] = light
        covered = self._front.reshape(-1) > -np.inf
        opacity = None
        if self._coded and (self._opacity[covered] != 1).any():
            opacity = np.zeros_like(texels)
            opacity[1:] = self._opacity[:, None]
            opacity[1:, 3] = 1
        lines = _Lines(self._rgbd, self._display, rays)
        tables = (self._surfaces.head, self._surfaces.near)

        def write(rows: slice, sources: np.ndarray, out: np.ndarray) -> None:
            arguments = (sources, *lines.of(rows), *tables)
            if not self._coded:
                _interpolated_light(*arguments, texels.reshape(-1), squared, selected, out)
                return
            _interpolated_codes(
                *arguments, texels.reshape(-1), squared, selected, code_table(), out
            )
            if opacity is not None:
                mean = np.empty((*out.shape[:2], 3), np.float32)
                alone = np.array([True, False, False])
                _interpolated_light(*arguments, opacity.reshape(-1), False, alone, mean)
                out[..., 3] = np.rint(mean[..., 0] * np.float32(255))

        return write


class _Lines:
    """Rays of all panel pixels over a picture; see `of`."""

    def __init__(self, rgbd: RGBD, display: Display, rays: Sequence[Ray]) -> None:
        self._size, self._display = (rgbd.shape, rgbd.pixel_mm), display
        self._offsets = [ray.pixel_offset for ray in rays]
        if display.is_separable:
            axes = [cell_rays(*self._size, display, offset) for offset in self._offsets]
            self._u, self._v = (
                np.stack([_parts(ray.start / ray.scale, ray.slope / ray.scale) for ray in of_axis])
                for of_axis in zip(*axes, strict=True)
            )

    def of(self, rows: slice) -> tuple[np.ndarray, np.ndarray]:
        """Columns u and rows v of the rays of some panel rows, in picture pixels.

        Returns
        -------
        u : (rays, rows or 1, 3, columns) float32
            Whole part and fraction, less 1/2, at depth 0; and slope. The columns are padded.
        v : (rays, rows, 3, columns or 1) float32
        """
        if self._display.is_separable:
            v = self._v[:, :, rows].transpose(0, 2, 1)[..., None]
            return _padded(self._u[:, None]), np.ascontiguousarray(v)
        lines = []
        for offset in self._offsets:
            block = pixel_rays(self._display, rows, (float(offset[0]), float(offset[1])))
            lines.append(np.broadcast_arrays(*non_separable_cell_rays(*self._size, block)))
        u0, du, v0, dv = np.array(lines).transpose(1, 0, 2, 3)
        return _padded(_parts(u0, du, axis=2)), _padded(_parts(v0, dv, axis=2))


def _parts(start: np.ndarray, slope: np.ndarray, axis: int = 0) -> np.ndarray:
    """Rays whose whole part keeps the digits of float32 for the position in a cell."""
    whole = np.floor(start)
    return np.stack([whole, start - whole - 0.5, slope], axis=axis).astype(np.float32)


def _padded(lines: np.ndarray) -> np.ndarray:
    """Lines with elements for all lanes of their last pixel."""
    return np.pad(lines, [(0, 0)] * 3 + [(0, LANES - 1)])


def _footprint(
    display: Display, pixel_mm: float, channels: tuple[int, ...], samples: int
) -> tuple[float, float]:
    """Height and width of a ray's footprint, in picture pixels per millimetre of depth."""
    width = 1.0 if len(channels) == 3 else float(SUBPIXELS[display.subpixels][channels[0]].width)
    side = display.pixel_pitch_mm * display.pixel_fill / samples**0.5 / display.gap_mm / pixel_mm
    return side, width * side


def diffused(
    front: np.ndarray,
    light: np.ndarray,
    footprint: tuple[float, float],
    pixel_mm: float,
    present: float,
) -> np.ndarray:
    """Light of pixels averaged over the surfaces around them; see the module's definition.

    Parameters
    ----------
    front : (layers, H, W) float32
        Depth in mm; -inf where there is no surface.
    light : (layers x H x W, 4) float32
        Linear RGB, and 1.
    footprint : (down, across)
        Height and width of a ray's footprint, in picture pixels per millimetre of depth.
    pixel_mm : float
        Width of a picture pixel.
    present : float
        Variance that is there without an average.

    Returns
    -------
    (layers x H x W, 4) float32
    """
    farthest = float(np.abs(front, where=front > -np.inf, out=np.zeros_like(front)).max())
    for stride in _strides((max(footprint) * farthest) ** 2 / 12 - present):
        light = _diffused(
            front, light, footprint, pixel_mm, present, (0, stride * stride / 4), stride
        )
    return light


def sharpened(
    front: np.ndarray,
    roots: np.ndarray,
    footprint: tuple[float, float],
    pixel_mm: float,
    present: float,
) -> np.ndarray:
    """Square roots of light, sharpened where a footprint has less variance than is present.

    Parameters and result are those of `diffused`.
    """
    return _diffused(front, roots, footprint, pixel_mm, present, (-present, 0))


def _diffused(
    front: np.ndarray,
    light: np.ndarray,
    footprint: tuple[float, float],
    pixel_mm: float,
    present: float,
    limits: tuple[float, float],
    stride: int = 1,
) -> np.ndarray:
    """One pass of the diffusion, whose variance is within limits."""
    result = np.empty_like(light)
    _diffuse(
        front, light.reshape(-1), np.array(footprint, np.float32) / np.float32(12**0.5),
        np.float32(present), *map(np.float32, limits), stride, np.float32(STEEPEST * pixel_mm),
        result.reshape(-1),
    )  # fmt: skip
    return result


def _strides(variance: float) -> list[int]:
    """Distances of the neighbours in the passes for a variance, in picture pixels; at least one."""
    strides = [1]
    while variance > (4 ** len(strides) - 1) / 12:  # of all passes so far
        strides.append(2 * strides[-1])
    return strides


@compiled(parallel=True)
def _diffuse(front, light, scale, present, least, most, stride, steepest, result):
    """One pass of the diffusion: its share of the variance, from neighbours at a distance."""
    layers, rows, columns = front.shape
    square = np.float32(stride * stride)
    used = (square - np.float32(1)) / np.float32(12)
    weight = np.float32(0.5) / square
    reach = steepest * np.float32(stride)
    for index in prange(layers * rows):
        line = np.int64(index)  # the loop's index is unsigned
        layer, row = divmod(line, rows)
        for column in range(columns):
            depth = front[layer, row, column]
            here = np.uintp(4 * (line * columns + column))
            value = load4(light, here)
            total = value
            for axis in range(2):
                width = scale[axis] * depth
                share = min(max(width * width - present - used, least), most)
                if share == 0 or depth == -np.inf:
                    continue
                factor = same4(weight * share)
                for side in (-stride, stride):
                    r = row + side if axis == 0 else row
                    c = column if axis == 0 else column + side
                    neighbour = _neighbour(front, r, c, depth, reach)
                    if neighbour >= 0:
                        other = np.uintp(4 * ((neighbour * rows + r) * columns + c))
                        total = plus(total, times(factor, minus(load4(light, other), value)))
            zero = same4(np.float32(0))
            store(result, here, choose(less(total, zero), zero, total))


@compiled
def _neighbour(front, row, column, depth, reach):
    """Layer of a pixel that is nearest to a depth and on the same surface; -1 if there is none."""
    if not (0 <= row < front.shape[1] and 0 <= column < front.shape[2]):
        return -1
    nearest = -1
    for layer in range(front.shape[0]):
        distance = abs(front[layer, row, column] - depth)
        if distance <= reach:
            reach, nearest = distance, layer
            if distance == 0:
                break
    return nearest


class _Surfaces(NamedTuple):
    """Surfaces of a picture as tables of its sources; the first entry of each is that of a hole.

    Attributes
    ----------
    head : (n x 4,) float32
        Depth, column and row of each source.
    near : (n x 8,) int32
        First number, in a table of four to each source, of the neighbours on the same surface: on
        the left and right, above and below, and on the four diagonals in this order, rows first;
        0 where there is none.
    """

    head: np.ndarray
    near: np.ndarray

    @classmethod
    def of(cls, front: np.ndarray, pixel_mm: float) -> _Surfaces:
        # Zeros take no memory until they are written: most layers are nearly empty.
        head = np.zeros(4 * (front.size + 1), np.float32)
        near = np.zeros(8 * (front.size + 1), np.int32)
        _survey(front, np.float32(STEEPEST * pixel_mm), head, near)
        return cls(head, near)


@compiled(parallel=True)
def _survey(front, steepest, head, near):
    """Fill the tables of `_Surfaces`."""
    layers, rows, columns = front.shape
    diagonal = steepest * np.float32(np.sqrt(2.0))
    for index in prange(layers * rows):
        line = np.int64(index)
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
                neighbour = _neighbour(front, r, c, depth, reach)
                if neighbour >= 0:
                    near[8 * place + k] = 4 * (1 + (neighbour * rows + r) * columns + c)


@compiled(parallel=True)
def _interpolated_light(sources, u, v, head, near, texels, squared, selected, out):
    """Mean light of rays, in the selected channels of (rows, columns, 3) linear light."""
    share = np.float32(1) / np.float32(len(sources))
    for row in prange(sources.shape[1]):
        i = np.int64(row)
        buffers = _buffers()
        for first in range(0, sources.shape[2], _CHUNK):
            count = _sum_light(sources, i, first, u, v, head, near, texels, squared, *buffers)
            for j in range(count):
                for c in range(3):
                    if selected[c]:
                        out[i, first + j, c] = share * buffers[4][4 * j + c]


@compiled(parallel=True)
def _interpolated_codes(sources, u, v, head, near, texels, squared, selected, table, out):
    """Mean codes; see `_interpolated_light`: out is (rows, columns, 4) with alpha."""
    share = np.float32(1) / np.float32(len(sources))
    white = np.float32(len(table) - 1)
    for row in prange(sources.shape[1]):
        i = np.int64(row)
        buffers = _buffers()
        total, line = buffers[4], out[i].reshape(-1)
        for first in range(0, sources.shape[2], _CHUNK):
            count = _sum_light(sources, i, first, u, v, head, near, texels, squared, *buffers)
            for j in range(count):
                here, place = np.uintp(4 * j), np.uintp(4 * (first + j))
                for c in range(3):
                    if selected[c]:
                        light = min(share * total[here + np.uintp(c)], np.float32(1))
                        code = table[np.uintp(light * white + np.float32(0.5))]
                        line[place + np.uintp(c)] = code
                alpha = share * total[here + np.uintp(3)] * np.float32(255)
                line[place + np.uintp(3)] = np.uint8(alpha + np.float32(0.5))


@compiled
def _buffers():
    """Places, sides, positions, weights and light of the pixels of a chunk."""
    return (
        np.zeros(_CHUNK, np.uint32), np.zeros(2 * _CHUNK, np.uint32),
        np.zeros(3 * _CHUNK, np.float32), np.zeros(4 * _CHUNK, np.float32),
        np.zeros(4 * _CHUNK, np.float32),
    )  # fmt: skip


@compiled
def _sum_light(
    sources, i, first, u, v, head, near, texels, squared, place, side, position, weight, total
):
    """Add up the light of the rays of a chunk of a panel row, from a first pixel on; its length."""
    rays, _, columns = sources.shape
    count = min(_CHUNK, columns - first)
    total[:] = 0
    for ray in range(rays):
        any_source = _locate(sources[ray, i, first : first + count], head, place, position)
        if any_source:
            across, down = u[ray, min(i, u.shape[1] - 1)], v[ray, i]
            _weigh(count, first, across, down, position, side, weight)
            _add_light(count, place, side, weight, near, texels, squared, total)
    return count


@compiled
def _locate(sources, head, place, position):
    """Table entries, depths, columns and rows of some sources; true if there are any."""
    any_source = False
    for j in range(len(sources)):
        source, here = sources[j], np.uintp(j)
        any_source |= source >= 0
        entry = np.uint32(max(source, np.int32(-1)) + np.int32(1))
        place[here] = entry
        for part in range(3):
            at = np.uintp(4) * np.uintp(entry) + np.uintp(part)
            position[here + np.uintp(part * _CHUNK)] = head[at]
    return any_source


@compiled
def _weigh(count, first, u, v, position, side, weight):
    """Weights of the four pixels around each ray, and the sides of its source that they are on."""
    half, zero, unit = same(np.float32(0.5)), same(np.float32(0)), same(np.float32(1))
    yes, no = same(np.uint32(1)), same(np.uint32(0))
    part = np.uintp(_CHUNK)
    for begin in range(0, count, LANES):
        j, panel = np.uintp(begin), np.uintp(first + begin)
        depth = load(position, j)
        x = _from_centre(u, panel, depth, load(position, j + part))
        if v.shape[1] == 1:
            y = plus(minus(same(v[0, 0]), load(position, j + part + part)), same(v[1, 0]))
            y = plus(y, times(same(v[2, 0]), depth))
        else:
            y = _from_centre(v, panel, depth, load(position, j + part + part))
        right, below = less(zero, x), less(zero, y)
        store(side, j, choose(right, yes, no))
        store(side, j + part, choose(below, yes, no))
        x, y = choose(right, x, minus(zero, x)), choose(below, y, minus(zero, y))
        x, y = choose(less(x, half), x, half), choose(less(y, half), y, half)
        diagonal = times(x, y)
        horizontal = minus(x, diagonal)
        store(weight, j, minus(minus(unit, y), horizontal))
        store(weight, j + part, horizontal)
        store(weight, j + part + part, minus(y, diagonal))
        store(weight, j + part + part + part, diagonal)


@compiled
def _from_centre(line, panel, depth, cell):
    """Distance of rays, at some depths, from the centres of some columns or rows of cells."""
    flat, width = line.reshape(-1), np.uintp(line.shape[1])
    start = plus(minus(load(flat, panel), cell), load(flat, panel + width))
    return plus(start, times(load(flat, panel + width + width), depth))


@compiled
def _add_light(count, place, side, weight, near, texels, squared, total):
    """Add the interpolated light of one ray of each pixel of a chunk."""
    least, part = same4(np.float32(1e-30)), np.uintp(_CHUNK)
    four, eight = np.uintp(4), np.uintp(8)
    for index in range(count):
        j = np.uintp(index)
        entry, right, below = np.uintp(place[j]), np.uintp(side[j]), np.uintp(side[j + part])
        of_entry = entry * eight
        beside = np.uintp(near[of_entry + right])
        under = np.uintp(near[of_entry + below + np.uintp(2)])
        across = np.uintp(near[of_entry + right + below + below + four])
        light = plus(
            plus(
                times(same4(weight[j]), load4(texels, entry * four)),
                times(same4(weight[j + part]), load4(texels, beside)),
            ),
            plus(
                times(same4(weight[j + part + part]), load4(texels, under)),
                times(same4(weight[j + part + part + part]), load4(texels, across)),
            ),
        )
        of_surface = last4(light)
        light = over(light, choose(less(of_surface, least), least, of_surface))
        if squared:
            light = times(light, light)
        at = j * four
        store(total, at, plus(light, load4(total, at)))
