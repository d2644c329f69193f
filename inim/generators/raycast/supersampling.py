"""Several rays per panel pixel, averaged in linear light, and rays per sub-pixel.

One ray per pixel aliases: an elemental image is a small, sharp picture of the scene, and textures
and silhouettes finer than its pixels flicker.

The rays of a red stripe start at the left of the pixel, a third of a pixel from the green stripe's:
each colour channel is a separate image with its own rays. Pixels that lack a colour
(`SubPixel.turn`) receive the value of their neighbours' sub-pixel: panels are driven by whole
pixels and omit colours that they cannot show. In RGBA, alpha is the mean of the three.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cache

import numpy as np

from inim.display import Display
from inim.display.pixels import SUBPIXELS, SubPixel, exact_length
from inim.generators.base import CENTRE, PictureShape, PixelOffset, Ray, SourceGenerator, Sources
from inim.generators.raycast.colour import NEAREST, group_rays, show_colours
from inim.image.rgbd import RGBD, LayeredRGBD

_A = Fraction(1, 4)
_PLACES: dict[int, tuple[PixelOffset, ...]] = {
    1: (CENTRE,),
    2: ((-_A, -_A), (_A, _A)),
    4: ((-_A, -_A), (-_A, _A), (_A, -_A), (_A, _A)),
}


def averaged(
    display: Display, samples: int, make: Callable[[PixelOffset], SourceGenerator]
) -> SourceGenerator:
    """Generator with one or several rays per panel pixel or sub-pixel.

    * `samples`, {1, 2, 4}: rays through the centre; through two points on the diagonal; through the
      centres of the quarters of the emitting area (`Display.pixel_fill`). Colours are averaged in
      linear light, and a hole counts as black.
    * `make`: creates the generator of the rays through one point of every pixel.
    """
    channels: dict[SubPixel, list[int]] = {}
    for channel, subpixel in enumerate(SUBPIXELS[display.subpixels]):
        place = SubPixel(subpixel.right, subpixel.width)  # wherever it shines
        channels.setdefault(place, []).append(channel)
    fill = exact_length(display.pixel_fill)
    offsets = [
        ((down * fill, subpixel.right + right * subpixel.width * fill), tuple(of_ray))
        for subpixel, of_ray in channels.items()
        for down, right in _PLACES[samples]
    ]
    rays = [Ray(offset, of_ray, make(offset)) for offset, of_ray in offsets]
    if len(rays) == 1:
        return rays[0].generator
    first = rays[0].generator
    return ColouredRays(rays, cache(lambda: make(CENTRE)), display, first.shape, first.pixel_mm)


class ColouredRays(SourceGenerator):
    """Generator that shows the mean colours of the rays of each pixel.

    Its sources are those of the pixel centres.

    * `centre`: returns the generator of the sources, which pictures do without.
    * `display`, `shape`, `pixel_mm`: as for `SourceGenerator`.
    * `colour`, {"nearest", "linear", "averaged", "smooth"}: see `raycast.colour`.
    """

    def __init__(
        self,
        rays: Sequence[Ray],
        centre: Callable[[], SourceGenerator],
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        colour: str = NEAREST,
        reads: type = LayeredRGBD,
    ) -> None:
        super().__init__(display, shape, pixel_mm)
        self._rays, self._centre, self._colour = list(rays), centre, colour
        self._reads, self._groups = reads, group_rays(rays)

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        return self._centre().sources(rgbd)

    def rays(self) -> list[Ray]:
        """See `SourceGenerator.rays`."""
        return self._rays

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`; a hole counts as black."""
        self.check(rgbd)
        out = self.place(rgbd, out)
        if isinstance(rgbd, LayeredRGBD) and self._reads is RGBD:
            rgbd = RGBD(rgbd.color, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
        show_colours(rgbd, self.display, self._colour, self._groups, out)
        return out
