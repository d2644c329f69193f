"""`template`: the exact first hit of every panel pixel's ray in the picture's columns.

Definition. A depth image is a set of columns, one per covered pixel, solid from far up to its
depth. A panel pixel's ray X(z) = x0 + (x0 - x) z / g (the paper's Eq. 1) is followed from z_max
towards z_min, cell by cell; the first covered cell whose depth is at least the ray's z where it
leaves that cell (or z_min, where the ray ends) gives the source. No such cell: a hole.

A ray that runs exactly along a border between cells belongs to the cell of the larger row or
column; one that crosses exactly at a corner passes to the diagonal neighbour.

Three ways lead to the same sources, bit for bit, on displays that are separable:

* where co-located pixels of all lenses are parallel and the picture has a whole number of pixels
  per pitch, one list of cells per direction serves all lenses (`raycast.direction_lists`),
  and runs over the picture's phases without a gather (`inim.generators.raycast.polyphase`);
* where only the picture is so (15.7 pixels per lens, an elemental-image pitch of its own), strips
  of lenses share cells but not exit depths (`inim.generators.raycast.non_integer_pitch`);
* anywhere else each ray is walked by itself (`inim.generators.raycast.traversal`).

Where only some pixels are asked for, templates run over the few lenses that need them
(`inim.generators.raycast.lens_runs`), and other rays are walked one by one.

A fourth serves the others, hexagonal lattices and arrays that are turned or tilted: each ray by
itself, in float64, exact but for ties (`inim.generators.raycast.non_separable`).

Where a pixel's colours shine from places of their own (`Display.subpixels`), each colour's rays
start there (`inim.generators.raycast.subpixels`); sources are those of the pixel's centre.
"""

from __future__ import annotations

from abc import abstractmethod
from fractions import Fraction

import numpy as np

from inim.display import Display
from inim.display.panel import SubPixel
from inim.display.pixel_axis import PixelAxis
from inim.errors import UsageError
from inim.generators.base import (
    AskedPixels,
    PictureShape,
    SourceGenerator,
)
from inim.generators.raycast.axis_runs import (
    AxisRuns,
    axis_runs,
    doubtful_pixels,
    first_hits_in_runs,
)
from inim.generators.raycast.cells import CENTRE, Aside, CellRays, cell_rays
from inim.generators.raycast.direction_lists import build_lists, cells_per_pitch, shares_directions
from inim.generators.raycast.lens_runs import AskedRuns, LensRuns, column_bounds
from inim.generators.raycast.non_integer_pitch import (
    cell_pairs,
    row_runs,
    run_strips,
    strip_columns,
)
from inim.generators.raycast.non_separable import FreeRays
from inim.generators.raycast.pixel_mask import OnPanel, OntoPanel, PanelPlaces, asked_pixels
from inim.generators.raycast.polyphase import Phases, index_payload, run_templates
from inim.generators.raycast.ray_length import check_ray_length, fits_tables
from inim.generators.raycast.subpixels import by_subpixel
from inim.generators.raycast.traversal import first_hits, first_hits_at, starts
from inim.generators.sources import HOLE, Sources
from inim.rgbd import RGBD

