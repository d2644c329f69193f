# Kernels have no types of their own.
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
"""Linear light of colours: of codes, its mean over rays, and its average over footprints.

Light adds up, code values do not: means are taken in linear light. Those of sRGB codes count in
`STEPS` equal steps, so that four colours of a pixel add up in one 64-bit word and one table has the
code of every sum.

A ray stands for a rectangle of the panel: the emitting area of its pixel or sub-pixel, divided by
the number of samples. At depth z its image, the footprint, has a width of w = |z| / g times that of
the rectangle; under a cylinder it is a parallelogram. The average over it is a diffusion of linear
light between neighbours on the same surface, in passes over distances of 1, 2, 4, ... picture
pixels. Its variance along each axis is w^2 / 12, in picture pixels, minus the variance that is
there anyway: 1/12 of a picture's pixel, or 1/6 of the interpolation. Where that is negative, one
pass over the square roots of light sharpens them. docs/theory/templates.md, "Colour of a ray", has
the formulas.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from inim.generators.raycast.columns import STEEPEST
from inim.generators.raycast.simd import (
    LANES,
    as_uint16,
    choose,
    less,
    load,
    load4,
    minus,
    plus,
    same,
    same4,
    store,
    times,
)
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.system.backend.kernels import compiled, share_rows

#: Steps of light from black to white. Even the darkest codes are five steps apart.
STEPS = 2**14 - 1
#: Light of the sum of four rays.
WHITE = 4 * STEPS
# Alpha in the word of a colour, for one code: the sum of four fits, and its rounding is a shift.
_OPAQUE = 64


@cache
def light_of_codes() -> np.ndarray:
    """Linear light of each 8-bit code, (256,) float32."""
    return linear_from_srgb(np.arange(256, dtype=np.float32) / np.float32(255))


@cache
def code_table() -> np.ndarray:
    """Code of each light from 0 to 1 in steps of 1 / `WHITE`, (n,) uint8."""
    light = np.arange(WHITE + 1, dtype=np.float32) / np.float32(WHITE)
    return srgb_to_uint8(srgb_from_linear(light))


@compiled
def encode_light(words, table, out):
    """RGBA codes, red in the lowest byte, of sums of words of four rays; see `pack_light`."""
    for index in range(len(words)):
        n = np.uintp(index)
        word, code = words[n], np.uint32(0)
        for c in range(3):
            light = np.uintp((word >> np.uint64(16 * c)) & np.uint64(0xFFFF))
            code |= np.uint32(table[light]) << np.uint32(8 * c)
        alpha = (np.uint32(word >> np.uint64(48)) + np.uint32(2 * _OPAQUE)) >> np.uint32(8)
        out[n] = code | alpha << np.uint32(24)


@compiled
def encode_mean(light, share, table, out):
    """RGBA codes of a share of light and opacity.

    * `light`, (n x 4 + LANES,) float32: linear RGB and opacity of each pixel; padded.
    * `table`, (m,) uint8: see `code_table`.
    * `out`, (n,) uint32: red in the lowest byte.
    """
    words, scale = np.empty(len(out) + LANES, np.uint64), np.full(LANES, WHITE, np.float32)
    parts, scale[3::4] = words.view(np.uint16), 4 * 255 * _OPAQUE
    share, unit, half = same(share), same(np.float32(1)), same(np.float32(0.5))
    for begin in range(0, 4 * len(out), LANES):
        place = np.uintp(begin)
        value = times(share, load(light, place))
        value = times(choose(less(value, unit), value, unit), load(scale, np.uintp(0)))
        store(parts, place, as_uint16(plus(value, half)))
    encode_light(words[: len(out)], table, out)


def decode_light(colours: np.ndarray) -> np.ndarray:
    """Linear light and opacity, (n, 4) float32, of sRGB codes (n, 4) or linear RGB (n, 3)."""
    if colours.dtype != np.uint8:
        return np.column_stack([colours, np.ones(len(colours), np.float32)])
    light = np.take(light_of_codes(), colours, mode="clip")  # of no effect, but fast
    np.divide(colours[:, 3], np.float32(255), out=light[:, 3])
    return light


def pack_light(light: np.ndarray, rays: int) -> np.ndarray:
    """Light and opacity, (n, 4), in the four parts of uint64 words, whose sum over all rays counts.

    One ray counts four times, and two count twice.
    """
    parts = np.minimum(light, np.float32(1)) * np.array(
        [STEPS, STEPS, STEPS, 255 * _OPAQUE], np.float32
    )
    parts += np.float32(0.5)
    steps = parts.astype(np.uint16) * np.uint16(4 // rays)
    words: np.ndarray = steps.view(np.uint64)[:, 0]
    return words


@compiled
def copy_codes(begin, end, sources, codes, out):
    """Codes of the sources of some rows.

    * `sources`: (1, rows, columns) int32.
    * `codes`, (n + 1,) uint32: RGBA of a hole and of each source.
    * `out`: (rows, columns) uint32.
    """
    for i in range(begin, end):
        line, row = sources[0, i], out[i]
        for index in range(len(line)):
            j = np.uintp(index)
            row[j] = codes[np.uintp(np.uint32(max(line[j], np.int32(-1)) + np.int32(1)))]


@compiled
def mean_codes(begin, end, sources, words, table, out):
    """Codes of the mean light of the rays of some rows.

    * `sources`: (rays, rows, columns) int32.
    * `words`, (n + 1,) uint64: light of a hole and of each source; see `pack_light`.
    * `table`, (m,) uint8: see `code_table`.
    * `out`, (rows, columns) uint32: RGBA, red in the lowest byte.
    """
    rays, _, columns = sources.shape
    light = np.empty(columns, np.uint64)
    for i in range(begin, end):
        light[:] = 0
        for ray in range(rays):
            line = sources[ray, i]
            for index in range(columns):
                j = np.uintp(index)
                light[j] += words[np.uintp(np.uint32(max(line[j], np.int32(-1)) + np.int32(1)))]
        encode_light(light, table, out[i])


@compiled
def mean_light(begin, end, sources, palette, out):
    """Mean of linear colours (n, 3) of the rays of some rows, in (rows, columns, 3).

    The mean of equal colours is that colour, bit for bit.
    """
    rays, _, columns = sources.shape
    share = np.float32(1 / rays)
    for i in range(begin, end):
        for j in range(columns):
            first, same = sources[0, i, j], True
            for ray in range(1, rays):
                same &= sources[ray, i, j] == first
            for c in range(3):
                light = np.float32(0)
                if not same:
                    for ray in range(rays):
                        source = sources[ray, i, j]
                        if source >= 0:
                            light += share * palette[source, c]
                elif first >= 0:
                    light = palette[first, c]
                out[i, j, c] = light


class Diffusion(NamedTuple):
    """Average over the footprints of rays, along the surfaces of a picture; see the module.

    Light is (layers x H x W, 4) float32: linear RGB, and 1.

    * `front`, (layers, H, W) float32: depth in mm; -inf where there is no surface.
    * `footprint`, (2, 2, 2) float64: size of a ray's footprint, in picture pixels, by axis (down,
      across), side of the panel's rectangle (height, width), and power of the depth in mm (0, 1).
    * `pixel_mm`: width of the picture's pixels.
    * `present`: variance that is there without an average.
    """

    front: np.ndarray
    footprint: np.ndarray
    pixel_mm: float
    present: float

    def average(self, light: np.ndarray) -> np.ndarray:
        """Average the light of pixels."""
        is_surface = self.front > -np.inf
        # Footprints are largest at one end of the depths.
        ends = [float(limit(self.front, where=is_surface, initial=0)) for limit in (np.min, np.max)]
        sides = [self.footprint[..., 0] + self.footprint[..., 1] * depth for depth in ends]
        for stride in _strides(float(np.square(sides).sum(axis=2).max()) / 12 - self.present):
            if stride == 1 or stride < max(self.front.shape[1:]):  # farther there is no pixel
                light = self._pass(light, (0, stride * stride / 4), stride)
        return light

    def sharpen(self, roots: np.ndarray) -> np.ndarray:
        """Sharpen square roots of light where a footprint has less variance than is present."""
        return self._pass(roots, (-self.present, 0))

    def _pass(self, light: np.ndarray, limits: tuple[float, float], stride: int = 1) -> np.ndarray:
        """One pass of the diffusion, whose variance is within limits."""
        result, front = np.empty_like(light), self.front
        share_rows(
            _diffuse, front.shape[0] * front.shape[1], front, light.reshape(-1),
            self.footprint.astype(np.float32) / np.float32(12**0.5), np.float32(self.present),
            *map(np.float32, limits), stride, np.float32(STEEPEST * self.pixel_mm),
            result.reshape(-1),
        )  # fmt: skip
        return result


def _strides(variance: float) -> list[int]:
    """Distances of the neighbours in the passes for a variance, in picture pixels; at least one."""
    strides = [1]
    while variance > (4 ** len(strides) - 1) / 12:  # of all passes so far
        strides.append(2 * strides[-1])
    return strides


@compiled
def _diffuse(begin, end, front, light, scale, present, least, most, stride, steepest, result):
    """One pass of the diffusion: its share of the variance, from neighbours at a distance."""
    _, rows, columns = front.shape
    square = np.float32(stride * stride)
    used = (square - np.float32(1)) / np.float32(12)
    weight = np.float32(0.5) / square
    reach = steepest * np.float32(stride)
    for line in range(begin, end):
        layer, row = divmod(line, rows)
        for column in range(columns):
            depth = front[layer, row, column]
            here = np.uintp(4 * (line * columns + column))
            value = load4(light, here)
            total = value
            for axis in range(2 if depth > -np.inf else 0):
                by_height = scale[axis, 0, 0] + scale[axis, 0, 1] * depth
                by_width = scale[axis, 1, 0] + scale[axis, 1, 1] * depth
                variance = by_height * by_height + by_width * by_width
                share = min(max(variance - present - used, least), most)
                if share == 0:
                    continue
                factor = same4(weight * share)
                for side in (-stride, stride):
                    r = row + side if axis == 0 else row
                    c = column if axis == 0 else column + side
                    neighbour = neighbour_layer(front, r, c, depth, reach)
                    if neighbour >= 0:
                        other = np.uintp(4 * ((neighbour * rows + r) * columns + c))
                        total = plus(total, times(factor, minus(load4(light, other), value)))
            zero = same4(np.float32(0))
            store(result, here, choose(less(total, zero), zero, total))


@compiled
def neighbour_layer(front, row, column, depth, reach):
    """Layer of a pixel that is nearest to a depth and on the same surface; -1 if there is none."""
    layers, rows, columns = front.shape
    r, c = np.uintp(row), np.uintp(column)
    if r >= np.uintp(rows) or c >= np.uintp(columns):  # negative numbers are large ones
        return -1
    nearest = -1
    for layer in range(layers):
        distance = abs(front[np.uintp(layer), r, c] - depth)
        # A choice of values: the compiler makes branches of it three times as slow.
        is_nearer = distance <= reach and reach > 0
        nearest, reach = (layer, distance) if is_nearer else (nearest, reach)
    return nearest
