"""`wang2024`: local depth template matching as the paper prints it.

Wang et al., Heritage Science 2024, doi 10.1186/s40494-024-01462-4, Eq. 5 to 10. For the pixels of
one master elemental image the depth range is sampled in z_len steps, each as deep as the ray needs
to move one picture pixel sideways; every combination of a row sample and a column sample is
compared with the depth found there, and the best match gives the source. The same offsets serve
the co-located pixels of all elemental images.

As printed, two things are kept on purpose, because the claim must be testable: the whole
z_len x z_len matrix is searched although the ray only crosses its diagonal, with z depending on
the row alone (a match may lie off the ray); and the best match wins wherever it is on the ray
(occlusion plays no part).

Where the print cannot be followed (see `_steps` and `sources`):

* Eq. 6 rounds up, so the last sample may lie up to one step beyond z_max.
* Eq. 5 divides by |x0 - x|, which is zero under the lens centre: one entry, z_len = 1, at the
  central depth plane. It is printed for x; the larger of the two offsets is used here, so that
  neither axis skips a pixel.
* The paper's picture has no background. Here uncovered pixels match nothing, and a best match
  farther from its surface than one step is no match: a hole.
"""

from __future__ import annotations

import numba
import numpy as np

from inim.display import Display
from inim.generators.base import PictureShape, SourceGenerator
from inim.generators.cells import cell_rays
from inim.generators.sources import HOLE, Sources
from inim.rgbd import RGBD

__all__ = ["prepare"]


def prepare(display: Display, shape: PictureShape, pixel_mm: float) -> SourceGenerator:
    """A generator by local depth template matching; see the module's text."""
    return _Wang2024(display, shape, pixel_mm)


class _Wang2024(SourceGenerator):
    def find(self, rgbd: RGBD) -> Sources:
        column_rays, row_rays = cell_rays(self.shape, self.pixel_mm, self.display)
        z_min, z_max = self.display.depth_range_mm
        single = self.display.central_depth_mm
        if not z_min <= single <= z_max:
            single = (z_min + z_max) / 2
        depth = np.where(rgbd.covered, rgbd.depth_mm, np.float32(np.inf))
        found = np.empty(self.display.eia_shape, np.int32)
        _match_all(
            depth,
            column_rays.start / column_rays.scale,
            column_rays.slope / column_rays.scale,
            row_rays.start / row_rays.scale,
            row_rays.slope / row_rays.scale,
            z_min,
            z_max,
            single,
            found,
        )
        return found


@numba.njit(cache=True, nogil=True)
def _steps(du, dv, z_min, z_max):  # type: ignore[no-untyped-def]
    """Depth step of Eq. 5, one picture pixel of sideways travel, and z_len of Eq. 6."""
    travel = max(abs(du), abs(dv))
    if travel * (z_max - z_min) < 1.0:
        return z_max - z_min, 1
    step = 1.0 / travel
    return step, int(np.ceil((z_max - z_min) / step)) + 1


@numba.njit(parallel=True, cache=True, nogil=True)
def _match_all(depth, u_lens, du, v_lens, dv, z_min, z_max, single, found):  # type: ignore[no-untyped-def]
    """Match every panel pixel; u and v are column and row coordinates in picture pixels."""
    for row in numba.prange(found.shape[0]):
        for column in range(found.shape[1]):
            step, z_len = _steps(du[column], dv[row], z_min, z_max)
            start = single if z_len == 1 else z_min
            found[row, column] = _match(
                depth, u_lens[column], du[column], v_lens[row], dv[row], start, step, z_len
            )


@numba.njit(cache=True, nogil=True)
def _match(depth, u0, du, v0, dv, start, step, z_len):  # type: ignore[no-untyped-def]
    """Eq. 7 to 10: the entry of the z_len x z_len matrix nearest to its template depth."""
    rows, columns = depth.shape
    best, source = step, HOLE
    for i in range(z_len):
        z = start + i * step
        v = int(np.floor(v0 + dv * z))
        if v < 0 or v >= rows:
            continue
        for j in range(z_len):
            u = int(np.floor(u0 + du * (start + j * step)))
            if u < 0 or u >= columns:
                continue
            mismatch = abs(depth[v, u] - z)
            if mismatch < best:
                best, source = mismatch, v * columns + u
    return source
