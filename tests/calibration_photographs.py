"""Positions that a camera would decode from photographs of a display, without photographs.

Rays of pixels are traced by the thick lens model, and those of a Gaussian blur about them. The
panel is seen as the steps that it is made of, smoothed by what a pixel and the camera's pupil cover
of it, with noise; pixels on a seam see two lenses and are often not decoded. The camera's
distortion is undone by iteration, not by the project's own code.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from inim.calibration.decode import Decoded
from inim.calibration.model import Intrinsics
from inim.calibration.patterns import MARK, has_mark, periods_px
from inim.display import Display
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.lens import trace_to_panel
from inim.settings import plain_parameters
from tests.schemas import completed


class Lens(NamedTuple):
    """A camera: height and width in pixels, OpenCV's intrinsics, but pixels begin at 0; blur."""

    shape: tuple[int, int]
    focal: float
    centre: tuple[float, float]
    k1: float = 0.0
    k2: float = 0.0
    blur_px: float = 0.65


# Gauss-Hermite's three points and weights of a normal distribution.
_NORMAL = ((-(3**0.5), 1 / 6), (0.0, 2 / 3), (3**0.5, 1 / 6))


def look_at(eye: Any, target: Any = (0, 0, 0), roll_deg: float = 0.0) -> np.ndarray:
    """Rows: the camera's axes in the display frame, x right, y down, z to the target."""
    z = np.subtract(target, eye, dtype=float)
    z /= np.linalg.norm(z)
    roll = np.radians(roll_deg)
    down = np.array([np.sin(roll), -np.cos(roll), 0.0])
    x = np.cross(down, z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def photograph(
    display: Display, lens: Lens, eye: Any, axes: np.ndarray, seed: int, noise_px: float = 0.05
) -> Decoded:
    """Decoded photograph of a display at any pose, taken from an eye with a camera."""
    random = np.random.default_rng(seed)
    height, width = lens.shape
    v, u = np.mgrid[:height, :width] + 0.5
    rows, columns = display.eia_shape
    column, row, weight = _seen(display, lens, eye, axes, u, v)
    dark = ~(weight > 0) | (column < 0) | (column > columns) | (row < 0) | (row > rows)
    total = np.zeros((3, height, width))
    period = periods_px(display)[:, None, None]
    waves = np.zeros((2, height, width), complex)
    for x, across in _NORMAL:
        for y, down in _NORMAL:
            there = _seen(display, lens, eye, axes, u + x * lens.blur_px, v + y * lens.blur_px)
            # Of another lens, a part of the blur makes the pixel one that is not decoded.
            same = (np.abs(there[0] - column) + np.abs(there[1] - row) < 4) & (there[2] > 0)
            share = across * down * same
            total += share * np.where(same, [there[0], there[1], np.ones_like(u)], 0)
            waves += across * down * np.exp(2j * np.pi * np.array(there[:2]) / period)
    blurred = total[:2] / np.where(dark, 1, total[2])
    seam = np.zeros(lens.shape, bool)
    for axis in (0, 1):
        jump = np.abs(np.diff(column, axis=axis)) + np.abs(np.diff(row, axis=axis)) > 4
        for part in (np.s_[1:], np.s_[:-1]):
            seam[part if axis == 0 else (slice(None), part)] |= jump
    dark |= (seam & (random.random(lens.shape) < 0.5)) | (random.random(lens.shape) < 0.003)
    # A pupil of 3 mm, and the pixel, on the panel, in panel pixels.
    cover = (3.0 / eye[2] * display.gap_mm + 0.01) / display.pixel_pitch_mm
    maps = [
        np.where(
            dark, np.nan, _stepped(picture, cover) + noise_px * random.standard_normal(lens.shape)
        )
        for picture in blurred
    ]
    # Panel points count from its centre, modulo the period.
    maps = [
        np.mod(picture - size / 2, own) for picture, size, own in zip(
            maps, (columns, rows), periods_px(display), strict=True
        )
    ]  # fmt: skip
    cell = (np.stack([column - columns / 2, row - rows / 2])) / period
    in_middle = (np.abs(cell - np.rint(cell)) < MARK).all(axis=0)
    marked = in_middle & has_mark(*np.rint(cell), periods_px(display)) & ~dark
    shift = np.exp(-2j * np.pi * np.array([columns, rows])[:, None, None] / 2 / period)
    return Decoded(*(m.astype(np.float32) for m in maps), marked, waves * shift, 0.0, ())


def _seen(
    display: Display, lens: Lens, eye: Any, axes: np.ndarray, u: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Panel column and row through points of the photograph, and what gets through."""
    distorted = np.stack([u - lens.centre[0], v - lens.centre[1]]) / lens.focal
    tangents = distorted
    for _ in range(12):
        square = (tangents**2).sum(axis=0)
        tangents = distorted / (1 + lens.k1 * square + lens.k2 * square**2)
    along = np.einsum("khw,kd->dhw", np.concatenate([tangents, np.ones((1, *u.shape))]), axes)
    away = -eye[2] / along[2]
    sx, sy = -along[0] / along[2], -along[1] / along[2]
    x, y, weight = trace_to_panel(
        display, "thick", eye[0] + away * along[0], eye[1] + away * along[1], sx, sy
    )
    rows, columns = display.eia_shape
    return x / display.pixel_pitch_mm + columns / 2, rows / 2 - y / display.pixel_pitch_mm, weight


def _stepped(place: np.ndarray, cover: float) -> np.ndarray:
    """Mean of floor(p) + 0.5 over an interval around a place: panel pixels are of one colour."""

    def integral(p: np.ndarray) -> np.ndarray:
        whole = np.floor(p)
        return whole * (whole - 1) / 2 + whole * (p - whole)

    return (integral(place + cover / 2) - integral(place - cover / 2)) / cover + 0.5


def save_light(path: Path, light: np.ndarray) -> np.ndarray:
    """Save linear light as a PNG; what the PNG's codes say of it."""
    codes = srgb_to_uint8(srgb_from_linear(light))
    Image.fromarray(codes).save(path)
    return linear_from_srgb(codes / np.float32(255))


#: A position of a camera, as in a calibration.
STRAIGHT_ON = {"name": "text", "eye_mm": [0, 0, 400], "turn": np.diag([1, -1, -1]).tolist()}


def write_calibrated(
    folder: Path, display: Display, camera: Intrinsics, shape: tuple[int, int],
    positions: Sequence[Mapping[str, Any]] = (),
) -> np.ndarray:  # fmt: skip
    """`mine.xml`, its calibration by a camera of this shape, and `eia.png` of random blots.

    Returns the linear light of the EIA.
    """
    parameters = plain_parameters(display).items()
    lines = [f'<default name="inim.{k}" value="{v}"/>' for k, v in parameters]
    (folder / "mine.xml").write_text(f'<scene version="3.0.0">{"".join(lines)}</scene>')
    document = {"camera": {"width_px": shape[1], "height_px": shape[0], **camera._asdict()}}
    unchanged = {"zoom": 0.0, "skew": 0.0, "stretch": 0.0}
    document |= {"positions": [{**unchanged, **p} for p in positions or [STRAIGHT_ON]]}
    calibration = folder / "mine-calibration" / "calibration.json"
    calibration.parent.mkdir()
    calibration.write_text(json.dumps(completed("calibration", document)))
    noise = np.random.default_rng(4).random((*display.eia_shape, 3))
    blots = gaussian_filter(noise, (6, 6, 0)) - 0.5
    return save_light(folder / "eia.png", 0.4 + 0.2 * blots / blots.std())
