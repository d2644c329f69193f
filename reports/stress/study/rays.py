"""The rays that oracles judge by: of every panel pixel, from the definition alone.

Where rows and columns of a panel are independent they are fractions, and nothing is rounded; see
`inim.generators.oracle`. Of arrays that are hexagonal, turned or tilted they are long doubles, by
brute force: a pixel belongs to the lens whose elemental image has the nearest centre, of a list of
them all, laid out straight, turned, then moved. The generators' float64 divides by the pitch
instead and takes the floor.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from fractions import Fraction
from functools import lru_cache

import numpy as np

from inim.display import Display
from inim.generators.oracle import CENTRE, AxisRays, Line, PixelOffset, axis_rays, lensed_pixels
from inim.image.rgbd import RGBD

# Rounding errors a coordinate collects on its way: of start, slope, depth, product and sum.
_ROUNDINGS = 4
# Those of a float64 coordinate of a mounted array: of sine and cosine, two products, their sums,
# the gap.
_MOUNTED_ROUNDINGS = 8
_EPS = float(np.finfo(np.float64).eps)
_REAL = np.longdouble
# Rows and columns of lenses laid out around the array: what is nearest to one of them has no lens.
_BEYOND = 2


@dataclass(frozen=True)
class Rays:
    """Rays of some panel pixels over a picture.

    Attributes
    ----------
    pixels : (n, 2) int
        Row and column of each.
    axes : (AxisRays, AxisRays), or None
        Of all panel rows and all columns, exactly; None: rays share nothing.
    v0, dv, u0, du : (n,) float64
        Row and column of the picture each pixel's ray is in: ``v0 + dv z``, ``u0 + du z``.
    slack_v, slack_u : (n,) float64
        How far, in cells, float64 may move the ray itself within the depth range; 0 where rays are
        whole numbers.
    doubtful : (n,) bool
        Whether rounding decides which lens the pixel belongs to.
    fine : (n, 4) long double, or None
        v0, dv, u0, du of rays that share nothing, as exactly as they are known.
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
        """Of all panel rows."""
        assert self.axes is not None
        return self.axes[0]

    @property
    def columns(self) -> AxisRays:
        """Of all panel columns."""
        assert self.axes is not None
        return self.axes[1]

    def line(self, index: int) -> Line:
        """One ray in fractions."""
        if self.fine is not None:
            v0, dv, u0, du = (Fraction(*n.as_integer_ratio()) for n in self.fine[index])
            return v0, dv, u0, du
        row, column = self.pixels[index]
        rows, columns = self.rows, self.columns
        return rows.start[row], rows.slope[row], columns.start[column], columns.slope[column]

    def chosen(self, kept: np.ndarray) -> Rays:
        """Some of them, by their numbers."""
        each = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "axes"}
        return replace(self, **{k: v[kept] for k, v in each.items() if v is not None})


def rays_over(
    display: Display, rgbd: RGBD, pixels: np.ndarray, pixel_offset: PixelOffset = CENTRE
) -> Rays:
    """The rays of panel pixels, (n, 2) rows and columns, over a picture, however the array lies.

    A ray moved aside in its pixel keeps that pixel's lens.
    """
    if not display.is_separable:
        return _mounted_rays(display, rgbd, pixels, pixel_offset)
    axes = axis_rays(display, rgbd, pixel_offset)
    (v0, dv), (u0, du) = ((np.array(a.start, float), np.array(a.slope, float)) for a in axes)
    r, c = pixels.T
    none = np.zeros(len(pixels))
    return Rays(pixels, axes, v0[r], dv[r], u0[c], du[c], none, none, none.astype(bool))


def band_of(rays: Rays, display: Display, dtype: type) -> tuple[np.ndarray, np.ndarray, float]:
    """How far rounding in a type may move columns, rows (cells) and depths (mm) of each ray."""
    farthest = max(map(abs, display.depth_range_mm))
    unit = _ROUNDINGS * float(np.finfo(dtype).eps)
    across = unit * (np.abs(rays.u0) + np.abs(rays.du) * farthest + 1) + rays.slack_u
    down = unit * (np.abs(rays.v0) + np.abs(rays.dv) * farthest + 1) + rays.slack_v
    return across, down, unit * farthest


def chosen_pixels(display: Display, most: int) -> np.ndarray:
    """All lensed panel pixels, or a sample of them, the middle and the corners included; (n, 2)."""
    rows, columns = display.eia_shape
    if display.is_separable:
        pixels = lensed_pixels(display)
        chosen: np.ndarray = pixels[_sampled(len(pixels), most)]
        return chosen
    at = np.unravel_index(_sampled(rows * columns, most), (rows, columns))
    pixels = np.stack(at, axis=-1)
    own, _ = _owners(display, pixels)
    lensed: np.ndarray = pixels[_centres(display, display.pitch_mm)[2][own]]
    return lensed


