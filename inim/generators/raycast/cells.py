"""Panel rays over the cells of a picture, exact where lengths are."""

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from inim.display import Display
from inim.display.pixels import CENTRE, PixelAxis, PixelOffset, pixel_rays, row_blocks
from inim.generators.base import HOLE, PanelRays, Sources, run_kernel
from inim.system.errors import UsageError

# Whole numbers up to here are floats, and the quotient of two is rounded once.
_EXACT = 2**53
# Picture pixels on one ray: ten thousand times those of usual displays.
_MOST_CELLS = 1_000_000


class CellRays(NamedTuple):
    """Rays of one panel axis over the cells of a picture.

    The ray of panel pixel `i` crosses the border before cell `j` at the depth
    ``z = (j scale - start[i]) / slope[i]`` in millimetres; columns count from the picture's left
    border, rows from its top, downwards.

    All three are whole numbers wherever the display's lengths are short decimals or fractions. Each
    depth is then rounded once, from the exact one: borders of rows and columns that meet in a
    corner meet in the same float, and comparing a float32 depth with them is exact.

    * `start`, `slope`, (n,) float64: lens centre in cells, and cells per millimetre towards the
      viewer, both times a common factor (slopes may carry a power of two besides).
    * `scale`: one cell times that factor.
    """

    start: np.ndarray
    slope: np.ndarray
    scale: float

    @property
    def in_cells(self) -> tuple[np.ndarray, np.ndarray]:
        """Start and slope in cells, rounded as floats are."""
        return self.start / self.scale, self.slope / self.scale

    def most_cells(self, depth_range_mm: tuple[float, float]) -> int:
        """More cells than any of the rays can visit along this axis."""
        z_min, z_max = depth_range_mm
        return math.ceil(float(np.abs(self.slope).max()) / self.scale * (z_max - z_min)) + 3


@lru_cache(maxsize=32)
def cell_rays(
    shape: tuple[int, int], pixel_mm: float, display: Display, pixel_offset: PixelOffset = CENTRE
) -> tuple[CellRays, CellRays]:
    """Column rays and row rays of a display over a picture.

    * `pixel_offset`, (down, right) of Fraction: start of each ray in its pixel, in panel pixels
      from the centre.
    """
    rows, columns = shape
    down, right, _ = pixel_offset
    return (
        _axis(display.columns, pixel_mm, columns, display, +1, right),
        _axis(display.rows, pixel_mm, rows, display, -1, down),
    )


class RayBlock(NamedTuple):
    """Rays of some panel rows over a picture.

    Ray (i, j) is at depth z, in millimetres, in column ``(u0 + du z) / u_scale`` and in row
    ``(v0 + dv z) / v_scale``.

    * `u0`, `du`, `v0`, `dv`: (rows, panel columns) float64.
    """

    u0: np.ndarray
    du: np.ndarray
    v0: np.ndarray
    dv: np.ndarray
    u_scale: float
    v_scale: float


class PictureRays:
    """Rays of a display's pixels, from one point of each, over pictures of one size.

    * `pixel_offset`, (down, right) of Fraction: see `cell_rays`.
    """

    def __init__(
        self,
        display: Display,
        shape: tuple[int, int],
        pixel_mm: float,
        pixel_offset: PixelOffset = CENTRE,
    ) -> None:
        self.display = display
        self._size, self._offset = (shape, pixel_mm), pixel_offset

    @cached_property
    def axes(self) -> tuple[CellRays, CellRays]:
        """Rays of the columns and the rows of a separable display."""
        return cell_rays(*self._size, self.display, self._offset)

    def block(
        self, rows: slice, columns: slice = slice(None), *, in_cells: bool = False
    ) -> RayBlock:
        """Rays of some panel rows and columns.

        Exact where the display is separable (see `CellRays`), unless `in_cells`; otherwise rounded
        as floats are, in cells.
        """
        if self.display.is_separable:
            across, down = self.axes
            if in_cells:
                across, down = (CellRays(*axis.in_cells, 1.0) for axis in (across, down))
            lines = (
                across.start[columns], across.slope[columns],
                down.start[rows, None], down.slope[rows, None],
            )  # fmt: skip
            scales = across.scale, down.scale
        else:
            (height, width), pixel_mm = self._size
            rays = pixel_rays(self.display, rows, self._offset, columns)
            lines = (
                rays.x0 / pixel_mm + width / 2,
                rays.slope_x / pixel_mm,
                height / 2 - rays.y0 / pixel_mm,
                -rays.slope_y / pixel_mm,
            )
            scales = 1.0, 1.0
        width = len(range(*columns.indices(self.display.eia_shape[1])))
        shape = (rows.stop - rows.start, width)
        u0, du, v0, dv = (np.broadcast_to(line, shape) for line in lines)
        return RayBlock(u0, du, v0, dv, *scales)


def search_rays(
    kernel: Any, rays: PanelRays, pixel_offset: PixelOffset, *arguments: Any
) -> Sources:
    """Sources of the selected panel pixels' rays, which a kernel finds in blocks of rows.

    The kernel (`inim.generators.base.run_kernel`) gets the rays of a block in cells, with columns
    before rows: starts u and v, and slopes; then the pixels to search, and the arguments.
    """
    picture = PictureRays(rays.display, rays.shape, rays.pixel_mm, pixel_offset)
    sources, selected = np.full(rays.display.eia_shape, HOLE, np.int32), rays.selected
    for rows in row_blocks(rays.display):
        if selected[rows].any():
            lines = picture.block(rows, in_cells=True)[:4]
            shape = lines[0].shape
            sources[rows] = run_kernel(
                kernel, len(lines[0]), shape, *lines, selected[rows], *arguments
            )
    return sources


