"""First hits by Dr.Jit: the engine of `inim.generators.template_jit`.

For GPUs, and, through LLVM, for checking on any machine. The definition and its two ways are those
of `template`; what differs is who does the work:

* Where one list of cells per direction serves all lenses, a lane is one lens seen in one direction,
  *view-major*: neighbouring lanes are neighbouring lenses of the same direction. They read the same
  list entry, and depths that lie side by side, because the picture is laid out by *phases*, as in
  `inim.generators.raycast.polyphase`: a GPU fetches them for a whole warp at once.
* Anywhere else a lane is one panel pixel and walks its own ray. Its arithmetic is that of
  `raycast.traversal`: double precision, whole numbers, and one rounding per quotient.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from inim.display import Display
from inim.display.pixel_axis import PixelAxis
from inim.generators.base import PictureShape, SourceGenerator
from inim.generators.raycast.cells import CellRays, cell_rays
from inim.generators.raycast.direction_lists import (
    DirectionLists,
    build_lists,
    cells_per_pitch,
    shares_directions,
)
from inim.generators.raycast.traversal import entered, leaves
from inim.generators.sources import HOLE, Sources
from inim.render import variant
from inim.rgbd import RGBD

__all__ = ["prepare"]

# A hole, among unsigned sources.
_NOWHERE = HOLE % 2**32


def prepare(display: Display, shape: PictureShape, pixel_mm: float) -> SourceGenerator:
    """See `inim.generators.template_jit.prepare`, which checks the display."""
    if not (mi.variant() or "").startswith(("cuda", "llvm")):
        variant.use()
    if shares_directions(display) and cells_per_pitch(display, pixel_mm):
        return _Shared(display, shape, pixel_mm)
    return _RayByRay(display, shape, pixel_mm)


class _Compiled(SourceGenerator):
    """What both forms share: pictures go to the device, panel words come back."""

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        # A copy: the device's memory stays its own.
        found = np.array(self._show(rgbd, None).numpy().view(np.int32))
        return found.reshape(self.display.eia_shape)

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`; RGBA goes to the panel without a source map between."""
        if rgbd.color.dtype != np.uint8:
            return super().generate(rgbd, out)
        self.check(rgbd)
        out = self.place(rgbd, out)
        words = mi.UInt32(rgbd.color.view(np.uint32).reshape(-1))
        out.view(np.uint32)[..., 0] = self._show(rgbd, words).numpy().reshape(out.shape[:2])
        return out

    @abstractmethod
    def _show(self, rgbd: RGBD, words: Any) -> Any:
        """Of the picture's `words`, (H * W,) UInt32, the one that each panel pixel shows, or 0.

        Without words its source, or `_NOWHERE`: (rows * columns,) UInt32 on the device, either way.
        """


