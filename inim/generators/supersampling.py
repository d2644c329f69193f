"""Several rays per panel pixel, averaged in linear light.

One ray per pixel aliases: an elemental image is a small, sharp picture of the scene, and textures
and silhouettes finer than its pixels flicker.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from functools import cached_property

import numba
import numpy as np

from inim.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.generators.base import SourceGenerator, check_out
from inim.generators.cells import CENTRE, Aside
from inim.generators.sources import Sources
from inim.rgbd import RGBD

__all__ = ["Supersampled"]

_A = Fraction(1, 4)
#: Centres of the quarters of a pixel, (down, right), that each sample count looks through.
_PLACES: dict[int, tuple[Aside, ...]] = {
    2: ((-_A, -_A), (_A, _A)),
    4: ((-_A, -_A), (-_A, _A), (_A, -_A), (_A, _A)),
}


class Supersampled(SourceGenerator):
    """A generator that averages the colours of several rays per pixel.

    Its sources are those of the pixel centres.

    Parameters
    ----------
    make : callable
        Makes the generator of the rays through one place of every pixel.
    samples : {2, 4}
    """

    def __init__(self, make: Callable[[Aside], SourceGenerator], samples: int) -> None:
        self._make = make
        self._each = [make(place) for place in _PLACES[samples]]
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
            self._average(rgbd, rgbd.color, out)
            return out
        # Light adds up, code values do not: average linear light, then encode again.
        linear = linear_from_srgb(rgbd.color[..., :3] / np.float32(255))
        alpha = rgbd.color[..., 3:] / np.float32(255)
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
