# Kernels have no types of their own.
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
"""Linear light of colours, and mean light of rays.

Light adds up, code values do not: means are taken in linear light. Those of sRGB codes count in
`STEPS` equal steps, so that four colours of a pixel add up in one 64-bit word and one table has the
code of every sum.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from inim.backend.kernels import compiled
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8

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
def code_steps() -> np.ndarray:
    """Codes of light from 0 to 1 in steps of 1 / (4 `STEPS`), by sixteens, (n,) uint16.

    Of sixteen steps, the low byte has the code of the first, and the high byte the number of steps
    with this code; all others have the next code.
    """
    light = np.arange(WHITE + 1, dtype=np.float32) / np.float32(WHITE)
    codes = srgb_to_uint8(srgb_from_linear(light))
    blocks = np.pad(codes, (0, -len(codes) % 16), mode="edge").reshape(-1, 16)
    first = blocks[:, 0].astype(np.uint16)
    steps: np.ndarray = first | (
        np.count_nonzero(blocks == blocks[:, :1], axis=1).astype(np.uint16) << 8
    )
    return steps


@compiled
def code_of(steps, codes):
    """Code of a light in steps, from the table `code_steps`."""
    entry = np.uint32(codes[np.uintp(steps >> np.uint32(4))])
    is_next = (steps & np.uint32(15)) >= (entry >> np.uint32(8))
    return (entry & np.uint32(255)) + np.uint32(is_next)


@compiled
def encode_light(words, codes, out):
    """RGBA codes, red in the lowest byte, of sums of words of four rays; see `pack_light`."""
    for index in range(len(words)):
        n = np.uintp(index)
        word = words[n]
        low, high = np.uint32(word), np.uint32(word >> np.uint64(32))
        sixteen = np.uint32(16)
        red, green = code_of(low & np.uint32(0xFFFF), codes), code_of(low >> sixteen, codes)
        blue = code_of(high & np.uint32(0xFFFF), codes)
        alpha = ((high >> sixteen) + np.uint32(2 * _OPAQUE)) >> np.uint32(8)
        out[n] = red | green << np.uint32(8) | blue << sixteen | alpha << np.uint32(24)


def decode_light(colours: np.ndarray) -> np.ndarray:
    """Linear light and opacity, (n, 4) float32, of sRGB codes (n, 4) or linear RGB (n, 3)."""
    light = np.ones((len(colours), 4), np.float32)
    if colours.dtype == np.uint8:
        np.take(light_of_codes(), colours[:, :3], out=light[:, :3])
        np.divide(colours[:, 3], np.float32(255), out=light[:, 3])
    else:
        light[:, :3] = colours
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
def mean_codes(begin, end, sources, words, codes, out):
    """Codes of the mean light of the rays of some rows.

    Parameters
    ----------
    begin, end : int
        The rows.
    sources : (rays, rows, columns) int32
    words : (n + 1,) uint64
        Light of a hole and of each source; see `pack_light`.
    codes : (m,) uint16
        See `code_steps`.
    out : (rows, columns) uint32
        RGBA, red in the lowest byte.
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
        encode_light(light, codes, out[i])


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
