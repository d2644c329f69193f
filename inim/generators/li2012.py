# Kernels have no types of their own.
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
"""`li2012`: forward mapping of every picture pixel through every lens, "one to many".

The method of Li et al. (2012) as described by Wang et al., Heritage Science 2024, doi
10.1186/s40494-024-01462-4; docs/theory/paper.md has the definition and its limits. Choices that the
description leaves open:

* A point on the border between two panel pixels belongs to the one nearer the panel's axis, and on
  the axis to the left or upper one; lenses own whole panel pixels, by their centres.
* Among picture pixels of equal z on one panel pixel, the one nearest to that pixel's centre is
  kept, then the one nearest to the picture's vertical axis, then to its horizontal one. A mirrored
  picture therefore gives the mirrored map, except for points exactly on an axis.
* A point at z = 0 is on the array and under every pixel of one lens at once. It is skipped.
* Cylinders magnify nothing along their axes. There a picture pixel is as high as it is, and colours
  all panel rows whose rays meet it.
"""

import math
from fractions import Fraction
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from inim.display import Display
from inim.display.layouts import Lenticular
from inim.display.pixels import CENTRE, PixelAxis, PixelOffset
from inim.generators.base import (
    HOLE,
    PanelRays,
    SourceFinder,
    Sources,
    each_ray,
    require_separable,
    run_kernel,
)
from inim.generators.options import NoOptions
from inim.generators.registry import algorithm
from inim.image.rgbd import RGBD
from inim.system.errors import UsageError

# Whole numbers up to here are floats, and the quotient of two is rounded once.
_EXACT = 2**53


@algorithm(NoOptions, color="#cc79a7", marker="D")
def prepare(rays: PanelRays, _: NoOptions) -> SourceFinder:
    """Forward mapping: each picture pixel through each lens (Li et al. 2012)."""
    if isinstance(rays.display.layout, Lenticular) and not any(rays.display.tilt_slopes):
        if any(offset.channel is not None for offset in rays.offsets):
            raise UsageError(
                f"li2012: display {rays.display.name} has sub-pixels at no fixed place in a pixel; "
                "use samples=centre"
            )
        return each_ray(rays, partial(_map_under_cylinders, rays, rays.display.layout))
    require_separable(rays.display, "li2012")
    return each_ray(rays, partial(_map_picture, rays))


class ForwardAxis(NamedTuple):
    """One axis of the mapping, to the right for columns and downwards for rows.

    Through lens `n`, picture pixel `c` at depth z lands at the panel position, in panel pixels from
    the panel's middle,

        ``(lens_z[n] z + lens_g[n] - pixel_g[c]) / (unit z)``

    which is x = x0 + (x0 - X) g / z, Eq. 1 of Wang et al. 2024 solved for the panel. A ray with an
    offset in its pixel has panel pixels that are moved by it. All are whole
    numbers wherever the display's lengths are short decimals or fractions: a position on a border
    between panel pixels is then exact.

    * `lens_z`, `lens_g`: (lenses,) float64.
    * `pixel_g`: (cells,) float64.
    * `first`, `end`, (lenses,) int64: panel pixels of each elemental image, `end` excluded.
    * `low`, `high`, (lenses,) int64: picture pixels that may land in each elemental image, at the
      depths of the picture; `high` excluded, one more on either side.
    """

    cells: int
    pixels: int
    unit: float
    lens_z: np.ndarray
    lens_g: np.ndarray
    pixel_g: np.ndarray
    first: np.ndarray
    end: np.ndarray
    low: np.ndarray
    high: np.ndarray


def forward_axes(
    display: Display,
    shape: tuple[int, int],
    pixel_mm: float,
    depths_mm: tuple[float, float],
    pixel_offset: PixelOffset = CENTRE,
) -> tuple[ForwardAxis, ForwardAxis]:
    """Columns and rows of the mapping of a picture with the lowest and highest depth given."""
    (rows, columns), (down, right, _) = shape, pixel_offset
    to_right, downwards = (display.layout.axis(sign).centres() for sign in (+1, -1))
    return (
        _axis(display, display.columns, to_right, columns, pixel_mm, depths_mm, right),
        _axis(display, display.rows, downwards, rows, pixel_mm, depths_mm, down),
    )


