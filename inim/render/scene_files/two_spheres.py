"""Closed-form scene of two spheres on an empty background, similar to the paper's scene.

All outputs derive from one function, the intersection of a ray: the RGB-D picture (rays along z),
the ground-truth EIA (rays of the panel pixels) and the ground-truth view (rays from an eye).
"""

from dataclasses import dataclass

import numpy as np

from inim.display import Display, Viewpoint
from inim.image.color import srgb_from_linear, srgb_to_uint8
from inim.image.rgbd import RGBD

# In shares of the array's half width and of the depth range's half depth: centre x, y, z; radii
# across and in depth; linear colours of the checks. They overlap, so that one hides the other.
_SPHERES = (
    (-0.22, 0.10, -0.35, 0.52, 0.60, (0.85, 0.30, 0.12), (0.95, 0.85, 0.60)),
    (0.30, -0.16, 0.40, 0.40, 0.55, (0.10, 0.32, 0.62), (0.75, 0.90, 0.95)),
)
# Checks across one sphere, and the direction to the light.
_CHECKS = 10
_LIGHT = np.array([-0.4, 0.5, 0.77])
_AMBIENT = 0.12
# Samples along each side of a pixel.
_SUBPIXELS = 4


@dataclass(frozen=True)
class _SphereHits:
    """Intersections of rays: linear RGB, depth in millimetres, and a flag."""

    color: np.ndarray
    depth_mm: np.ndarray
    covered: np.ndarray


def two_spheres(display: Display, shape: tuple[int, int], pixel_mm: float) -> RGBD:
    """The RGB-D picture, display-ready: (rows, columns, 4) uint8 sRGB with alpha."""
    y = _places(shape[0], pixel_mm, -1)
    x = _places(shape[1], pixel_mm, +1)
    still = np.zeros(1)
    hits = _first_hits(display, x, still, y, still)
    codes = srgb_to_uint8(srgb_from_linear(hits.color))
    alpha = np.where(hits.covered, 255, 0).astype(np.uint8)
    rgba = np.concatenate([codes, alpha[..., None]], axis=-1)
    return RGBD(rgba, hits.depth_mm, hits.covered, pixel_mm)


def two_spheres_eia(display: Display) -> np.ndarray:
    """The true EIA, (rows, columns, 3) float32 linear RGB, means over the pixels' areas."""
    total = np.zeros((*display.eia_shape, 3))
    steps = (np.arange(_SUBPIXELS) + 0.5) / _SUBPIXELS - 0.5
    # A place in the pixel moves the panel's end of the ray; the lens centre stays.
    turn = steps * display.pixel_pitch_mm / display.gap_mm
    for up in turn:
        for across in turn:
            columns, rows = display.columns, display.rows
            total += _first_hits(
                display, columns.centre_mm, columns.slope - across, rows.centre_mm, rows.slope - up
            ).color
    mean: np.ndarray = np.where(display.lensed[..., None], total / _SUBPIXELS**2, 0.0).astype(
        np.float32
    )
    return mean


def two_spheres_view(display: Display, eye: Viewpoint, pixels_per_lens: int) -> np.ndarray:
    """Render the ground-truth view from an eye, (rows, columns, 3) float32 linear RGB."""
    fine = pixels_per_lens * _SUBPIXELS
    rows, columns = (n * pixels_per_lens for n in display.layout.grid)
    x = _places(columns * _SUBPIXELS, display.pitch_mm / fine, +1)
    y = _places(rows * _SUBPIXELS, display.pitch_mm / fine, -1)
    slopes = (eye.x_mm - x) / eye.z_mm, (eye.y_mm - y) / eye.z_mm
    hits = _first_hits(display, x, slopes[0], y, slopes[1]).color
    blocks = hits.reshape(rows, _SUBPIXELS, columns, _SUBPIXELS, 3)
    mean: np.ndarray = blocks.mean(axis=(1, 3)).astype(np.float32)
    return mean


def _places(count: int, step_mm: float, sign: int) -> np.ndarray:
    centres: np.ndarray = sign * (np.arange(count) + 0.5 - count / 2) * step_mm
    return centres


def _first_hits(
    display: Display, x: np.ndarray, dx: np.ndarray, y: np.ndarray, dy: np.ndarray
) -> _SphereHits:
    """Rays (x + dx z, y + dy z), columns by `x` and rows by `y`: the hit of largest z."""
    shape = (len(y), len(x))
    color = np.zeros((*shape, 3), np.float32)
    depth = np.full(shape, -np.inf)
    x, dx, y, dy = x[None, :], dx[None, :], y[:, None], dy[:, None]
    for sphere in _SPHERES:
        z, normal = _hit(display, sphere, x, dx, y, dy)
        nearer = z > depth  # NaN, a miss, never is
        depth = np.where(nearer, z, depth)
        color[nearer] = _shade(sphere, np.stack([part[nearer] for part in normal], axis=-1))
    covered = np.isfinite(depth)
    return _SphereHits(color, np.where(covered, depth, 0.0).astype(np.float32), covered)


def _hit(
    display: Display, sphere: tuple, x: np.ndarray, dx: np.ndarray, y: np.ndarray, dy: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Depth of the front of one sphere (NaN: missed), and the place on the unit sphere there.

    Squeezed into the depth range a sphere is an ellipsoid; in units of its radii it is one again.
    """
    low, high = display.depth_range_mm
    half = min(display.width_mm, display.height_mm) / 2
    across, deep = sphere[3] * half, sphere[4] * (high - low) / 2
    middle = (low + high) / 2 + sphere[2] * (high - low) / 2
    u, du = (x + dx * middle - sphere[0] * half) / across, dx * deep / across
    v, dv = (y + dy * middle - sphere[1] * half) / across, dy * deep / across
    a, b, c = du * du + dv * dv + 1, u * du + v * dv, u * u + v * v - 1
    with np.errstate(invalid="ignore"):
        w = (np.sqrt(b * b - a * c) - b) / a  # the larger root: towards the viewer
    return middle + deep * w, [u + du * w, v + dv * w, w]


def _shade(sphere: tuple, normal: np.ndarray) -> np.ndarray:
    """A chequered ball under one light, linear RGB of unit normals (n, 3)."""
    around = np.arctan2(normal[:, 0], normal[:, 2]) / np.pi
    upward = np.arcsin(np.clip(normal[:, 1], -1, 1)) / np.pi
    odd = (np.floor(_CHECKS * around) + np.floor(_CHECKS * upward)) % 2 == 1
    paint = np.where(odd[:, None], np.array(sphere[5]), np.array(sphere[6]))
    light = _AMBIENT + (1 - _AMBIENT) * np.clip(normal @ _LIGHT, 0, 1)
    shaded: np.ndarray = (paint * light[:, None]).astype(np.float32)
    return shaded
