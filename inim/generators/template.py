"""`template`: the exact first hit of every panel pixel's ray in the picture's columns.

Definition. A depth image is a set of columns, one per covered pixel, solid from far up to its
depth. A panel pixel's ray X(z) = x0 + (x0 - x) z / g (the paper's Eq. 1) is followed from z_max
towards z_min, cell by cell; the first covered cell whose depth is at least the ray's z where it
leaves that cell (or z_min, where the ray ends) gives the source. No such cell: a hole.

A ray that runs exactly along a border between cells belongs to the cell of the larger row or
column; one that crosses exactly at a corner passes to the diagonal neighbour.

Two ways lead to the same sources, bit for bit:

* where co-located pixels of all lenses are parallel and the picture has a whole number of pixels
  per pitch, one list of cells per direction serves all lenses (`inim.generators.direction_lists`),
  and runs over the picture's phases without a gather (`inim.generators.polyphase`);
* anywhere else (15.7 pixels per lens, an elemental-image pitch of its own, any picture), and where
  only some pixels are asked for, each ray is walked by itself (`inim.generators.traversal`).
"""

from __future__ import annotations

import numpy as np

from inim.display import Display, PixelAxis
from inim.errors import UsageError
from inim.generators.base import PictureShape, SourceGenerator, check_out
from inim.generators.cells import CENTRE, Aside, CellRays, cell_rays
from inim.generators.direction_lists import build_lists, cells_per_pitch, shares_directions
from inim.generators.polyphase import Phases, index_payload, run_templates
from inim.generators.sources import HOLE, NOT_ASKED, Sources
from inim.generators.traversal import first_hits, first_hits_at, starts
from inim.rgbd import RGBD

__all__ = ["prepare"]


def prepare(
    display: Display,
    shape: PictureShape,
    pixel_mm: float,
    *,
    samples: int | str = 1,
    mask: np.ndarray | None = None,
) -> SourceGenerator:
    """A generator of exact first hits.

    Parameters
    ----------
    display, shape, pixel_mm :
        See `inim.generators.prepare`.
    samples : {1, 2, 4}
        Rays per panel pixel: through its centre; through two points on its diagonal; through the
        centres of its quarters. Colours are averaged in linear light, a hole counting as black.
    mask : (rows, columns) bool, optional
        Panel pixels asked for; the others are left black and cost nothing.

    Raises
    ------
    UsageError
        Another number of samples, or a mask of another shape.
    """
    if str(samples) not in ("1", "2", "4"):
        raise UsageError(f"template: samples = {samples!r}; use 1, 2 or 4")
    if mask is not None and np.shape(mask) != display.eia_shape:
        raise UsageError(
            f"template: mask of shape {np.shape(mask)}; the panel has {display.eia_shape}"
        )
    alike = mask is None and shares_directions(display) and cells_per_pitch(display, pixel_mm)

    def first_hits_through(aside: Aside) -> SourceGenerator:
        if alike:
            return _Shared(display, shape, pixel_mm, aside)
        return _RayByRay(display, shape, pixel_mm, aside, mask)

    if int(samples) == 1:
        return first_hits_through(CENTRE)
    from inim.generators.supersampling import Supersampled

    return Supersampled(first_hits_through, int(samples))


class _Shared(SourceGenerator):
    """One template per direction for all lenses."""

    def __init__(
        self, display: Display, shape: PictureShape, pixel_mm: float, aside: Aside = CENTRE
    ) -> None:
        super().__init__(display, shape, pixel_mm)
        self._lists = build_lists(display, shape, pixel_mm, aside)
        self._phases = Phases.make(self._lists, display.lens_rows, display.lens_columns)
        self._index = index_payload(shape)

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        found = np.empty(self.display.eia_shape, np.int32)
        self._run(rgbd, self._index, HOLE % 2**32, found.view(np.uint32))
        return found

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`; RGBA goes to the panel without a source map between."""
        if rgbd.color.dtype != np.uint8:
            return super().generate(rgbd, out)
        self.check(rgbd)
        out = check_out(out, rgbd, self.display)
        self._run(rgbd, rgbd.color.view(np.uint32)[..., 0], 0, out.view(np.uint32)[..., 0])
        return out

    def _run(self, rgbd: RGBD, payload: np.ndarray, empty: int, out: np.ndarray) -> None:
        run_templates(self._lists, self._phases, rgbd.depth_mm, rgbd.covered, payload, empty, out)


class _RayByRay(SourceGenerator):
    """Every ray, or those asked for, by itself."""

    def __init__(
        self,
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        aside: Aside = CENTRE,
        mask: np.ndarray | None = None,
    ) -> None:
        super().__init__(display, shape, pixel_mm)
        self._asked = None if mask is None else np.flatnonzero(mask)
        columns, rows = cell_rays(shape, pixel_mm, display, aside)
        self._rays = (
            *(columns.start, columns.slope, columns.scale),
            *(rows.start, rows.slope, rows.scale),
        )
        self._reach = (
            *_reach(columns, display.columns, display),
            *_reach(rows, display.rows, display),
        )

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        # An uncovered cell is a column without height: it never reaches a ray.
        depth = np.where(rgbd.covered, rgbd.depth_mm, np.float32(-np.inf))
        z_min, z_max = self.display.depth_range_mm
        if self._asked is not None:
            found = np.full(self.display.eia_shape, NOT_ASKED, np.int32)
            first_hits_at(self._asked, depth, self._rays, z_min, z_max, found)
            return found
        found = np.empty(self.display.eia_shape, np.int32)
        lens_u, lens_v = (axis.lens for axis in (self.display.columns, self.display.rows))
        start = starts(depth, *self._reach, z_max)
        first_hits(depth, self._rays, lens_u, lens_v, start, z_min, found)
        return found


def _reach(rays: CellRays, pixels: PixelAxis, display: Display) -> tuple[np.ndarray, np.ndarray]:
    """First cell and one past the last that any ray of each lens can visit, along one axis."""
    ends = np.array(display.depth_range_mm)
    at = (rays.start + rays.slope * ends[:, None]) / rays.scale
    low, high = np.floor(at.min(axis=0)) - 1, np.floor(at.max(axis=0)) + 2  # a cell for rounding
    lenses = int(pixels.lens.max()) + 1
    first, last = np.full(lenses, np.inf), np.full(lenses, -np.inf)
    lensed = pixels.lens >= 0
    np.minimum.at(first, pixels.lens[lensed], low[lensed])
    np.maximum.at(last, pixels.lens[lensed], high[lensed])
    bare = first > last  # a lens over no pixel of this panel
    first[bare], last[bare] = 0, 0
    return first.astype(np.int64), last.astype(np.int64)
