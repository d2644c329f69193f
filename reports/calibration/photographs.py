"""Simulated photographs of a misaligned display that shows the calibration's patterns.

    inim calibrate patterns --display nominal -o out/patterns
    python -m reports.calibration.photographs 0 --patterns out/patterns -o out/photographs

These commands photograph case 0 of `reports.calibration.cases`: one folder of JPEGs for each camera
position. The misalignment is not written to these folders.

The panel points of the rays come from `reports.calibration.landing`. The panel has a gamma, a black
level, and pixels or stripes of red, green and blue in a black matrix. Each ray collects the light
of a small rectangle of the panel. The camera has cos^4 falloff, blur, exposure, shot noise, read
noise, optionally a Bayer mosaic with bilinear demosaicing, sRGB codes, unsharp masking, and JPEG
compression with a focal length in EXIF.

A moving camera changes neither the rays through its pupil nor their panel points. Each quarter of a
pixel is projected again by the turned, zoomed or sheared camera, and its light is shared among the
pixels that it then covers. The total light is conserved.
"""

from __future__ import annotations

import argparse
import io
import math
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image
from scipy.ndimage import convolve1d, gaussian_filter

from inim.backend.kernels import compiled
from inim.image.color import linear_from_srgb, srgb_from_linear
from inim.process.atomic_file import write_atomically
from inim.process.threads import threads
from reports.calibration.cases import Case, Motion, Sensor, draw_case, draw_disturbed
from reports.calibration.landing import (
    SAMPLES,
    Camera,
    CameraRays,
    Distortion,
    Sheet,
    distort,
)

_BRIGHT_QUANTILE = 0.99
# Intervals of the table from linear light to sRGB codes.
_LIGHT_LEVELS = 1 << 16
_CODES = (255 * srgb_from_linear(np.arange(_LIGHT_LEVELS + 1) / _LIGHT_LEVELS)).astype(np.float32)
_EXIF_IFD, _FOCAL_LENGTH_35MM, _MODEL = 0x8769, 41989, 0x0110
_DIAGONAL_35MM = np.hypot(36, 24)
# Sigma in pixels of the blur that unsharp masking amplifies the difference to.
_SHARPENING_BLUR_PX = 1.0
# First row and column of red, green (two pixels) and blue in a cell of the mosaic.
_MOSAIC = (((0, 0),), ((0, 1), (1, 0)), ((1, 1),))


class Movement(NamedTuple):
    """Movement of the camera in one photograph.

    Attributes
    ----------
    turn : (3, 3) array
        Rotation of the scene in the camera's frame.
    zoom : float
        Factor of the focal length.
    skew : float
        Sideways displacement of the image per row.
    """

    turn: np.ndarray
    zoom: float
    skew: float


#: No movement.
STILL = Movement(np.eye(3), 1.0, 0.0)


def draw_movements(
    motion: Motion, focal_length_px: float, count: int, random: np.random.Generator
) -> list[Movement]:
    """Draw the movements of consecutive photographs.

    Shake rotates about each axis by an angle that displaces the middle of the picture by
    `shake_px` rms along each side. Drift moves from the first to the last photograph in one
    direction.
    """
    shake = random.normal(0.0, motion.shake_px / focal_length_px, (count, 3))
    direction = random.uniform(0, 2 * math.pi)
    drift = motion.drift_px / focal_length_px * np.linspace(0, 1, count)
    shake[:, 0] += drift * math.cos(direction)
    shake[:, 1] += drift * math.sin(direction)
    zooms = 1 + random.normal(0.0, motion.zoom_rms, count)
    return [
        Movement(_rotation(vector), float(zoom), motion.skew)
        for vector, zoom in zip(shake, zooms, strict=True)
    ]