__all__ = ["prepare", "ray_by_ray"]


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
    display, shape, pixel_mm, mask :
        See `inim.generators.prepare`.
    samples : {1, 2, 4}
        Rays per panel pixel, or per sub-pixel where it has some: through its centre; through two
        points on its diagonal; through the centres of its quarters, or of those of its shining part
        (`Display.pixel_fill`). Colours are averaged in linear light, a hole counting as black.

    Raises
    ------
    UsageError
        Another number of samples, or rays so long that they are a slip.
    """
    if str(samples) not in ("1", "2", "4"):
        raise UsageError(f"template: samples = {samples!r}; use 1, 2 or 4")
    check_ray_length("template", display, shape, pixel_mm)

    asked = None if mask is None else asked_pixels(mask, display)

    def first_hits_through(aside: Aside) -> SourceGenerator:
        if not display.is_separable:
            return FreeRays(display, shape, pixel_mm, aside, asked)
        if not fits_tables(display, shape, pixel_mm):
            return _RayByRay(display, shape, pixel_mm, aside, asked)
        if shares_directions(display):
            return _Shared(display, shape, pixel_mm, aside, asked)
        if asked is not None:
            return _InRuns(display, shape, pixel_mm, aside, asked)
        return _Strips(display, shape, pixel_mm, aside)

    def seen_from(subpixel: SubPixel) -> SourceGenerator:
        if int(samples) == 1:
            return first_hits_through((Fraction(0), subpixel.right))
        from inim.generators.raycast.supersampling import Supersampled, sampled_places

        places = sampled_places(int(samples), subpixel, display.pixel_fill)
        return Supersampled(first_hits_through, places)

    made = by_subpixel(display.subpixels, seen_from)
    return made if asked is None else OnPanel(made)


def ray_by_ray(display: Display, shape: PictureShape, pixel_mm: float) -> SourceGenerator:
    """The same first hits without tables: what those are held against, on separable displays."""
    return _RayByRay(display, shape, pixel_mm)


class _Aligned(SourceGenerator):
    """Whole cells per lens pitch: lenses meet the same cells, moved by whole lenses."""

    def __init__(
        self,
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        asked: AskedPixels | None = None,
    ) -> None:
        super().__init__(display, shape, pixel_mm, asked)
        self._index = index_payload(shape)
        self._holds_index = False
        self._phases: Phases  # made by each in its way

    def _fill(self, rgbd: RGBD, payload: np.ndarray) -> None:
        """Take in a picture; the index, which is that of every picture, only once."""
        of_index = payload is self._index
        known, self._holds_index = of_index and self._holds_index, False
        self._phases.fill(rgbd.depth_mm, rgbd.covered, None if known else payload)
        self._holds_index = of_index

    @abstractmethod
    def _run(self, rgbd: RGBD, payload: np.ndarray, empty: int, out: np.ndarray) -> None:
        """Show each pixel of `made_shape` the payload of its first hit, all uint32."""

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        found = np.empty(self.made_shape, np.int32)
        self._run(rgbd, self._index, HOLE % 2**32, found.view(np.uint32))
        return found

    def shows_sources(self, rgbd: RGBD) -> bool:  # noqa: ARG002
        """See `SourceGenerator.shows_sources`."""
        return True

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`; RGBA goes to the panel without a source map between."""
        if rgbd.color.dtype != np.uint8:
            return super().generate(rgbd, out)
        self.check(rgbd)
        out = self.place(rgbd, out)
        self._run(rgbd, rgbd.color.view(np.uint32)[..., 0], 0, out.view(np.uint32)[..., 0])
        return out


class _Shared(_Aligned, OntoPanel):
    """One template per direction for all lenses."""

    def __init__(
        self,
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        aside: Aside = CENTRE,
        asked: AskedPixels | None = None,
    ) -> None:
        super().__init__(display, shape, pixel_mm, asked)
        self._lists = build_lists(display, shape, pixel_mm, aside)
        lenses = (display.lens_rows, display.lens_columns)
        self._phases = Phases.make(
            self._lists.per_pitch, self._lists.row, self._lists.column, lenses
        )
        self._offset = self._phases.row_offset(self._lists.row) + self._phases.column_offset(
            self._lists.column
        )
        by_pixel_row = self._lists.first[: -1 : self._lists.pixels]
        self._reach = self._phases.row_reach(self._lists.row, by_pixel_row)
        self._tables = (self._lists, self._offset, self._reach, self._phases)
        self._asked_runs: AskedRuns | None = None
        if asked is not None:
            across = column_bounds(self._lists, self._phases)
            runs = LensRuns.of(asked, self._lists.pixels, lenses)
            self._asked_runs = AskedRuns(*self._tables, across, runs)

    def _run(self, rgbd: RGBD, payload: np.ndarray, empty: int, out: np.ndarray) -> None:
        self._fill(rgbd, payload)
        if self._asked_runs is None:
            run_templates(*self._tables, empty, out)
        else:
            self._asked_runs.show(empty, out[0])

    def show(self, rgbd: RGBD, places: PanelPlaces, panel: np.ndarray) -> None:
        """See `OntoPanel.show`."""
        assert self._asked_runs is not None
        self.check(rgbd)
        self._fill(rgbd, self._index)
        palette = rgbd.palette.reshape(-1, panel.shape[-1])
        self._asked_runs.show_colours(palette, places.first, places.column, panel)


