"""First hits by Dr.Jit: the engine of `inim.generators.template_jit`.

A lane is one panel pixel and walks its own ray. The arithmetic is that of `raycast.ray_by_ray`:
double precision, whole numbers, and one rounding per quotient. Lists of cells shared by all lenses,
as `template` has them, took longer here: 20 ms of processor time through LLVM, and this walk 15
(1088 x 1088 pixels, two picture pixels per pitch).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from inim.display import Display
from inim.display.pixels import PixelAxis
from inim.generators.base import HOLE, PictureShape, SourceGenerator, Sources
from inim.generators.raycast.cells import CellRays, cell_rays
from inim.generators.raycast.columns import SURFACE, columns_of
from inim.generators.raycast.ray_by_ray import entered, leaves
from inim.image.rgbd import RGBD
from inim.render import variant

# A hole, among unsigned sources.
_NOWHERE = HOLE % 2**32


def prepare(display: Display, shape: PictureShape, pixel_mm: float) -> SourceGenerator:
    """See `inim.generators.template_jit.prepare`, which checks the display."""
    with variant.borrowed():
        return _TemplateJit(display, shape, pixel_mm)


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


class _TemplateJit(SourceGenerator):
    """Pictures go to the device, where every ray is walked, and panel words come back."""

    def __init__(self, display: Display, shape: PictureShape, pixel_mm: float) -> None:
        super().__init__(display, shape, pixel_mm)
        columns, rows = cell_rays(shape, pixel_mm, display)
        self._z_min, z_max = display.depth_range_mm
        self._columns = _Axis.of(columns, display.columns, shape[1], z_max)
        self._rows = _Axis.of(rows, display.rows, shape[0], z_max)

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
        words = rgbd.color.view(np.uint32).reshape(-1)
        out.view(np.uint32)[..., 0] = self._show(rgbd, words).numpy().reshape(out.shape[:2])
        return out

    def _show(self, rgbd: RGBD, words: np.ndarray | None) -> Any:
        """Of the picture's `words`, (H * W,) uint32, the one that each panel pixel shows, or 0.

        Without words its source, or `_NOWHERE`: (rows * columns,) UInt32 on the device, either way.
        """
        with variant.borrowed():
            front, back = (_uploaded(depth) for depth in _ends(rgbd))
            rows, columns = self.display.eia_shape
            lane = dr.arange(mi.UInt32, rows * columns)
            across, down = self._columns.at(lane % columns), self._rows.at(lane // columns)
            found = self._first_hit(front, back, across, down)
            if words is None:
                return found
            return dr.gather(mi.UInt32, mi.UInt32(words), found, found != _NOWHERE)

    def _first_hit(self, front: Any, back: Any, across: _Axis, down: _Axis) -> Any:
        """`inim.generators.raycast.ray_by_ray.first_hit` of each lane's ray."""

        def step(
            _: Any, u: Any, v: Any, z_u: Any, z_v: Any, z_entry: Any, over: Any, behind: Any,
            found: Any,
        ) -> tuple[Any, ...]:  # fmt: skip
            z_exit = dr.maximum(dr.maximum(z_u, z_v), self._z_min)
            inside = across.holds(u) & down.holds(v)
            cell = mi.UInt32(v * across.cells + u)
            near = mi.Float64(dr.gather(mi.Float32, front, cell, inside))
            far = mi.Float64(dr.gather(mi.Float32, back, cell, inside))
            reached = inside & (near >= z_exit)
            hit = reached & (far <= z_entry)
            behind |= reached & ~hit
            passed = dr.select(near > -dr.inf, cell, _NOWHERE)
            over = dr.select(inside & ~reached, passed, over)
            ended = ~hit & (z_exit <= self._z_min)
            found = dr.select(hit, cell, dr.select(ended & behind, over, found))
            u, z_u = across.cross(z_u >= z_exit, u, z_u)
            v, z_v = down.cross(z_v >= z_exit, v, z_v)
            return ~hit & ~ended, u, v, z_u, z_v, z_exit, over, behind, found

        nowhere = mi.UInt32(_NOWHERE)
        begin = (across.cell, down.cell, across.left, down.left, mi.Float64(dr.inf), nowhere)
        state = (across.lensed & down.lensed, *begin, mi.Bool(False), mi.UInt32(_NOWHERE))
        return dr.while_loop(state, lambda going, *_: going, step, mode="symbolic")[-1]


def _ends(rgbd: RGBD) -> tuple[np.ndarray, np.ndarray]:
    """Front and back of each pixel's column, (H, W) float32, as in `template`."""
    columns = columns_of(rgbd, SURFACE)
    return columns.fronts()[0], columns.backs()[0]


def _uploaded(depth: np.ndarray) -> Any:
    """Depths on the device, (H * W,) Float32."""
    uploaded = mi.Float32(depth.reshape(-1))
    dr.eval(uploaded)
    return uploaded