def _rotation(vector: np.ndarray) -> np.ndarray:
    """Rotation matrix of a rotation vector (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / angle if angle else vector
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn: np.ndarray = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return turn


def stripes(sensor: Sensor) -> np.ndarray:
    """Lit intervals of red, green and blue across a panel pixel: (3, 2), 0 at its left edge."""
    if sensor.subpixels == "none":
        margin = (1 - sensor.pixel_fill) / 2
        return np.array([[margin, 1 - margin]] * 3)
    order = np.array(["rgb".index(colour) for colour in sensor.subpixels])
    centre = np.empty(3)
    centre[order] = (np.arange(3) + 0.5) / 3
    half = sensor.pixel_fill / 6
    return np.stack([centre - half, centre + half], axis=1)


class Shot:
    """A camera at one position, ready to photograph any picture on the panel.

    Parameters
    ----------
    rays : CameraRays
    camera : Camera
    sensor : Sensor
    panel : (rows, columns)
    """

    def __init__(
        self, rays: CameraRays, camera: Camera, sensor: Sensor, panel: tuple[int, int]
    ) -> None:
        self.panel = panel
        self._rays, self._camera, self._sensor = rays, camera, sensor
        y, x = np.indices((camera.rows, camera.columns), np.float32)
        tangent_squared = (
            (x + 0.5 - camera.centre_x_px) ** 2 + (y + 0.5 - camera.centre_y_px) ** 2
        ) / camera.focal_length_px**2
        self._falloff = (1 / (1 + tangent_squared) ** 2).astype(np.float32)
        white = self.light(np.full(panel, 255, np.uint8), STILL)
        self._gain = np.float32(sensor.exposure / np.quantile(white.mean(axis=0), _BRIGHT_QUANTILE))

    def light(self, codes: np.ndarray, movement: Movement) -> np.ndarray:
        """Linear light of red, green and blue on the sensor's pixels, without noise.

        Returns
        -------
        (3, rows, columns) float32
            A lit area of the panel in full view has 1.
        """
        sensor, camera = self._sensor, self._camera
        scale = (np.arange(256) / 255) ** sensor.panel_gamma
        lit = (sensor.panel_black + (1 - sensor.panel_black) * scale).astype(np.float32)
        grey = codes.ndim == 2
        light = np.zeros((3, camera.rows, camera.columns), np.float32)
        _expose(
            lit[np.broadcast_to(codes[..., None], (*codes.shape, 1)) if grey else codes],
            stripes(sensor),
            (1 - sensor.pixel_fill) / 2,
            *self._rays.landing,
            self._rays.tangent_x,
            self._rays.tangent_y,
            self._rays.footprint / 2,
            camera.lens,
            *movement,
            light,
        )
        light *= self._falloff
        mixed: np.ndarray = np.einsum(
            "ij,jrc->irc", np.asarray(sensor.crosstalk, np.float32), light
        )
        for channel in mixed:
            gaussian_filter(channel, sensor.blur_px, truncate=3.5, output=channel)
        return mixed

    def photograph(self, codes: np.ndarray, seed: int, movement: Movement = STILL) -> np.ndarray:
        """Photograph a picture on the panel.

        Parameters
        ----------
        codes : (rows, columns) or (rows, columns, 3) uint8
            Codes of the picture.
        seed : int
            Seed of the noise.
        movement : Movement, optional

        Returns
        -------
        (rows, columns, 3) uint8, sRGB
        """
        return self.develop(self.light(codes, movement), seed)

    def develop(self, light: np.ndarray, seed: int) -> np.ndarray:
        """Photograph of light that `light` returns; see `photograph`."""
        sensor, random = self._sensor, np.random.default_rng(seed)
        light = light * (self._gain * np.asarray(sensor.tint, np.float32)[:, None, None])
        exposed = _mosaic(light) if sensor.has_mosaic else light
        noise = np.sqrt(exposed / np.float32(sensor.full_well) + np.float32(sensor.read_noise**2))
        exposed = exposed + noise * random.standard_normal(exposed.shape, np.float32)
        if sensor.has_mosaic:
            exposed = demosaic(np.clip(exposed, -1, 1))
        levels = (exposed * _LIGHT_LEVELS + np.float32(0.5)).astype(np.int32)
        encoded = _CODES[np.clip(levels, 0, _LIGHT_LEVELS)]
        if sensor.sharpening:
            for channel in encoded:
                blurred = gaussian_filter(channel, _SHARPENING_BLUR_PX, truncate=3)
                channel += np.float32(sensor.sharpening) * (channel - blurred)
        rounded = np.clip(encoded + np.float32(0.5), 0, 255).astype(np.uint8)
        return np.ascontiguousarray(np.moveaxis(rounded, 0, -1))


@compiled
def _expose(
    panel: np.ndarray,
    intervals: np.ndarray,
    row_margin: float,
    columns: np.ndarray,
    rows: np.ndarray,
    weights: np.ndarray,
    tangents_x: np.ndarray,
    tangents_y: np.ndarray,
    half: float,
    lens: Distortion,
    turn: np.ndarray,
    zoom: float,
    skew: float,
    light: np.ndarray,
) -> None:
    """Add the light of all rays to the pixels (colour, row, column) that they fall on.

    `panel`, (rows, columns, 1 or 3), is the light of lit areas. A ray collects the mean light of a
    square of the panel, `half` a side from its centre to its edge.
    """
    colours = panel.shape[2]
    area = 4.0 * half * half
    for i in range(columns.shape[0]):
        for j in range(columns.shape[1]):
            weight = weights[i, j]
            if weight == 0.0:
                continue
            tx, ty = tangents_x[i, j], tangents_y[i, j]
            depth = turn[2, 0] * tx + turn[2, 1] * ty + turn[2, 2]
            x, y = distort(
                lens,
                zoom * (turn[0, 0] * tx + turn[0, 1] * ty + turn[0, 2]) / depth,
                zoom * (turn[1, 0] * tx + turn[1, 1] * ty + turn[1, 2]) / depth,
            )
            x += skew * (y - lens.centre_y)
            # The quarter of a pixel, between 1/4 left and right of its centre.
            left, upper = math.floor(x - 0.25), math.floor(y - 0.25)
            right_share = min(max(2.0 * (x + 0.25 - (left + 1)), 0.0), 1.0)
            lower_share = min(max(2.0 * (y + 0.25 - (upper + 1)), 0.0), 1.0)
            if left < -1 or upper < -1 or left >= light.shape[2] or upper >= light.shape[1]:
                continue
            u, v = columns[i, j], rows[i, j]
            first_column, first_row = math.floor(u - half), math.floor(v - half)
            for colour in range(3):
                total = 0.0
                start, stop = intervals[colour, 0], intervals[colour, 1]
                for row in range(first_row, first_row + 2):
                    high = min(v + half, row + 1 - row_margin) - max(v - half, row + row_margin)
                    if high <= 0.0 or row < 0 or row >= panel.shape[0]:
                        continue
                    for column in range(first_column, first_column + 2):
                        wide = min(u + half, column + stop) - max(u - half, column + start)
                        if wide > 0.0 and 0 <= column < panel.shape[1]:
                            total += high * wide * panel[row, column, colour % colours]
                total *= weight / (area * SAMPLES)
                for below in range(2):
                    row = upper + below
                    if row < 0 or row >= light.shape[1]:
                        continue
                    share = total * (lower_share if below else 1.0 - lower_share)
                    if left >= 0:
                        light[colour, row, left] += share * (1.0 - right_share)
                    if left + 1 < light.shape[2]:
                        light[colour, row, left + 1] += share * right_share


def _mosaic(light: np.ndarray) -> np.ndarray:
    """Pixels (rows, columns) behind a colour filter each: red, green / green, blue."""
    raw = np.empty(light.shape[1:], np.float32)
    for channel, places in zip(light, _MOSAIC, strict=True):
        for row, column in places:
            raw[row::2, column::2] = channel[row::2, column::2]
    return raw


def demosaic(raw: np.ndarray) -> np.ndarray:
    """Interpolate the missing colours of a mosaic bilinearly: (3, rows, columns)."""
    colours = np.zeros((3, *raw.shape), np.float32)
    tent = np.array([0.5, 1.0, 0.5], np.float32)
    for channel, places in zip(colours, _MOSAIC, strict=True):
        for row, column in places:
            channel[row::2, column::2] = raw[row::2, column::2]
    for k in (0, 2):
        colours[k] = convolve1d(
            convolve1d(colours[k], tent, 0, mode="mirror"), tent, 1, mode="mirror"
        )
    green = colours[1]
    cross = convolve1d(green, tent / 2, 0, mode="mirror") + convolve1d(
        green, tent / 2, 1, mode="mirror"
    )
    # The tents add up to the pixel itself where it is green, to the mean of four elsewhere.
    colours[1] = cross
    return colours


def photograph_case(case: Case, patterns: Path, out: Path, burst: int = 1) -> None:
    """Write the photographs of all positions of a case, such as ``position-1/IMG_0100.jpg``.

    Parameters
    ----------
    case : Case
    patterns : Path
        Folder with the PNG files that the panel shows, in the order of their names.
    out : Path
    burst : int
        Photographs of each pattern, without motion between them. The mean of their light is
        written as PNG with 16 bits.
    """
    pictures = read_pictures(patterns)
    sheet = Sheet(case.display, case.assembly)
    for number in range(1, len(case.poses) + 1):
        _photograph_position(case, sheet, number, pictures, out / f"position-{number}", burst)


def read_pictures(patterns: Path) -> list[np.ndarray]:
    """Codes of all PNG files of a folder, in the order of their names."""
    return [_read_picture(path) for path in sorted(patterns.glob("*.png"))]


def _read_picture(path: Path) -> np.ndarray:
    """Codes of a grey, (rows, columns), or coloured picture, (rows, columns, 3)."""
    with Image.open(path) as picture:
        is_grey = picture.mode in ("1", "L")
        return np.asarray(picture.convert("L" if is_grey else "RGB"))


def run_inim(*words: str | Path) -> None:
    """Run an `inim` command in its own process."""
    subprocess.run([sys.executable, "-m", "inim", *map(str, words)], check=True)


def calibrate_case(case: Case, folder: Path) -> Path:
    """Photograph and calibrate a case with the `inim` commands; return the display file.

    Parameters
    ----------
    case : Case
    folder : Path
        Receives `patterns`, `photographs`, `display.xml` and `display-calibration`.
    """
    patterns, photographs = folder / "patterns", folder / "photographs"
    design, display_file = ("--display", case.design.name), folder / "display.xml"
    run_inim("calibrate", "patterns", *design, "-o", patterns)
    photograph_case(case, patterns, photographs)
    run_inim("calibrate", photographs, *design, "-o", display_file)
    return display_file


def take_position(case: Case, sheet: Sheet, number: int) -> Shot:
    """The camera of a case at a position, counted from 1."""
    camera = case.cameras[number - 1]
    rays = sheet.trace(camera, case.poses[number - 1], _seed(case, number))
    return Shot(rays, camera, case.sensor, case.display.eia_shape)


def _seed(case: Case, number: int) -> int:
    return 1000 * case.number + number


def _photograph_position(
    case: Case, sheet: Sheet, number: int, pictures: list[np.ndarray], folder: Path, burst: int
) -> None:
    shot, seed = take_position(case, sheet, number), _seed(case, number)
    movements = draw_movements(
        case.motions[number - 1],
        case.cameras[number - 1].focal_length_px,
        len(pictures),
        np.random.default_rng([seed]),
    )

    def take(index: int) -> None:
        light = shot.light(pictures[index], movements[index])
        jpegs = [
            _jpeg(shot.develop(light, 1000 * seed + 100 * k + index), case.camera, case.sensor)
            for k in range(burst)
        ]
        data = jpegs[0] if burst == 1 else _mean_png(jpegs)
        path = folder / f"IMG_{100 * number + index:04d}.{'jpg' if burst == 1 else 'png'}"
        write_atomically(path, lambda p: p.write_bytes(data))

    with threads(2) as submit:
        for future in [submit(take, index) for index in range(len(pictures))]:
            future.result()


def _mean_png(jpegs: list[bytes]) -> bytes:
    """Mean light of the green channels as PNG with 16 bits and the EXIF of the photographs."""
    light = np.zeros(())
    for jpeg in jpegs:
        with Image.open(io.BytesIO(jpeg)) as picture:
            exif = picture.getexif()
            light = light + linear_from_srgb(np.asarray(picture.getchannel("G")) / 255)
    codes = np.rint(65535 * srgb_from_linear(light / len(jpegs))).astype(np.uint16)
    stream = io.BytesIO()
    Image.fromarray(codes).save(stream, "PNG", exif=exif)
    return stream.getvalue()


def _jpeg(pixels: np.ndarray, camera: Camera, sensor: Sensor) -> bytes:
    exif = Image.Exif()
    exif[_MODEL] = "simulated"
    diagonal = np.hypot(camera.columns, camera.rows)
    exif.get_ifd(_EXIF_IFD)[_FOCAL_LENGTH_35MM] = round(
        camera.focal_length_px / diagonal * _DIAGONAL_35MM
    )
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "JPEG", quality=sensor.quality, exif=exif)
    return stream.getvalue()


def main() -> None:
    """Photograph a case."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("case", type=int, help="number of the case; odd numbers are phones")
    parser.add_argument("--disturbed", action="store_true", help="photograph a disturbed case")
    parser.add_argument("--patterns", type=Path, required=True, help="folder of the patterns")
    parser.add_argument(
        "-o", "--out", type=Path, required=True, help="folder for one subfolder per position"
    )
    args = parser.parse_args()
    draw = draw_disturbed if args.disturbed else draw_case
    photograph_case(draw(args.case), args.patterns, args.out)


if __name__ == "__main__":
    main()