@dataclass(frozen=True)
class AxisRuns:
    """Cells of each panel column's (or row's) ray along that axis, nearest first.

    A ray's cells in the picture are the overlaps of its column runs with its row runs.

    * `count`, (n,) int64: cells of each ray.
    * `cell`, (n, most) int64: picture column (row).
    * `exit_mm`, (n, most) float64: depth at which the ray leaves it; z_min at the end, and after
      it.
    """

    count: np.ndarray
    cell: np.ndarray
    exit_mm: np.ndarray

    @property
    def entry_mm(self) -> np.ndarray:
        """Depths at which the rays enter their cells, (n, most) float64; inf at the first."""
        before = np.full((len(self.cell), 1), np.inf)
        return np.concatenate([before, self.exit_mm[:, :-1]], axis=1)

    @property
    def used(self) -> np.ndarray:
        """Cells that the rays visit, (n, most) bool."""
        return np.arange(self.cell.shape[1]) < self.count[:, None]


def axis_runs(rays: CellRays, depth_range_mm: tuple[float, float]) -> AxisRuns:
    """The runs of all rays of one axis."""
    z_min, z_max = depth_range_mm
    start, slope = rays.start[:, None], rays.slope[:, None]
    # z falls along a ray. The product is rounded: begin with the cell before.
    step = np.where(slope > 0, -1, 1)
    begin = np.floor((start + slope * z_max) / rays.scale).astype(np.int64) - step * (slope != 0)
    cell = begin + step * np.arange(rays.most_cells(depth_range_mm) + 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        exits = ((cell + (slope <= 0)) * rays.scale - start) / slope
    exits[slope[:, 0] == 0] = -np.inf  # they never move
    # Cells are entered just below z_max, or above it.
    above = np.count_nonzero(exits >= z_max, axis=1)
    count = np.count_nonzero(exits > z_min, axis=1) - above + 1
    place = np.minimum(above[:, None] + np.arange(count.max()), cell.shape[1] - 1)
    exits = np.maximum(np.take_along_axis(exits, place, axis=1), z_min)
    return AxisRuns(count, np.take_along_axis(cell, place, axis=1), exits)


def rounded_up(values: np.ndarray) -> np.ndarray:
    """The smallest float32 that is not below each float64."""
    near = values.astype(np.float32)
    above = np.nextafter(near, np.float32(np.inf))
    return np.where(near.astype(np.float64) < values, above, near)


def most_cells(display: Display, shape: tuple[int, int], pixel_mm: float) -> float:
    """Largest number of a picture's columns or rows that a ray crosses within the depth range."""
    depths = display.traced_range_mm
    if display.is_separable:
        rays = cell_rays(shape, pixel_mm, display)
        return float(max(axis.most_cells(depths) for axis in rays))
    return max(display.steepest_slopes) * (depths[1] - depths[0]) / pixel_mm


def check_ray_length(name: str, display: Display, shape: tuple[int, int], pixel_mm: float) -> None:
    """Raise `UsageError` for rays that the generator `name` would walk for ever."""
    longest = most_cells(display, shape, pixel_mm)
    if longest > _MOST_CELLS:
        raise UsageError(
            f"{name}: a ray crosses {longest:.3g} picture pixels within the depth range; at most "
            f"{_MOST_CELLS} make sense; state a shorter depth_min_mm to depth_max_mm, or "
            "larger picture pixels"
        )


def _axis(
    pixels: PixelAxis,
    cell_mm: float,
    cells: int,
    display: Display,
    sign: int,
    pixel_offset: Fraction,
) -> CellRays:
    cell, gap = display.exact_mm(cell_mm), display.exact_mm(display.gap_mm)
    # In cells: start = cells / 2 + centre / cell, slope = offset unit / (cell gap).
    per_offset = sign * pixels.unit_mm / pixel_offset.denominator / (cell * gap)
    per_centre = sign * pixels.unit_mm / cell
    # Powers of two are exact in floats: keep them out of the whole numbers.
    twos = _twos(per_offset)
    odd = per_offset / Fraction(2) ** twos
    factor = math.lcm(2, per_centre.denominator) * odd.denominator
    middle, along, per_mm = (int(factor * n) for n in (Fraction(cells, 2), per_centre, odd))
    start = [middle + n * along for n in pixels.centre]
    slope = [n * per_mm for n in pixels.moved_offset(pixel_offset)]
    if max(factor * cells, *map(abs, start), *map(abs, slope)) >= _EXACT:
        # Lengths without a short form: everything in cells, rounded as floats are.
        rounded = [np.array([n / factor for n in axis]) for axis in (start, slope)]
        return CellRays(rounded[0], np.ldexp(rounded[1], twos), 1.0)
    return CellRays(
        np.array(start, np.float64), np.ldexp(np.array(slope, np.float64), twos), float(factor)
    )


def _twos(value: Fraction) -> int:
    """Exponent of 2 in a fraction; negative if 2 divides the denominator."""
    above, below = abs(value.numerator), value.denominator
    return (above & -above).bit_length() - (below & -below).bit_length()
