"""Generating only the panel pixels that somebody asks for: those that a few eyes see, say.

Generators that can are prepared for a list of pixels in place of a panel: they yield one row of
them, (1, n), at a cost that grows with n. `OnPanel` puts that row where it belongs, on a panel that
is black elsewhere. The others are run in full, and `Masked` blackens what was not asked for.

Why it is safe: in all of the project's generators that are given such a list, what a pixel shows
depends on its own ray and the picture, and on no other pixel; it is computed by the same arithmetic
either way, so the bits are the same.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import overload

import numba
import numpy as np

from inim.display import Display
from inim.generators.base import AskedPixels, Generator, SourceGenerator, check_out
from inim.generators.sources import NOT_ASKED, Sources
from inim.rgbd import RGBD

__all__ = ["Masked", "OnPanel", "OntoPanel", "PanelPlaces", "asked_pixels", "masked"]


def asked_pixels(mask: np.ndarray, display: Display) -> AskedPixels:
    """The pixels of a mask, (rows, columns) bool, that lie under a lens."""
    # Of the flat array: NumPy takes three times as long over two dimensions.
    flat = np.flatnonzero(mask & display.lensed)
    return AskedPixels(*np.divmod(flat, display.eia_shape[1]))


@dataclass(frozen=True)
class PanelPlaces:
    """Where the pixels of a list stand on their panel.

    Attributes
    ----------
    first : (panel rows + 1,) int64
        Where the pixels of each row begin in the list.
    column : (n,) uint32
    """

    first: np.ndarray
    column: np.ndarray

    @classmethod
    def of(cls, asked: AskedPixels, rows: int) -> PanelPlaces:
        """Of pixels of a panel with so many rows."""
        first = np.searchsorted(asked.rows, np.arange(rows + 1))
        return cls(first, asked.columns.astype(np.uint32))


class OntoPanel(ABC):
    """A generator prepared for a list of pixels that can show them on their panel at once."""

    @abstractmethod
    def show(self, rgbd: RGBD, places: PanelPlaces, panel: np.ndarray) -> None:
        """Show the colours of the pixels asked for, black elsewhere, (rows, columns, channels)."""


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
        self._places = PanelPlaces.of(listed.asked, self.display.eia_shape[0])

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`; `NOT_ASKED` elsewhere."""
        found = np.empty((*self.display.eia_shape, 1), np.int32)
        listed = self._listed.sources(rgbd).reshape(-1, 1)
        _put(listed, self._places.first, self._places.column, np.int32(NOT_ASKED), found)
        return found[..., 0]

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`."""
        if rgbd.color.dtype == np.uint8 or not self._listed.shows_sources(rgbd):
            listed = self._listed.generate(rgbd)
            panel = self._panel(listed, out)
            _put(listed[0], self._places.first, self._places.column, listed.dtype.type(0), panel)
            return panel
        # Straight to the panel: a list of colours between would take most of the time.
        panel = self._panel(rgbd.color, out)
        if isinstance(self._listed, OntoPanel):
            self._listed.show(rgbd, self._places, panel)
        else:
            sources, palette = self._listed.sources(rgbd)[0], rgbd.palette
            palette = palette.reshape(-1, panel.shape[-1])
            _put_colours(sources, palette, self._places.first, self._places.column, panel)
        return panel

    def _panel(self, colours: np.ndarray, out: np.ndarray | None) -> np.ndarray:
        return check_out(out, (*self.display.eia_shape, colours.shape[-1]), colours.dtype)


# A panel row is written whole, then what was asked for, while it is in the processor's cache.
# Indices are unsigned: signed ones are checked for counting from the end, which takes longer than
# the copying.
@numba.njit(parallel=True, cache=True, nogil=True)
def _put(values, first, column, nothing, out):  # type: ignore[no-untyped-def]
    """``out[row, column[i]] = values[i]``, both (..., channels), and nothing elsewhere."""
    for row in numba.prange(len(out)):
        out[row] = nothing
        for i in range(first[row], first[row + 1]):
            for c in range(values.shape[1]):
                out[row, column[i], c] = values[i, c]


@numba.njit(parallel=True, cache=True, nogil=True)
def _put_colours(sources, palette, first, column, out):  # type: ignore[no-untyped-def]
    """``out[row, column[i]] = palette[sources[i]]`` where there is a source; black elsewhere."""
    for row in numba.prange(len(out)):
        out[row] = 0
        for i in range(first[row], first[row + 1]):
            if sources[i] >= 0:
                source = np.uintp(sources[i])
                for c in range(palette.shape[1]):
                    out[row, column[i], c] = palette[source, c]


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
