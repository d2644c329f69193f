"""Rays of arrays that are hexagonal, turned or tilted, by brute force and in long doubles.

A pixel belongs to the lens whose elemental image has the nearest centre, of a list of them all: a
lattice's cells are what lies nearest to each of its points. The list is laid out straight, turned,
then moved. The generators' float64 divides by the pitch instead and takes the floor.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from inim.display import Display
from inim.rgbd import RGBD
from inim.stress.rays import CENTRE, Aside, Rays, lensed_pixels, rays_of

__all__ = ["chosen_pixels", "free_rays_of", "rays_over"]

_REAL = np.longdouble
# Rows and columns of lenses laid out around the array: what is nearest to one of them has no lens.
_BEYOND = 2
# Roundings of a ray's float64 coordinates: of sine and cosine, two products, their sums, the gap.
_ROUNDINGS = 8
_EPS = float(np.finfo(np.float64).eps)


def _lensed_among(display: Display, pixels: np.ndarray) -> np.ndarray:
    """Those of some panel pixels, (n, 2), that lie under a lens."""
    own, _ = _owners(display, pixels)
    found: np.ndarray = pixels[_centres(display, display.pitch_mm)[2][own]]
    return found


def free_rays_of(display: Display, rgbd: RGBD, pixels: np.ndarray, aside: Aside = CENTRE) -> Rays:
    """The rays of panel pixels, (n, 2), over a picture; the gap is the pixel's own.

    Slopes are ``(x0 - x) / g`` with ``g = gap + tan(tilt_x) x + tan(tilt_y) y`` where it starts.
    """
    own, margin = _owners(display, pixels)
    across, up, _ = _centres(display, display.pitch_mm)
    x0, y0 = across[own], up[own]
    x, y = _places(display, pixels, aside)
    slopes = [np.tan(_radians(getattr(display, name))) for name in ("tilt_x_deg", "tilt_y_deg")]
    gap = _REAL(display.gap_mm) + slopes[0] * x + slopes[1] * y
    cell, (high, wide) = _REAL(rgbd.pixel_mm), rgbd.shape
    rays = ((y0 - y) / -gap / cell, _REAL(high) / 2 - y0 / cell, y0, y, high)
    columns = ((x0 - x) / gap / cell, x0 / cell + _REAL(wide) / 2, x0, x, wide)
    dv, v0, slack_v = _rounded(display, rgbd, gap, *rays)
    du, u0, slack_u = _rounded(display, rgbd, gap, *columns)
    doubtful = np.asarray(margin <= _doubt(display, x, y))
    fine = np.stack([rays[1], rays[0], columns[1], columns[0]], axis=-1)
    return Rays(pixels, None, v0, dv, u0, du, slack_v, slack_u, doubtful, fine)


def _rounded(
    display: Display,
    rgbd: RGBD,
    gap: np.ndarray,
    slope: np.ndarray,
    start: np.ndarray,
    lens: np.ndarray,
    place: np.ndarray,
    cells: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slope and start as float64, and how far theirs may be off within the depth range, in cells.

    A lens centre and a place of like size cancel in the slope, and leave their roundings.
    """
    farthest = max(map(abs, display.depth_range_mm))
    # A turned array's coordinates are made of both of the panel's.
    size = np.abs(lens) + np.abs(place) + _half_diagonal(display)
    steep = _REAL(display.gap_mm) / gap + np.abs(1 - _REAL(display.gap_mm) / gap) + 1
    travel = size / gap * steep * farthest
    slack = _ROUNDINGS * _EPS * ((size + travel) / _REAL(rgbd.pixel_mm) + cells)
    return slope.astype(float), start.astype(float), slack.astype(float)


def _doubt(display: Display, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Difference of distances, mm, that float64 may get wrong."""
    size = np.hypot(x, y) + _half_diagonal(display)
    found: np.ndarray = 2 * _ROUNDINGS * _EPS * size
    return found


def _half_diagonal(display: Display) -> np.ndarray:
    """From the panel's middle to the farthest lens, mm."""
    half: np.ndarray = np.hypot(_REAL(display.width_mm), _REAL(display.height_mm)) / 2
    aside: np.ndarray = np.hypot(_REAL(display.shift_x_mm), _REAL(display.shift_y_mm))
    found: np.ndarray = half + aside
    return found


def _radians(degrees: float) -> np.ndarray:
    pi = 4 * np.arctan(_REAL(1))
    found: np.ndarray = _REAL(degrees) * pi / 180
    return found


def _places(
    display: Display, pixels: np.ndarray, aside: Aside = CENTRE
) -> tuple[np.ndarray, np.ndarray]:
    """Where panel pixels are, mm to the right and up."""
    rows, columns = display.eia_shape
    down, right = (_REAL(part.numerator) / part.denominator for part in aside)
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


def chosen_pixels(display: Display, most: int) -> np.ndarray:
    """All lensed panel pixels, or a sample of them, the middle and the corners included; (n, 2)."""
    rows, columns = display.eia_shape
    if display.is_separable:
        pixels = lensed_pixels(display)
        chosen: np.ndarray = pixels[_sampled(len(pixels), most)]
        return chosen
    at = np.unravel_index(_sampled(rows * columns, most), (rows, columns))
    return _lensed_among(display, np.stack(at, axis=-1))


def _sampled(count: int, most: int) -> np.ndarray:
    if count <= most:
        return np.arange(count)
    kept = np.random.default_rng(count).choice(count, most - 5, replace=False)
    ends = [0, count - 1, count // 2, count // 2 + 1, count // 3]
    found: np.ndarray = np.unique(np.concatenate([kept, ends]))
    return found


def rays_over(display: Display, rgbd: RGBD, pixels: np.ndarray, aside: Aside = CENTRE) -> Rays:
    """The rays of panel pixels, (n, 2), over a picture, however the array lies."""
    of = rays_of if display.is_separable else free_rays_of
    return of(display, rgbd, pixels, aside)