class _Strips(_Aligned):
    """Directions differ from lens to lens: exit depths are vectors along a strip of lenses."""

    def __init__(
        self, display: Display, shape: PictureShape, pixel_mm: float, aside: Aside = CENTRE
    ) -> None:
        super().__init__(display, shape, pixel_mm)
        per_pitch = cells_per_pitch(display, pixel_mm)
        assert per_pitch is not None
        rays = cell_rays(shape, pixel_mm, display, aside)
        columns, rows = (axis_runs(axis, display.depth_range_mm) for axis in rays)
        self._phases = Phases.make(
            per_pitch,
            _relative(rows, display.rows, per_pitch),
            _relative(columns, display.columns, per_pitch),
            (display.lens_rows, display.lens_columns),
        )
        self._rows = row_runs(display, rows, per_pitch, self._phases)
        self._columns = strip_columns(display, columns, per_pitch, self._phases)
        self._pairs = cell_pairs(self._rows, self._columns)
        doubtful = np.zeros(display.eia_shape, bool)
        doubtful.flat[doubtful_pixels(rows, columns)] = True
        at = asked_pixels(doubtful, display)
        self._doubtful = _InRuns(display, shape, pixel_mm, aside, at)

    def _run(self, rgbd: RGBD, payload: np.ndarray, empty: int, out: np.ndarray) -> None:
        self._fill(rgbd, payload)
        run_strips(self._rows, self._columns, self._pairs, self._phases, empty, out)
        at = self._doubtful.asked
        if at is not None and len(at.rows):
            known = np.append(payload.reshape(-1), np.uint32(empty))
            out[at.rows, at.columns] = known[self._doubtful.sources(rgbd)[0]]


def _relative(runs: AxisRuns, pixels: PixelAxis, per_pitch: int) -> np.ndarray:
    """Cells of all lensed runs, as if under the lens 0."""
    owner = np.repeat(pixels.lens, np.diff(runs.first))
    cells: np.ndarray = (runs.cell - per_pitch * owner)[owner >= 0]
    return cells


class _InRuns(SourceGenerator):
    """The rays asked for by themselves, over the runs of their rows and columns."""

    def __init__(
        self,
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        aside: Aside,
        asked: AskedPixels,
    ) -> None:
        super().__init__(display, shape, pixel_mm, asked)
        self._pixels = asked
        columns, rows = cell_rays(shape, pixel_mm, display, aside)
        self._columns = axis_runs(columns, display.depth_range_mm)
        self._rows = axis_runs(rows, display.depth_range_mm)

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        depth = np.where(rgbd.covered, rgbd.depth_mm, np.float32(-np.inf))
        found = np.empty(self.made_shape, np.int32)
        first_hits_in_runs(self._rows, self._columns, self._pixels, depth, found[0])
        return found


class _RayByRay(SourceGenerator):
    """Every ray, or those asked for, by itself."""

    def __init__(
        self,
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        aside: Aside = CENTRE,
        asked: AskedPixels | None = None,
    ) -> None:
        super().__init__(display, shape, pixel_mm, asked)
        columns, rows = cell_rays(shape, pixel_mm, display, aside)
        rays = (
            *(columns.start, columns.slope, columns.scale),
            *(rows.start, rows.slope, rows.scale),
        )
        self._rays = rays
        if asked is None:
            self._reach = (
                *_reach(columns, display.columns, display),
                *_reach(rows, display.rows, display),
            )

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        # An uncovered cell is a column without height: it never reaches a ray.
        depth = np.where(rgbd.covered, rgbd.depth_mm, np.float32(-np.inf))
        z_min, z_max = self.display.depth_range_mm
        found = np.empty(self.made_shape, np.int32)
        if self.asked is not None:
            rows, columns = self.asked.rows, self.asked.columns
            first_hits_at(rows, columns, depth, self._rays, z_min, z_max, found[0])
            return found
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
