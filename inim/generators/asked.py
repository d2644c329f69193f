"""Generating only the panel pixels that somebody asks for: those that a few eyes see, say.

Generators that can are prepared for a list of pixels in place of a panel: they yield one row of
them, (1, n), at a cost that grows with n. `OnPanel` puts that row where it belongs, on a panel that
is black elsewhere. The others are run in full, and `Masked` blackens what was not asked for.

Why it is safe: in all of the project's generators that are given such a list, what a pixel shows
depends on its own ray and the picture, and on no other pixel; it is computed by the same arithmetic
either way, so the bits are the same.
"""

from __future__ import annotations

from typing import overload

import numba
import numpy as np

from inim.display import Display
from inim.generators.base import AskedPixels, Generator, SourceGenerator, check_out
from inim.generators.sources import NOT_ASKED, Sources
from inim.rgbd import RGBD

__all__ = ["Masked", "OnPanel", "asked_pixels", "masked"]


def asked_pixels(mask: np.ndarray, display: Display) -> AskedPixels:
    """The pixels of a mask, (rows, columns) bool, that lie under a lens."""
    # Of the flat array: NumPy takes three times as long over two dimensions.
    flat = np.flatnonzero(mask & display.lensed)
    return AskedPixels(*np.divmod(flat, display.eia_shape[1]))


class OnPanel(SourceGenerator):
    """The pixels asked for on their panel, the others black, with alpha 0.

    Parameters
    ----------
    listed : SourceGenerator
        Prepared for a list of pixels.
    """

    def __init__(self, listed: SourceGenerator) -> None:
        super().__init__(listed.display, listed.shape, listed.pixel_mm)
        assert listed.asked is not None
        self._listed = listed
        self._at = listed.asked.rows * self.display.eia_shape[1] + listed.asked.columns

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`; `NOT_ASKED` elsewhere."""
        found = np.full(self.display.eia_shape, NOT_ASKED, np.int32)
        _put(self._listed.sources(rgbd).reshape(-1, 1), self._at, found.reshape(-1, 1))
        return found

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`."""
        if rgbd.color.dtype != np.uint8 and self._listed.shows_sources(rgbd):
            return self._colours_on_panel(self._listed.sources(rgbd), rgbd, out)
        return self._on_panel(self._listed.generate(rgbd), out)

    def _on_panel(self, listed: np.ndarray, out: np.ndarray | None) -> np.ndarray:
        black = self._black(listed, out)
        _put(listed[0], self._at, black.reshape(-1, listed.shape[-1]))
        return black

    def _colours_on_panel(self, listed: Sources, rgbd: RGBD, out: np.ndarray | None) -> np.ndarray:
        """Straight to the panel: a list of colours between would take most of the time."""
        black, channels = self._black(rgbd.color, out), rgbd.color.shape[-1]
        flat = black.reshape(-1, channels)
        _put_colours(listed[0], rgbd.palette.reshape(-1, channels), self._at, flat)
        return black

    def _black(self, colours: np.ndarray, out: np.ndarray | None) -> np.ndarray:
        shape = (*self.display.eia_shape, colours.shape[-1])
        if out is None:
            return np.zeros(shape, colours.dtype)  # a page never touched costs nothing
        black = check_out(out, shape, colours.dtype)
        black[...] = 0
        return black


# Indices are unsigned: signed ones are checked for counting from the end, which takes longer than
# the copying.
@numba.njit(parallel=True, cache=True, nogil=True)
def _put(values, at, out):  # type: ignore[no-untyped-def]
    """``out[at[i]] = values[i]``, both (..., channels)."""
    for i in numba.prange(len(at)):
        place = np.uintp(at[i])
        for c in range(values.shape[1]):
            out[place, c] = values[i, c]


@numba.njit(parallel=True, cache=True, nogil=True)
def _put_colours(sources, palette, at, out):  # type: ignore[no-untyped-def]
    """``out[at[i]] = palette[sources[i]]`` where there is a source; both (..., channels)."""
    for i in numba.prange(len(at)):
        if sources[i] >= 0:
            place, source = np.uintp(at[i]), np.uintp(sources[i])
            for c in range(palette.shape[1]):
                out[place, c] = palette[source, c]


class Masked:
    """A generator run in full, of which only what was asked for is shown.

    Parameters
    ----------
    whole : Generator
    mask : (rows, columns) bool
    """

    def __init__(self, whole: Generator, mask: np.ndarray) -> None:
        self._whole, self._mask = whole, mask

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`."""
        eia = self._whole.generate(rgbd)  # it may keep one place to write to: leave that alone
        if out is None:
            out = np.empty_like(eia)
        else:
            check_out(out, eia.shape, eia.dtype)
        out[...] = np.where(self._mask[..., None], eia, np.zeros((), eia.dtype))
        return out


class MaskedSources(SourceGenerator):
    """`Masked`, of a generator that says where its colours come from."""

    def __init__(self, whole: SourceGenerator, mask: np.ndarray) -> None:
        super().__init__(whole.display, whole.shape, whole.pixel_mm)
        self._whole, self._mask, self._shown = whole, mask, Masked(whole, mask)

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`; `NOT_ASKED` where nobody asked."""
        found = self._whole.sources(rgbd)
        return np.where(self._mask, found, np.int32(NOT_ASKED))

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`."""
        return self._shown.generate(rgbd, out)


@overload
def masked(whole: SourceGenerator, mask: np.ndarray) -> SourceGenerator: ...


@overload
def masked(whole: Generator, mask: np.ndarray) -> Generator: ...


def masked(whole: Generator, mask: np.ndarray) -> Generator:
    """A generator that knows of no mask, under one."""
    if isinstance(whole, SourceGenerator):
        return MaskedSources(whole, mask)
    return Masked(whole, mask)
