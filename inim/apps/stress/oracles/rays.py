"""Rays of panel pixels for the oracles, from the definition.

Rays of separable displays are fractions without rounding; see `inim.generators.oracle`. Rays of
hexagonal, turned or tilted arrays are long doubles, computed by brute force: a pixel belongs to
the lens whose elemental image has the nearest centre. The list of all centres is laid out straight,
then rotated and shifted. The generators divide by the pitch in float64 instead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from inim.display import Display
from inim.display.pixels import CENTRE, PixelOffset
from inim.generators.oracle import AxisRays, Line, axis_rays, lensed_pixels
from inim.image.rgbd import RGBD

# Rounding errors of a coordinate: start, slope, depth, product and sum.
_ROUNDINGS = 4
# Rounding errors of a float64 coordinate of a non-separable display: sine and cosine, two products,
# their sums, the gap.
_NONSEPARABLE_ROUNDINGS = 8
_EPS = float(np.finfo(np.float64).eps)
_REAL = np.longdouble
#: Offset of rows to the right, in pitches, from their indices from the top and their number.
STAGGERS: dict[str, Callable[[np.ndarray, int], np.ndarray]] = {
    "square": lambda rows, _: np.zeros(len(rows)),
    "hexagonal": lambda rows, count: np.where(rows % 2 == 0, -0.25, 0.25) * (count > 1),
}
# Additional rows and columns around the array. A pixel nearest to one of these has no lens.
_MARGIN = 2


@dataclass(frozen=True)
class Rays:
    """Rays of panel pixels over a picture.

    Attributes
    ----------
    pixels : (n, 2) int
        Row and column of each pixel.
    axes : (AxisRays, AxisRays), or None
        Exact rays of all panel rows and columns; None for non-separable displays.
    v0, dv, u0, du : (n,) float64
        The ray at depth z is in row ``v0 + dv z`` and column ``u0 + du z`` of the picture.
    slack_v, slack_u : (n,) float64
        Largest error of a float64 ray within the depth range, in cells; 0 for exact rays.
    doubtful : (n,) bool
        True if rounding decides which lens the pixel belongs to.
    fine : (n, 4) long double, or None
        v0, dv, u0, du of non-separable displays in the highest precision.
    """

    pixels: np.ndarray
    axes: tuple[AxisRays, AxisRays] | None
    v0: np.ndarray
    dv: np.ndarray
    u0: np.ndarray
    du: np.ndarray
    slack_v: np.ndarray
    slack_u: np.ndarray
    doubtful: np.ndarray
    fine: np.ndarray | None = None

    @property
    def rows(self) -> AxisRays:
        """Rays of all panel rows."""
        assert self.axes is not None
        return self.axes[0]

    @property
    def columns(self) -> AxisRays:
        """Rays of all panel columns."""
        assert self.axes is not None
        return self.axes[1]

    def line(self, index: int) -> Line:
        """Ray number `index` in fractions."""
        if self.fine is not None:
            v0, dv, u0, du = (Fraction(*n.as_integer_ratio()) for n in self.fine[index])
            return v0, dv, u0, du
        row, column = self.pixels[index]
        rows, columns = self.rows, self.columns
        return rows.start[row], rows.slope[row], columns.start[column], columns.slope[column]

    def take(self, indices: np.ndarray) -> Rays:
        """Rays with these numbers."""
        arrays = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "axes"}
        return replace(self, **{k: v[indices] for k, v in arrays.items() if v is not None})


def rays_over(
    display: Display, rgbd: RGBD, pixels: np.ndarray, pixel_offset: PixelOffset = CENTRE
) -> Rays:
    """Rays of panel pixels, (n, 2) rows and columns, over a picture, for any display.

    A ray with an offset in its pixel passes through that pixel's lens.
    """
    if not display.is_separable:
        return _nonseparable_rays(display, rgbd, pixels, pixel_offset)
    axes = axis_rays(display, rgbd, pixel_offset)
    (v0, dv), (u0, du) = ((np.array(a.start, float), np.array(a.slope, float)) for a in axes)
    r, c = pixels.T
    zeros = np.zeros(len(pixels))
    return Rays(pixels, axes, v0[r], dv[r], u0[c], du[c], zeros, zeros, zeros.astype(bool))


def band_of(rays: Rays, display: Display, dtype: type) -> tuple[np.ndarray, np.ndarray, float]:
    """Largest rounding errors of columns, rows (cells) and depths (mm) of each ray in a type."""
    farthest = max(map(abs, display.depth_range_mm))
    unit = _ROUNDINGS * float(np.finfo(dtype).eps)
    columns = unit * (np.abs(rays.u0) + np.abs(rays.du) * farthest + 1) + rays.slack_u
    rows = unit * (np.abs(rays.v0) + np.abs(rays.dv) * farthest + 1) + rays.slack_v
    return columns, rows, unit * farthest


def chosen_pixels(display: Display, limit: int) -> np.ndarray:
    """All lensed panel pixels, or a sample that includes the middle and the corners; (n, 2)."""
    rows, columns = display.eia_shape
    if display.is_separable:
        pixels = lensed_pixels(display)
        sample: np.ndarray = pixels[_sample(len(pixels), limit)]
        return sample
    indices = np.unravel_index(_sample(rows * columns, limit), (rows, columns))
    pixels = np.stack(indices, axis=-1)
    lensed: np.ndarray = pixels[
        (panel_rays(display, pixels).lens >= 0) | (display.lattice == "lenticular")
    ]
    return lensed


def _sample(count: int, limit: int) -> np.ndarray:
    if count <= limit:
        return np.arange(count)
    random = np.random.default_rng(count).choice(count, limit - 5, replace=False)
    always = [0, count - 1, count // 2, count // 2 + 1, count // 3]
    return np.unique(np.concatenate([random, always]))


# -- any display -------------------------------------------------------------------------------


class PixelLines(NamedTuple):
    """Lens and ray of panel pixels by brute force, (n,) long double; names as of `PixelRays`."""

    lens: np.ndarray  #: int64: ``row * columns + column``, -1 outside the array.
    x0: np.ndarray
    y0: np.ndarray
    slope_x: np.ndarray
    slope_y: np.ndarray
    gap_mm: np.ndarray
    margin: np.ndarray  #: Distance from a border between two elemental images, mm.


def panel_rays(
    display: Display, pixels: np.ndarray, pixel_offset: PixelOffset = CENTRE
) -> PixelLines:
    """Rays of panel pixels, (n, 2) rows and columns, from the nearest of all lens centres.

    Slopes are ``(x0 - x) / g`` with ``g = gap + tan(tilt_x) x + tan(tilt_y) y`` at the pixel.
    """
    x, y = panel_places(display, pixels, pixel_offset)
    slopes = [np.tan(_radians(getattr(display, name))) for name in ("tilt_x_deg", "tilt_y_deg")]
    gap = _REAL(display.gap_mm) + slopes[0] * x + slopes[1] * y
    if display.lattice == "lenticular":
        lens, x0, y0, margin = _cylinders(display, x, y, gap)
    else:
        nearest, margin = _nearest_centres(display, pixels)
        centre_x, centre_y, has_lens = all_centres(display, display.pitch_mm)
        x0, y0 = centre_x[nearest], centre_y[nearest]
        row, column = np.divmod(nearest, display.lens_columns + 2 * _MARGIN)
        lens = (row - _MARGIN) * display.lens_columns + column - _MARGIN
        lens = np.where(has_lens[nearest], lens, -1)
    return PixelLines(lens, x0, y0, (x0 - x) / gap, (y0 - y) / gap, gap, margin)


def _cylinders(
    display: Display, x: np.ndarray, y: np.ndarray, gap: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Cylinder, crossing and margin of points under a lenticular sheet.

    A ray meets the eye at the height of the panel's centre, at the distance V = g P / (Q - P). It
    crosses the array on the axis of the cylinder whose image holds the point.
    """
    pitch, cell = _REAL(display.pitch_mm), _REAL(display.elemental_image_pitch_mm)
    turn = _radians(display.rotation_deg)
    c, s = np.cos(turn), np.sin(turn)
    right, up = _REAL(display.shift_x_mm), _REAL(display.shift_y_mm)
    place = (c * (x - right) + s * (y - up)) / cell
    number = np.rint(place)
    # Similar triangles from the panel to the eye; parallel rays without a distance.
    wider = (cell - pitch) / pitch
    y0 = y / (1 + gap * wider / _REAL(display.gap_mm)) if wider > 0 else y
    x0 = right + (number * pitch - s * (y0 - up)) / c
    return number.astype(np.int64), x0, y0, (0.5 - np.abs(place - number)) * cell


