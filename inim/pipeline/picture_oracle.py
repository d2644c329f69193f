"""How often an algorithm shows another pixel of the picture than the exact first hit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from inim.display import Display
from inim.generators import Sources
from inim.rgbd import RGBD, LayeredRGBD
from inim.stress import first_hits
from inim.stress.rays import lensed_pixels, rays_of

__all__ = ["ExactHits", "exact_hits", "why_no_oracle"]

# Panel pixels that are followed in fractions, a millisecond or two each; a share of one in a
# hundred is known to a quarter of it.
_MOST_PIXELS = 2000


@dataclass(frozen=True)
class ExactHits:
    """What some panel pixels show by the definition of `template`, in rational numbers.

    Attributes
    ----------
    pixels : (n, 2) int
        Row and column of each.
    sources : (n,) int64
    """

    pixels: np.ndarray
    sources: np.ndarray

    def wrong_share(self, sources: Sources) -> float:
        """Share of them that a source map has otherwise."""
        shown = sources[self.pixels[:, 0], self.pixels[:, 1]]
        return float((shown != self.sources).mean())


def why_no_oracle(rgbd: RGBD, display: Display) -> str | None:
    """Why there are no exact hits of a picture on a display; None where there are."""
    if not display.is_separable:
        return (
            "the exact oracle counts rows and columns apart, and this display has "
            f"{display.not_separable_by}"
        )
    if isinstance(rgbd, LayeredRGBD):
        return "the exact oracle knows one layer, and this picture has more"
    return None


def exact_hits(rgbd: RGBD, display: Display, most: int = _MOST_PIXELS) -> ExactHits:
    """Exact first hits of panel pixels under lenses: of all, or of a random sample of them.

    By `inim.stress.first_hits`, which shares no code with the generators.
    """
    pixels = lensed_pixels(display)
    if len(pixels) > most:
        pixels = pixels[np.random.default_rng(0).choice(len(pixels), most, replace=False)]
    rays = rays_of(display, rgbd, pixels)
    return ExactHits(pixels, first_hits.exact_hits(rays, rgbd, display, np.arange(len(pixels))))