def _axis(
    display: Display,
    panel: PixelAxis,
    centres: list[Fraction],
    cells: int,
    cell_mm: float,
    depths_mm: tuple[float, float],
    offset: Fraction,
) -> ForwardAxis:
    gap, pixel, cell = map(display.exact_mm, (display.gap_mm, display.pixel_pitch_mm, cell_mm))
    places = [Fraction(2 * c - cells + 1, 2) * cell for c in range(cells)]
    from_offset = [x0 - offset * pixel for x0 in centres]
    lens_z, lens_g, pixel_g, unit = _whole(
        from_offset, [x0 * gap for x0 in centres], [x * gap for x in places], [pixel]
    )
    first, end = panel.elemental_images()
    middle = len(panel.lens) / 2 - float(offset)
    edges_mm = np.stack([first - middle, end - middle]) * display.pixel_pitch_mm
    x0 = np.array(centres, np.float64)
    # X = x0 + (x0 - x) z / g is linear in x and in z: its extremes are at the corners.
    reach = [x0 + (x0 - edges_mm) * (z / display.gap_mm) for z in depths_mm]
    reach_cells = np.concatenate(reach) / cell_mm + cells / 2
    low = np.clip(np.floor(reach_cells.min(axis=0)) - 1, 0, cells).astype(np.int64)
    high = np.clip(np.ceil(reach_cells.max(axis=0)) + 1, 0, cells).astype(np.int64)
    return ForwardAxis(
        cells, len(panel.lens), float(unit[0]), lens_z, lens_g, pixel_g, first, end, low, high
    )


def _whole(*lengths: list[Fraction]) -> list[np.ndarray]:
    """The same lengths in a common unit that makes whole numbers of them, if floats hold those."""
    everything = [length for group in lengths for length in group]
    factor = Fraction(math.lcm(*(length.denominator for length in everything)))
    if max(abs(length) for length in everything) * factor >= _EXACT:
        factor = Fraction(1)
    return [np.array([float(length * factor) for length in group]) for group in lengths]


def _map_picture(rays: PanelRays, rgbd: RGBD, pixel_offset: PixelOffset) -> Sources:
    """Forward mapping through lenses in rows and columns."""
    # Pixels at depth 0 have no panel position.
    depth = np.where(rgbd.covered, rgbd.depth_mm.astype(np.float64), 0.0)
    placed = depth[depth != 0]
    depths = (float(placed.min()), float(placed.max())) if len(placed) else (0.0, 0.0)
    x, y = forward_axes(rays.display, rays.shape, rays.pixel_mm, depths, pixel_offset)
    nearest = np.full(x.pixels * y.pixels, -np.inf)
    miss = np.full(x.pixels * y.pixels, np.inf)
    mapping = (depth.ravel(), x, y, nearest, miss)
    return run_kernel(_map_all, len(y.first), rays.display.eia_shape, *mapping)


