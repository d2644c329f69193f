"""Several rays per panel pixel, averaged in linear light.

One ray per pixel aliases: an elemental image is a small, sharp picture of the scene, and textures
and silhouettes finer than its pixels flicker.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cached_property

import numba
import numpy as np

from inim.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.generators.base import SourceGenerator, check_out
from inim.generators.cells import CENTRE, Aside
from inim.generators.sources import Sources
from inim.panel import SubPixel
from inim.pixel_axis import stated
from inim.rgbd import RGBD

__all__ = ["Supersampled", "sampled_places"]

_A = Fraction(1, 4)
_PLACES: dict[int, tuple[Aside, ...]] = {
    2: ((-_A, -_A), (_A, _A)),
    4: ((-_A, -_A), (-_A, _A), (_A, -_A), (_A, _A)),
}


def sampled_places(samples: int, subpixel: SubPixel, pixel_fill: float) -> tuple[Aside, ...]:
    """Centres of the quarters of what shines of a pixel, that each sample count looks through.

    Parameters
    ----------
    samples : {2, 4}
        Two quarters on a diagonal, or all.
    subpixel : SubPixel
    pixel_fill : float
        `Display.pixel_fill`.
    """
    fill = stated(pixel_fill)
    return tuple(
        (down * fill, subpixel.right + right * subpixel.width * fill)
        for down, right in _PLACES[samples]
    )


class Supersampled(SourceGenerator):
    """A generator that averages the colours of several rays per pixel.

    Its sources are those of the pixel centres.

    Parameters
    ----------
    make : callable
        Makes the generator of the rays through one place of every pixel.
    places : sequence of Aside
    """

    def __init__(self, make: Callable[[Aside], SourceGenerator], places: Sequence[Aside]) -> None:
        self._make = make
        self._each = [make(place) for place in places]
        super().__init__(self._each[0].display, self._each[0].shape, self._each[0].pixel_mm)

    @cached_property
    def _centre(self) -> SourceGenerator:
        """Made when sources are asked for: pictures do without."""
        return self._make(CENTRE)

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        return self._centre.find(rgbd)

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`."""
        out = check_out(out, rgbd, self.display)
        if rgbd.color.dtype != np.uint8:
            self._average(rgbd, rgbd.palette, out)
            return out
        # Light adds up, code values do not: average linear light, then encode again.
        linear = linear_from_srgb(rgbd.palette[..., :3] / np.float32(255))
        alpha = rgbd.palette[..., 3:] / np.float32(255)
        mean = np.empty(out.shape, np.float32)
        self._average(rgbd, np.concatenate([linear, alpha], axis=-1), mean)
        out[..., :3] = srgb_to_uint8(srgb_from_linear(mean[..., :3]))
        out[..., 3] = srgb_to_uint8(mean[..., 3])
        return out

    def _average(self, rgbd: RGBD, color: np.ndarray, mean: np.ndarray) -> None:
        """Mean colour over the places, a hole counting as nothing."""
        mean[:] = 0
        share = np.float32(1 / len(self._each))
        for one in self._each:
            _add(one.sources(rgbd), color, share, mean)


@numba.njit(parallel=True, cache=True, nogil=True)
def _add(sources, color, share, mean):  # type: ignore[no-untyped-def]
    """Add a share of each panel pixel's source colour to its mean."""
    columns, channels = color.shape[1], color.shape[2]
    for row in numba.prange(mean.shape[0]):
        for column in range(mean.shape[1]):
            source = sources[row, column]
            if source >= 0:
                for c in range(channels):
                    mean[row, column, c] += share * color[source // columns, source % columns, c]
