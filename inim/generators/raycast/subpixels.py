"""Colours sampled where a panel's sub-pixels really are.

A red stripe at the left of its pixel sends its rays through the lens from there, a third of a pixel
beside the green one's: each colour channel is a picture of its own, seen through points of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from inim.display.panel import SUBPIXELS, SubPixel
from inim.generators.base import SourceGenerator
from inim.generators.sources import Sources
from inim.rgbd import RGBD

__all__ = ["Subpixelled", "by_subpixel"]

_WHOLE = SUBPIXELS["none"][0]


def by_subpixel(pattern: str, make: Callable[[SubPixel], SourceGenerator]) -> SourceGenerator:
    """A generator of all three colours.

    Parameters
    ----------
    pattern : str
        `Display.subpixels`.
    make : callable
        Makes the generator of what one sub-pixel of every pixel shows.
    """
    return make(_WHOLE) if pattern == "none" else Subpixelled(pattern, make)


class Subpixelled(SourceGenerator):
    """A generator that takes each colour channel from a generator of its sub-pixels.

    Its sources are those of the pixel centres. Pixels that lack a colour (`SubPixel.turn`) are
    given the one that their neighbours' place of it would show: panels are driven by whole pixels,
    and leave out what they cannot show. In RGBA, alpha is the mean of the three.

    Parameters are those of `by_subpixel`.
    """

    def __init__(self, pattern: str, make: Callable[[SubPixel], SourceGenerator]) -> None:
        self._make = make
        channels: dict[SubPixel, list[int]] = {}
        for channel, subpixel in enumerate(SUBPIXELS[pattern]):
            place = SubPixel(subpixel.right, subpixel.width)  # wherever it shines
            channels.setdefault(place, []).append(channel)
        self._each = [(make(place), shown) for place, shown in channels.items()]
        one = self._each[0][0]
        super().__init__(one.display, one.shape, one.pixel_mm, one.asked)

    @cached_property
    def _centre(self) -> SourceGenerator:
        """Made when sources are asked for: pictures do without."""
        return self._make(_WHOLE)

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        return self._centre.find(rgbd)

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`."""
        out = self.place(rgbd, out)
        alpha = np.full(out.shape[:2], 1, np.uint16)  # to round the mean to the nearest
        for one, channels in self._each:
            shown = one.generate(rgbd)
            for channel in channels:
                out[..., channel] = shown[..., channel]
            if out.dtype == np.uint8:
                alpha += shown[..., 3] * np.uint16(len(channels))
        if out.dtype == np.uint8:
            out[..., 3] = alpha // 3
        return out
