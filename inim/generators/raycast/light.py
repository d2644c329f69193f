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

from inim.backend.kernels import compiled, prange
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8

#: Steps of light from black to white. Even the darkest codes are five steps apart.
STEPS = 2**14 - 1
_WHITE = 4 * STEPS  # of the sum of four rays
# Alpha in the word of a colour, for one code: the sum of four fits, and its rounding is a shift.
_OPAQUE = 64


@cache
def light_of_codes() -> np.ndarray:
    """Linear light of each 8-bit code, (256,) float32."""
    return linear_from_srgb(np.arange(256, dtype=np.float32) / np.float32(255))


@cache
def code_table() -> np.ndarray:
    """Code of each light from 0 to 1 in steps of 1 / (4 `STEPS`), (n,) uint8."""
    light = np.arange(_WHITE + 1, dtype=np.float32) / np.float32(_WHITE)
    return srgb_to_uint8(srgb_from_linear(light))


def decode_light(colours: np.ndarray) -> np.ndarray:
    """Linear light and opacity, (n, 4) float32, of sRGB codes (n, 4) or linear RGB (n, 3)."""
    light = np.ones((len(colours), 4), np.float32)
    if colours.dtype == np.uint8:
        _decode(colours, light_of_codes(), light)
    else:
        light[:, :3] = colours
    return light


@compiled(parallel=True)
def _decode(codes, light_of_code, light):
    for n in prange(len(codes)):
        for c in range(3):
            light[n, c] = light_of_code[codes[n, c]]
        light[n, 3] = np.float32(codes[n, 3]) / np.float32(255)


@compiled(parallel=True)
def pack_light(light, words):
    """Steps of light and opacity, (n, 4), in the four parts of uint64 words."""
    for n in prange(len(light)):
        word = np.uint64(np.float32(255 * _OPAQUE) * light[n, 3] + np.float32(0.5)) << np.uint64(48)
        for c in range(3):
            steps = np.float32(STEPS) * min(light[n, c], np.float32(1)) + np.float32(0.5)
            word |= np.uint64(steps) << np.uint64(16 * c)
        words[n] = word


@compiled(parallel=True)
def mean_codes(sources, words, table, selected, out):
    """Codes of the mean light of 1, 2 or 4 rays, in the selected channels, and mean alpha.

    Parameters
    ----------
    sources : (rays, rows, columns) int32
    words : (n + 1,) uint64
        Light of a hole and of each source; see `pack_light`.
    table : (m,) uint8
        See `code_table`.
    selected : (3,) bool
    out : (rows, columns) uint32
        RGBA, red in the lowest byte.
    """
    rays, rows, columns = sources.shape
    half, mask = np.uint32(2 * _OPAQUE), np.uint32(0xFF000000)
    for channel in range(3):
        if selected[channel]:
            mask |= np.uint32(0xFF) << np.uint32(8 * channel)
    for i in prange(rows):
        # Two rays count twice, and one four times.
        a, b = sources[0, i], sources[rays // 4, i]
        c, d = sources[rays // 2, i], sources[rays - 1, i]
        line = out[i]
        for index in range(columns):
            j = np.uintp(index)
            light = (words[_place(a[j])] + words[_place(b[j])]) + (
                words[_place(c[j])] + words[_place(d[j])]
            )
            code = ((np.uint32(light >> np.uint64(48)) + half) >> np.uint32(8)) << np.uint32(24)
            for channel in range(3):
                part = np.uintp((light >> np.uint64(16 * channel)) & np.uint64(0xFFFF))
                code |= np.uint32(table[part]) << np.uint32(8 * channel)
            line[j] = (line[j] & ~mask) | (code & mask)


@compiled(parallel=True)
def mean_light(sources, palette, selected, out):
    """Mean of linear colours (n, 3) of some rays, in the selected channels of (rows, columns, 3).

    The mean of equal colours is that colour, bit for bit.
    """
    rays, rows, columns = sources.shape
    share = np.float32(1 / rays)
    for i in prange(rows):
        for j in range(columns):
            first, same = sources[0, i, j], True
            for ray in range(1, rays):
                same &= sources[ray, i, j] == first
            for c in range(3):
                if not selected[c]:
                    continue
                light = np.float32(0)
                if not same:
                    for ray in range(rays):
                        source = sources[ray, i, j]
                        if source >= 0:
                            light += share * palette[source, c]
                elif first >= 0:
                    light = palette[first, c]
                out[i, j, c] = light


@compiled
def _place(source):
    """Index of a source's entry in tables that begin with that of a hole."""
    return np.uintp(np.uint32(max(source, np.int32(-1)) + np.int32(1)))