def _map_under_cylinders(
    rays: PanelRays, layout: Lenticular, rgbd: RGBD, pixel_offset: PixelOffset
) -> Sources:
    """Forward mapping through cylinders, in float64."""
    display, pitch = rays.display, rays.display.pixel_pitch_mm
    down_px, right_px = float(pixel_offset.down), float(pixel_offset.right)
    (rows, columns), (height, width) = display.eia_shape, rays.shape
    angle, gap = math.radians(display.rotation_deg), display.gap_mm
    c, s = math.cos(angle), math.sin(angle)
    row, column = np.nonzero(rgbd.covered & (rgbd.depth_mm != 0))
    z = rgbd.depth_mm[row, column].astype(np.float64)
    x = (column + 0.5 - width / 2) * rays.pixel_mm
    # Rays sink to the height of an eye at the design distance V: y = panel y (V - z) / (V + g).
    per_distance = 1 / layout.design_distance_mm
    panel, eye = 1 + gap * per_distance, 1 - z * per_distance
    edges = (height / 2 - np.stack([row, row + 1])) * rays.pixel_mm * panel / eye
    first, end = np.ceil((rows - 1) / 2 - down_px - edges / pitch).clip(0, rows).astype(np.int64)
    # The cylinder in front of the eye, and those whose elemental images a point may reach.
    reach = np.abs(z) / eye * display.elemental_image_pitch_mm / (2 * gap * display.pitch_mm)
    steps = math.ceil(reach.max(initial=0)) + 1
    best = np.full((2, rows * columns), -np.inf)  # depth, and nearness to the pixel's centre
    sources = np.full(rows * columns, HOLE, np.int32)
    for down in range((end - first).max(initial=0)):
        j = first + down
        y = ((rows - 1) / 2 - j) * pitch
        sideways = s * ((y - down_px * pitch) / panel - display.shift_y_mm)
        front = np.rint((c * (x / eye - display.shift_x_mm) + sideways) / display.pitch_mm)
        for lens in (front + step for step in range(-steps, steps + 1)):
            x0 = display.shift_x_mm + (lens * display.pitch_mm - sideways) / c
            place = (x0 + (x0 - x) * gap / z) / pitch + columns / 2 - right_px
            i = np.floor(place)
            across = c * ((i + 0.5 - columns / 2) * pitch - display.shift_x_mm)
            across += s * (y - display.shift_y_mm)
            lands = (i >= 0) & (i < columns) & (j < end)
            lands &= layout.place_in_cell(across)[0] == lens
            at = (j * columns + i)[lands].astype(np.int64)
            rank = np.stack([z, -np.abs(place - i - 0.5)])[:, lands]
            source = (row * width + column)[lands]
            order = np.lexsort((rank[1], rank[0]))  # the best is written last
            at, rank, source = at[order], rank[:, order], source[order]
            (before, nearness), (depth, own) = best[:, at], rank
            wins = (depth > before) | ((depth == before) & (own > nearness))
            best[:, at[wins]], sources[at[wins]] = rank[:, wins], source[wins]
    return sources.reshape(rows, columns)


def _map_all(begin, end, depth, x, y, nearest, miss, sources):
    """Gather the picture for every lens; no two lenses share a panel pixel."""
    for m in range(begin, end):
        for n in range(len(x.first)):
            _map_through_lens(depth, x, y, m, n, nearest, miss, sources)


def _map_through_lens(depth, x, y, m, n, nearest, miss, sources):
    """Send all picture pixels in a lens's reach through it, nearest to the viewer on top."""
    for r in range(y.low[m], y.high[m]):
        for c in range(x.low[n], x.high[n]):
            z = depth[r * x.cells + c]
            if z == 0.0:
                continue
            across, down = _position(x, n, c, z), _position(y, m, r, z)
            i, j = _panel_pixel(across, x.pixels), _panel_pixel(down, y.pixels)
            if not (x.first[n] <= i < x.end[n] and y.first[m] <= j < y.end[m]):
                continue
            dx, dy = across - (i - (x.pixels - 1) / 2), down - (j - (y.pixels - 1) / 2)
            off, at = dx * dx + dy * dy, j * x.pixels + i
            rival = sources[at]
            if z > nearest[at] or (
                z == nearest[at]
                and (off < miss[at] or (off == miss[at] and _nearer_axis(x, y, r, c, rival)))
            ):
                nearest[at], miss[at], sources[at] = z, off, r * x.cells + c


def _position(axis: Any, lens: Any, cell: Any, z: Any) -> Any:
    """Panel position of a picture pixel, in panel pixels from the panel's centre: see
    `ForwardAxis`.
    """
    return (axis.lens_z[lens] * z + (axis.lens_g[lens] - axis.pixel_g[cell])) / (axis.unit * z)


def _panel_pixel(position, pixels):
    """The panel pixel that contains a position; outside 0..pixels-1 if none does.

    Counted outwards from the axis, so that the two halves of the panel mirror each other.
    """
    odd = pixels % 2
    # Bounded as a float: far positions would not fit an integer.
    outwards = math.ceil(min(abs(position) - 0.5 * odd, 1.0 * pixels))
    place = pixels // 2 - 1 + odd + outwards
    return place if position >= 0.0 else pixels - 1 - place


def _nearer_axis(x, y, row, column, rival):
    """True if a picture pixel is nearer to the vertical axis than another, then to the horizontal
    axis.
    """
    mine = abs(2 * column + 1 - x.cells)
    other = abs(2 * (rival % x.cells) + 1 - x.cells)
    if mine != other:
        return mine < other
    return abs(2 * row + 1 - y.cells) < abs(2 * (rival // x.cells) + 1 - y.cells)