def _nonseparable_rays(
    display: Display, rgbd: RGBD, pixels: np.ndarray, pixel_offset: PixelOffset
) -> Rays:
    """Rays of `panel_rays` in cells of a picture, with their rounding errors in float64."""
    _, x0, y0, slope_x, slope_y, gap, margin = panel_rays(display, pixels, pixel_offset)
    x, y = panel_places(display, pixels, pixel_offset)
    cell, (high, wide) = _REAL(rgbd.pixel_mm), rgbd.shape
    dv, v0 = -slope_y / cell, _REAL(high) / 2 - y0 / cell
    du, u0 = slope_x / cell, x0 / cell + _REAL(wide) / 2
    slack_v = _slack(display, rgbd, gap, np.abs(y0) + np.abs(y), high)
    slack_u = _slack(display, rgbd, gap, np.abs(x0) + np.abs(x), wide)
    # Largest error of a difference of distances in float64, mm.
    distance_error = 2 * _NONSEPARABLE_ROUNDINGS * _EPS * (np.hypot(x, y) + _half_diagonal(display))
    fine = np.stack([v0, dv, u0, du], axis=-1)
    v0, dv, u0, du, slack_v, slack_u = (a.astype(float) for a in (v0, dv, u0, du, slack_v, slack_u))
    doubtful = np.asarray(margin <= distance_error)
    return Rays(pixels, None, v0, dv, u0, du, slack_v, slack_u, doubtful, fine)


