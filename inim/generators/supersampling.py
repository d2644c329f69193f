"""Several rays per panel pixel: the same generator on a finer panel, averaged in linear light.

One ray per pixel aliases: an elemental image is a small, sharp picture of the scene, and textures
and silhouettes finer than its pixels flicker. The centres of a pixel's quarters are the pixel
centres of a panel of half the pitch, so samples need no geometry of their own.
"""

from __future__ import annotations

from collections.abc import Callable

import numba
import numpy as np

from inim.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.display import Display, stated
from inim.generators.base import SourceGenerator, check_out
from inim.generators.sources import Sources
from inim.rgbd import RGBD

__all__ = ["Supersampled"]

# Quarters (row, column) of a pixel that each sample count looks through.
_QUARTERS = {2: ((0, 0), (1, 1)), 4: ((0, 0), (0, 1), (1, 0), (1, 1))}


class Supersampled(SourceGenerator):
    """A generator that averages the colours of several rays per pixel.

    Its sources are those of the pixel centres.

    Parameters
    ----------
    centre : SourceGenerator
        The generator of one ray per pixel.
    make : callable
        Makes the same generator for another display.
    samples : {2, 4}
    """

    def __init__(
        self,
        centre: SourceGenerator,
        make: Callable[[Display], SourceGenerator],
        samples: int | str,
    ) -> None:
        super().__init__(centre.display, centre.shape, centre.pixel_mm)
        rows, columns = centre.display.eia_shape
        finer = centre.display.replace(
            pixel_pitch_mm=float(stated(centre.display.pixel_pitch_mm) / 2),
            panel_rows=2 * rows,
            panel_columns=2 * columns,
        )
        self._centre, self._finer = centre, make(finer)
        self._quarters = np.array(_QUARTERS[int(samples)])

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        return self._centre.find(rgbd)

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`."""
        out = check_out(out, rgbd, self.display)
        sources = self._finer.sources(rgbd)
        if rgbd.color.dtype == np.uint8:
            # Light adds up, code values do not: average linear light, then encode again.
            linear = linear_from_srgb(rgbd.color[..., :3] / np.float32(255)).astype(np.float32)
            alpha = rgbd.color[..., 3:].astype(np.float32) / 255
            mean = np.empty((*out.shape[:2], 4), np.float32)
            _average(sources, self._quarters, np.concatenate([linear, alpha], axis=-1), mean)
            out[..., :3] = srgb_to_uint8(srgb_from_linear(mean[..., :3]))
            out[..., 3] = srgb_to_uint8(mean[..., 3])
        else:
            _average(sources, self._quarters, rgbd.color, out)
        return out


@numba.njit(parallel=True, cache=True, nogil=True)
def _average(sources, quarters, color, mean):  # type: ignore[no-untyped-def]
    """Mean colour of the sources in the chosen quarters of each pixel."""
    columns, channels = color.shape[1], color.shape[2]
    share = np.float32(1.0 / len(quarters))
    for row in numba.prange(mean.shape[0]):
        for column in range(mean.shape[1]):
            for c in range(channels):
                mean[row, column, c] = 0
            for i in range(len(quarters)):
                source = sources[2 * row + quarters[i, 0], 2 * column + quarters[i, 1]]
                if source >= 0:
                    for c in range(channels):
                        value = color[source // columns, source % columns, c]
                        mean[row, column, c] += share * value