def _sampled(count: int, most: int) -> np.ndarray:
    if count <= most:
        return np.arange(count)
    kept = np.random.default_rng(count).choice(count, most - 5, replace=False)
    ends = [0, count - 1, count // 2, count // 2 + 1, count // 3]
    return np.unique(np.concatenate([kept, ends]))


# -- arrays that are hexagonal, turned or tilted --------------------------------------------------


def _mounted_rays(
    display: Display, rgbd: RGBD, pixels: np.ndarray, pixel_offset: PixelOffset
) -> Rays:
    """In long doubles; the gap is the pixel's own.

    Slopes are ``(x0 - x) / g`` with ``g = gap + tan(tilt_x) x + tan(tilt_y) y`` where it starts.
    """
    own, margin = _owners(display, pixels)
    across, up, _ = _centres(display, display.pitch_mm)
    x0, y0 = across[own], up[own]
    x, y = _places(display, pixels, pixel_offset)
    slopes = [np.tan(_radians(getattr(display, name))) for name in ("tilt_x_deg", "tilt_y_deg")]
    gap = _REAL(display.gap_mm) + slopes[0] * x + slopes[1] * y
    cell, (high, wide) = _REAL(rgbd.pixel_mm), rgbd.shape
    dv, v0 = (y0 - y) / -gap / cell, _REAL(high) / 2 - y0 / cell
    du, u0 = (x0 - x) / gap / cell, x0 / cell + _REAL(wide) / 2
    slack_v = _slack(display, rgbd, gap, np.abs(y0) + np.abs(y), high)
    slack_u = _slack(display, rgbd, gap, np.abs(x0) + np.abs(x), wide)
    # Difference of distances, mm, that float64 may get wrong.
    doubt = 2 * _MOUNTED_ROUNDINGS * _EPS * (np.hypot(x, y) + _half_diagonal(display))
    fine = np.stack([v0, dv, u0, du], axis=-1)
    v0, dv, u0, du, slack_v, slack_u = (a.astype(float) for a in (v0, dv, u0, du, slack_v, slack_u))
    doubtful = np.asarray(margin <= doubt)
    return Rays(pixels, None, v0, dv, u0, du, slack_v, slack_u, doubtful, fine)


def _slack(
    display: Display, rgbd: RGBD, gap: np.ndarray, size: np.ndarray, cells: int
) -> np.ndarray:
    """How far float64 coordinates may be off within the depth range, in cells.

    A lens centre and a place of like size cancel in the slope, and leave their roundings.
    """
    farthest = max(map(abs, display.depth_range_mm))
    # A turned array's coordinates are made of both of the panel's.
    size = size + _half_diagonal(display)
    steep = _REAL(display.gap_mm) / gap + np.abs(1 - _REAL(display.gap_mm) / gap) + 1
    travel = size / gap * steep * farthest
    slack: np.ndarray = _MOUNTED_ROUNDINGS * _EPS * ((size + travel) / _REAL(rgbd.pixel_mm) + cells)
    return slack


def _half_diagonal(display: Display) -> np.ndarray:
    """From the panel's middle to the farthest lens, mm."""
    half: np.ndarray = np.hypot(_REAL(display.width_mm), _REAL(display.height_mm)) / 2
    half += np.hypot(_REAL(display.shift_x_mm), _REAL(display.shift_y_mm))
    return half


def _radians(degrees: float) -> np.longdouble:
    radians: np.longdouble = _REAL(degrees) * (4 * np.arctan(_REAL(1))) / 180
    return radians


def _places(
    display: Display, pixels: np.ndarray, pixel_offset: PixelOffset = CENTRE
) -> tuple[np.ndarray, np.ndarray]:
    """Where panel pixels are, mm to the right and up."""
    rows, columns = display.eia_shape
    down, right = (_REAL(part.numerator) / part.denominator for part in pixel_offset)
    pitch = _REAL(display.pixel_pitch_mm)
    x = (pixels[:, 1] - _REAL(columns - 1) / 2 + right) * pitch
    y = (_REAL(rows - 1) / 2 - pixels[:, 0] - down) * pitch
    return x, y


@lru_cache(maxsize=8)
def _centres(display: Display, pitch_mm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres of the cells of a pitch, mm to the right and up, and whether each has a lens."""
    columns = np.arange(-_BEYOND, display.lens_columns + _BEYOND)
    rows = np.arange(-_BEYOND, display.lens_rows + _BEYOND)
    stagger = np.zeros(len(rows))
    if display.lattice == "hexagonal" and display.lens_rows > 1:
        stagger = np.where(rows % 2 == 0, -0.25, 0.25)
    n, m = np.meshgrid(columns, rows)
    ratio = _REAL(pitch_mm) / _REAL(display.pitch_mm)
    x = (n - _REAL(display.lens_columns - 1) / 2 + stagger[:, None]) * _REAL(pitch_mm)
    y = (_REAL(display.lens_rows - 1) / 2 - m) * _REAL(display.row_pitch_mm) * ratio
    turn = _radians(display.rotation_deg)
    c, s = np.cos(turn), np.sin(turn)
    real = (n >= 0) & (n < display.lens_columns) & (m >= 0) & (m < display.lens_rows)
    return (
        (c * x - s * y + _REAL(display.shift_x_mm)).ravel(),
        (c * y + s * x + _REAL(display.shift_y_mm)).ravel(),
        real.ravel(),
    )


def _owners(display: Display, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number of the nearest elemental image's centre, and how much farther the next one is, mm."""
    across, up, _ = _centres(display, display.elemental_image_pitch_mm)
    x, y = _places(display, pixels)
    own, margin = np.empty(len(pixels), int), np.empty(len(pixels), _REAL)
    for i in range(len(pixels)):
        distance = np.hypot(across - x[i], up - y[i])
        own[i] = np.argmin(distance)
        two = np.partition(distance, 1)[:2]
        margin[i] = two[1] - two[0]
    return own, margin
