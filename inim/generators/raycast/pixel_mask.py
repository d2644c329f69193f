"""Generating only the panel pixels of a mask: those that a few eyes see, say.

Generators that can are prepared for a list of pixels in place of a panel: they yield one row of
them, (1, n), at a cost that grows with n. `OnPanel` puts that row where it belongs, on a panel that
is black elsewhere. The others are run in full, and `masked` blackens what is outside.

Both show the same bits: in all of the project's generators that are given such a list, what a pixel
shows depends on its own ray and the picture, and on no other pixel.
"""

from __future__ import annotations

from typing import overload

import numpy as np

from inim.display import Display
from inim.generators.base import MASKED, Generator, PixelList, SourceGenerator, Sources, check_out
from inim.rgbd import RGBD

__all__ = ["OnPanel", "is_sparse", "masked", "masked_pixels"]

# Share of the panel above which walking rays one by one takes longer than tables for all of them.
_MOST_ALONE = 0.1


def is_sparse(mask: np.ndarray) -> bool:
    """Whether the pixels of a mask, (rows, columns) bool, are better walked one by one."""
    return bool(np.count_nonzero(mask) <= _MOST_ALONE * mask.size)


def masked_pixels(mask: np.ndarray | None, display: Display) -> PixelList | None:
    """The pixels of a mask, (rows, columns) bool, that lie under a lens; None without a mask."""
    return None if mask is None else PixelList.of(mask & display.lensed)


class OnPanel(SourceGenerator):
    """The pixels of a list on their panel, the others black, with alpha 0.

    Parameters
    ----------
    listed : SourceGenerator
        Prepared for a list of pixels.
    """

    def __init__(self, listed: SourceGenerator) -> None:
        super().__init__(listed.display, listed.shape, listed.pixel_mm)
        assert listed.pixels is not None
        self._listed = listed
        self._at = (listed.pixels.rows, listed.pixels.columns)

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`; `MASKED` elsewhere."""
        found = np.full(self.display.eia_shape, MASKED, np.int32)
        found[self._at] = self._listed.sources(rgbd)[0]
        return found

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`."""
        panel = self.place(rgbd, out)
        panel[...] = 0
        panel[self._at] = self._listed.generate(rgbd)[0]
        return panel


class Masked:
    """A generator run in full, of which only the pixels of a mask are shown.

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
        """See `SourceGenerator.find`; `MASKED` outside the mask."""
        found = self._whole.sources(rgbd)
        return np.where(self._mask, found, np.int32(MASKED))

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`."""
        if rgbd.color.dtype != np.uint8 and self._whole.shows_sources(rgbd):
            return super().generate(rgbd, out)  # without a whole panel of colours between
        return self._shown.generate(rgbd, out)


@overload
def masked(whole: SourceGenerator, mask: np.ndarray) -> SourceGenerator: ...


@overload
def masked(whole: Generator, mask: np.ndarray) -> Generator: ...


def masked(whole: Generator, mask: np.ndarray) -> Generator:
    """A generator run in full, under a mask."""
    if isinstance(whole, SourceGenerator):
        return MaskedSources(whole, mask)
    return Masked(whole, mask)