def _slack(
    display: Display, rgbd: RGBD, gap: np.ndarray, size: np.ndarray, cells: int
) -> np.ndarray:
    """Largest error of float64 coordinates within the depth range, in cells.

    In the slope a lens centre and a panel position of similar size cancel, and their rounding
    errors remain.
    """
    farthest = max(map(abs, display.depth_range_mm))
    # Coordinates of a turned array combine both coordinates of the panel.
    size = size + _half_diagonal(display)
    amplification = _REAL(display.gap_mm) / gap + np.abs(1 - _REAL(display.gap_mm) / gap) + 1
    travel = size / gap * amplification * farthest
    slack: np.ndarray = (
        _NONSEPARABLE_ROUNDINGS * _EPS * ((size + travel) / _REAL(rgbd.pixel_mm) + cells)
    )
    return slack


def _half_diagonal(display: Display) -> np.ndarray:
    """Distance from the panel's middle to the farthest lens, mm."""
    half: np.ndarray = np.hypot(_REAL(display.width_mm), _REAL(display.height_mm)) / 2
    half += np.hypot(_REAL(display.shift_x_mm), _REAL(display.shift_y_mm))
    return half


def _radians(degrees: float) -> np.longdouble:
    radians: np.longdouble = _REAL(degrees) * (4 * np.arctan(_REAL(1))) / 180
    return radians


def panel_places(
    display: Display, pixels: np.ndarray, pixel_offset: PixelOffset = CENTRE
) -> tuple[np.ndarray, np.ndarray]:
    """Positions of points of panel pixels, mm to the right and up, long double."""
    rows, columns = display.eia_shape
    down, right = (_REAL(part.numerator) / part.denominator for part in pixel_offset[:2])
    if pixel_offset.channel is not None:
        from_bottom = rows - 1 - pixels[:, 0]
        kind = _KINDS[display.cell_pattern](pixels[:, 1], from_bottom)
        table = np.array(display.subpixel_cells, _REAL)[kind % len(display.subpixel_cells)]
        right = right + table[:, 2 * pixel_offset.channel]
        down = down - table[:, 2 * pixel_offset.channel + 1]
    pitch = _REAL(display.pixel_pitch_mm)
    x = (pixels[:, 1] - _REAL(columns - 1) / 2 + right) * pitch
    y = (_REAL(rows - 1) / 2 - pixels[:, 0] - down) * pitch
    return x, y


# Kinds of pixels in reading order of a period of 4 x 4, the lowest row first.
_PERIODS = {
    "single": ("0000",) * 4,
    "checkerboard": ("0101", "1010") * 2,
    "columns": ("0101",) * 4,
    "rows": ("0000", "1111") * 2,
    "rows-of-4": ("0000", "1111", "2222", "3333"),
    "staggered": ("0202", "1313", "2020", "3131"),
}


def _kind_in(period: tuple[str, ...]) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    table = np.array([[int(kind) for kind in row] for row in period])
    return lambda column, from_bottom: table[from_bottom % 4, column % 4]


_KINDS = {name: _kind_in(period) for name, period in _PERIODS.items()}


@lru_cache(maxsize=8)
def all_centres(display: Display, pitch_mm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres of cells with a pitch, mm to the right and up, and True for those with a lens."""
    columns = np.arange(-_MARGIN, display.lens_columns + _MARGIN)
    rows = np.arange(-_MARGIN, display.lens_rows + _MARGIN)
    stagger = STAGGERS[display.lattice](rows, display.lens_rows)
    n, m = np.meshgrid(columns, rows)
    ratio = _REAL(pitch_mm) / _REAL(display.pitch_mm)
    x = (n - _REAL(display.lens_columns - 1) / 2 + stagger[:, None]) * _REAL(pitch_mm)
    y = (_REAL(display.lens_rows - 1) / 2 - m) * _REAL(display.row_pitch_mm) * ratio
    turn = _radians(display.rotation_deg)
    c, s = np.cos(turn), np.sin(turn)
    has_lens = (n >= 0) & (n < display.lens_columns) & (m >= 0) & (m < display.lens_rows)
    return (
        (c * x - s * y + _REAL(display.shift_x_mm)).ravel(),
        (c * y + s * x + _REAL(display.shift_y_mm)).ravel(),
        has_lens.ravel(),
    )


def _nearest_centres(display: Display, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest centre of an elemental image, and the additional distance of the second, mm."""
    centre_x, centre_y, _ = all_centres(display, display.elemental_image_pitch_mm)
    x, y = panel_places(display, pixels)
    nearest, margin = np.empty(len(pixels), int), np.empty(len(pixels), _REAL)
    for i in range(len(pixels)):
        distance = np.hypot(centre_x - x[i], centre_y - y[i])
        nearest[i] = np.argmin(distance)
        first, second = np.partition(distance, 1)[:2]
        margin[i] = second - first
    return nearest, margin