@dataclass(frozen=True)
class _Layout:
    """A picture by phases: the cells of one row at the same place of every pitch side by side.

    Attributes
    ----------
    per_pitch : int
        Picture cells per lens pitch, and phases per row.
    origin : (row, column) of int
        Picture cell that comes first; negative where lists reach beyond the picture.
    down, across : int
        Rows, and slots per phase: all that any list can reach, so no lane has to look.
    """

    per_pitch: int
    origin: tuple[int, int]
    down: int
    across: int

    @classmethod
    def of(cls, lists: DirectionLists, display: Display) -> _Layout:
        """Room for the lists of all lenses."""
        k = lists.per_pitch
        first = (int(lists.row.min()), int(lists.column.min()))
        reach = (int(lists.row.max()) - first[0], int(lists.column.max()) - first[1])
        down = reach[0] + 1 + k * (display.lens_rows - 1)
        return cls(k, first, down, reach[1] // k + display.lens_columns)

    @property
    def lens_row(self) -> int:
        """From one row of lenses to the next; from one lens to its neighbour it is 1."""
        return self.per_pitch * self.per_pitch * self.across

    def place(self, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Where a list's cells lie for the first lens."""
        slot, phase = np.divmod(column - self.origin[1], self.per_pitch)
        return ((row - self.origin[0]) * self.per_pitch + phase) * self.across + slot

    def fill(self, rgbd: RGBD, words: Any) -> tuple[Any, Any]:
        """Depths, -inf where nothing is covered, and words or cell numbers; small launches."""
        lane = dr.arange(mi.UInt32, self.down * self.per_pitch * self.across)
        slot, line = lane % self.across, lane // self.across
        row = mi.Int32(line // self.per_pitch) + self.origin[0]
        column = mi.Int32(slot * self.per_pitch + line % self.per_pitch) + self.origin[1]
        (rows, columns), depth = rgbd.shape, _covered_depth(rgbd)
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        cell = mi.UInt32(row * columns + column)
        laid = dr.select(inside, dr.gather(mi.Float32, depth, cell, inside), -dr.inf)
        payload = cell if words is None else dr.gather(mi.UInt32, words, cell, inside)
        dr.eval(laid, payload)
        return laid, payload


class _Shared(_Compiled):
    """One template per direction for all lenses."""

    def __init__(self, display: Display, shape: PictureShape, pixel_mm: float) -> None:
        super().__init__(display, shape, pixel_mm)
        lists = build_lists(display, shape, pixel_mm)
        self._layout = _Layout.of(lists, display)
        self._pixels = lists.pixels
        self._first = mi.UInt32(lists.first.astype(np.uint32))
        # An entry's place and exit depth are read together, by one load of eight bytes.
        place = self._layout.place(lists.row, lists.column).astype(np.uint32)
        entries = np.stack([place, lists.exit_mm.view(np.uint32)], axis=-1)
        self._entries = mi.UInt32(entries.reshape(-1))

    def _show(self, rgbd: RGBD, words: Any) -> Any:
        depth, payload = self._layout.fill(rgbd, words)
        v, u, m, n = self._lanes()
        found = self._first_hit(depth, v * self._pixels + u, m * self._layout.lens_row + n)
        word = dr.gather(mi.UInt32, payload, found, found != _NOWHERE)
        if words is None:
            word = dr.select(found != _NOWHERE, word, _NOWHERE)
        shown = dr.empty(mi.UInt32, dr.width(word))
        at = ((m * self._pixels + v) * self.display.lens_columns + n) * self._pixels + u
        dr.scatter(shown, word, at, mode=dr.ReduceMode.Permute)
        return shown

    def _lanes(self) -> tuple[Any, Any, Any, Any]:
        """Direction (v, u) and lens (m, n) of each lane: panel rows, in each views, in each lenses.

        Neighbouring lanes write words an elemental image apart. Row by row, the words between
        follow soon and meet them in the cache; were a view's lanes ordered over all lens rows,
        those words would come much later, or a second launch have to transpose.
        """
        lane = dr.arange(mi.UInt32, self.display.eia_shape[0] * self.display.eia_shape[1])
        # Literals, not run-time values: dividing by a known number needs no division.
        line, n = lane // self.display.lens_columns, lane % self.display.lens_columns
        row, u = line // self._pixels, line % self._pixels
        return row % self._pixels, u, row // self._pixels, n

    def _first_hit(self, depth: Any, direction: Any, base: Any) -> Any:
        """Place of the first cell on each lane's list that reaches its ray, or `_NOWHERE`."""
        last = dr.gather(mi.UInt32, self._first, direction + 1)

        def step(entry: Any, found: Any) -> tuple[Any, Any]:
            offset, exit_bits = dr.gather(mi.Vector2u, self._entries, entry)
            place, exit_mm = base + offset, dr.reinterpret_array(mi.Float32, exit_bits)
            hit = dr.gather(mi.Float32, depth, place) >= exit_mm
            return dr.select(hit, last, entry + 1), dr.select(hit, place, found)

        begin = dr.gather(mi.UInt32, self._first, direction)
        state = (begin, mi.UInt32(_NOWHERE))
        return dr.while_loop(state, lambda entry, _: entry < last, step, mode="symbolic")[1]


@dataclass(frozen=True)
class _Axis:
    """Rays along one panel axis, on the device: one per pixel, or one per lane.

    Attributes
    ----------
    start, slope, scale : Float64, Float64, float
        See `CellRays`.
    cell, left : Int32, Float64
        Where each ray is at z_max, and the depth at which it leaves that cell: -inf if it does not
        move in this axis, and then its quotients, of divisions by zero, are never taken.
    lensed, cells : Bool, int
        Whether the pixel is under a lens; the picture's cells.
    """

    start: Any
    slope: Any
    scale: float
    cell: Any
    left: Any
    lensed: Any
    cells: int

    @classmethod
    def of(cls, rays: CellRays, pixels: PixelAxis, cells: int, z_max: float) -> _Axis:
        """Upload the rays of all pixels, where the traversal itself says that they begin."""
        lines = [(*ray, rays.scale) for ray in zip(rays.start, rays.slope, strict=True)]
        cell = [entered(*line, z_max) for line in lines]
        left = [leaves(c, *line) for c, line in zip(cell, lines, strict=True)]
        start, slope, left = (mi.Float64(np.array(a)) for a in (rays.start, rays.slope, left))
        inside, lensed = mi.Int32(np.array(cell, np.int32)), mi.Bool(pixels.lens >= 0)
        return cls(start, slope, rays.scale, inside, left, lensed, cells)

    def at(self, pixel: Any) -> _Axis:
        """The ray of one pixel per lane."""
        arrays = {name: a for name, a in vars(self).items() if dr.is_array_v(a)}
        return replace(self, **{name: dr.gather(type(a), a, pixel) for name, a in arrays.items()})

    def holds(self, cell: Any) -> Any:
        """Whether the picture has such a cell."""
        return (cell >= 0) & (cell < self.cells)

    def cross(self, crossing: Any, cell: Any, left: Any) -> tuple[Any, Any]:
        """The next cell and where the ray leaves it, for lanes that are `crossing`."""
        falling = self.slope > 0
        onward = cell + dr.select(falling, -1, 1)
        border = mi.Float64(dr.select(falling, onward, onward + 1))
        # The product is exact (see `CellRays`): compilers may fuse it with the difference.
        leaving = (border * self.scale - self.start) / self.slope
        return dr.select(crossing, onward, cell), dr.select(crossing, leaving, left)


class _RayByRay(_Compiled):
    """Every ray by itself."""

    def __init__(self, display: Display, shape: PictureShape, pixel_mm: float) -> None:
        super().__init__(display, shape, pixel_mm)
        columns, rows = cell_rays(shape, pixel_mm, display)
        self._z_min, z_max = display.depth_range_mm
        self._columns = _Axis.of(columns, display.columns, shape[1], z_max)
        self._rows = _Axis.of(rows, display.rows, shape[0], z_max)

    def _show(self, rgbd: RGBD, words: Any) -> Any:
        depth = _covered_depth(rgbd)
        dr.eval(depth)
        rows, columns = self.display.eia_shape
        lane = dr.arange(mi.UInt32, rows * columns)
        across, down = self._columns.at(lane % columns), self._rows.at(lane // columns)
        found = self._first_hit(depth, across, down)
        return found if words is None else dr.gather(mi.UInt32, words, found, found != _NOWHERE)

    def _first_hit(self, depth: Any, across: _Axis, down: _Axis) -> Any:
        """`inim.generators.raycast.traversal.first_hit` of each lane's ray."""

        def step(_: Any, u: Any, v: Any, z_u: Any, z_v: Any, found: Any) -> tuple[Any, ...]:
            z_exit = dr.maximum(dr.maximum(z_u, z_v), self._z_min)
            inside = across.holds(u) & down.holds(v)
            cell = mi.UInt32(v * across.cells + u)
            hit = inside & (mi.Float64(dr.gather(mi.Float32, depth, cell, inside)) >= z_exit)
            going = ~hit & (z_exit > self._z_min)
            u, z_u = across.cross(z_u >= z_exit, u, z_u)
            v, z_v = down.cross(z_v >= z_exit, v, z_v)
            return going, u, v, z_u, z_v, dr.select(hit, cell, found)

        begin = (across.cell, down.cell, across.left, down.left, mi.UInt32(_NOWHERE))
        state = (across.lensed & down.lensed, *begin)
        return dr.while_loop(state, lambda going, *_: going, step, mode="symbolic")[-1]


def _covered_depth(rgbd: RGBD) -> Any:
    """Depths, (H * W,) Float32; an uncovered cell is a column without height, as in `template`."""
    covered = mi.Bool(rgbd.covered.reshape(-1))
    return dr.select(covered, mi.Float32(rgbd.depth_mm.reshape(-1)), -dr.inf)
