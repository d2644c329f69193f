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
def mean_codes(begin, end, sources, words, table, out):
    """Codes of the mean light of the rays of some rows.

    * `begin`, `end`: the rows.
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
