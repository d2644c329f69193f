"""Simulated photographs of a misaligned display that shows the calibration's patterns.

    inim calibrate patterns --display nominal -o out/patterns
    python -m reports.calibration.photographs 0 --patterns out/patterns -o out/photographs

These commands photograph case 0 of `reports.calibration.cases`: one folder of JPEGs for each camera
position. The misalignment is not written to these folders.

The panel points of the rays come from `reports.calibration.landing`. The model of the panel
contains its gamma, its black level and the dark gaps between its pixels. The model of the camera
contains cos^4 falloff, blur, exposure, shot noise, read noise, sRGB codes and JPEG compression of
quality 90 with a focal length in EXIF.
"""

from __future__ import annotations

import argparse
import io
import subprocess
import sys
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from inim.image.color import srgb_from_linear, srgb_to_uint8
from inim.process.atomic_file import write_atomically
from inim.process.threads import threads
from reports.calibration.cases import Case, Sensor, draw_case
from reports.calibration.landing import SAMPLES, Camera, Landing, Pose, Sheet

_QUALITY = 90
_BRIGHT_QUANTILE = 0.99
# Intervals of the table from linear light to sRGB codes: half a code in the darkest shade.
_LIGHT_LEVELS = 1 << 14
_CODES = srgb_to_uint8(srgb_from_linear(np.arange(_LIGHT_LEVELS + 1) / _LIGHT_LEVELS))
_EXIF_IFD, _FOCAL_LENGTH_35MM, _MODEL = 0x8769, 41989, 0x0110
_DIAGONAL_35MM = np.hypot(36, 24)


class Shot:
    """A camera at one position, ready to photograph any picture on the panel.

    Parameters
    ----------
    landing : Landing
    camera : Camera
    sensor : Sensor
    panel : (rows, columns)
    """

    def __init__(
        self, landing: Landing, camera: Camera, sensor: Sensor, panel: tuple[int, int]
    ) -> None:
        self.panel = panel
        self._camera, self._sensor = camera, sensor
        column, row = (values.astype(np.int32) for values in (landing.column, landing.row))
        self._pixel = row * panel[1] + column
        half = np.float32(sensor.pixel_fill / 2)
        is_lit = (np.abs(landing.column - column - 0.5) <= half) & (
            np.abs(landing.row - row - 0.5) <= half
        )
        self._weight = landing.weight * is_lit / np.float32(SAMPLES)
        y, x = np.indices((camera.rows, camera.columns), np.float32)
        tangent_squared = (
            (x + 0.5 - camera.centre_x_px) ** 2 + (y + 0.5 - camera.centre_y_px) ** 2
        ) / camera.focal_length_px**2
        self._falloff = (1 / (1 + tangent_squared) ** 2).astype(np.float32)
        white = self._light(np.full(panel, 255, np.uint8))
        self._gain = np.float32(sensor.exposure / np.quantile(white, _BRIGHT_QUANTILE))

    def _light(self, codes: np.ndarray) -> np.ndarray:
        """Linear light on the sensor's pixels, without noise."""
        sensor = self._sensor
        scale = (np.arange(256) / 255) ** sensor.panel_gamma
        panel_light = (sensor.panel_black + (1 - sensor.panel_black) * scale).astype(np.float32)
        ray_light = panel_light[codes].ravel()[self._pixel]
        ray_light *= self._weight
        light = ray_light.reshape(self._camera.rows, self._camera.columns, SAMPLES).sum(axis=-1)
        blurred: np.ndarray = gaussian_filter(light * self._falloff, sensor.blur_px, truncate=3)
        return blurred

    def photograph(self, codes: np.ndarray, seed: int) -> np.ndarray:
        """Photograph a picture on the panel.

        Parameters
        ----------
        codes : (rows, columns) uint8
            Grey values of the picture.
        seed : int
            Seed of the noise.

        Returns
        -------
        (rows, columns, 3) uint8, sRGB
        """
        sensor, random = self._sensor, np.random.default_rng(seed)
        light, dark = self._light(codes), np.float32(sensor.read_noise**2)
        photograph = np.empty((*light.shape, len(sensor.tint)), np.uint8)
        for channel, tint in enumerate(sensor.tint):
            exposed = light * (self._gain * np.float32(tint))
            noise = np.sqrt(exposed / np.float32(sensor.full_well) + dark)
            exposed += noise * random.standard_normal(exposed.shape, np.float32)
            levels = (exposed * _LIGHT_LEVELS + np.float32(0.5)).astype(np.int32)
            photograph[..., channel] = _CODES[np.clip(levels, 0, _LIGHT_LEVELS)]
        return photograph


def photograph_case(case: Case, patterns: Path, out: Path, *, facets: int | None = None) -> None:
    """Write the photographs of all positions of a case, such as ``position-1/IMG_0100.jpg``.

    Parameters
    ----------
    case : Case
    patterns : Path
        Folder with the PNG files that the panel shows, in the order of their names.
    out : Path
    facets : int, optional
        Facets of the sheet's mesh; see `inim.lens.full.sheet_mesh`.
    """
    pictures = [
        np.asarray(Image.open(path).convert("L")) for path in sorted(patterns.glob("*.png"))
    ]
    sheet = Sheet(case.display, facets)
    for number, pose in enumerate(case.poses, 1):
        _photograph_position(case, sheet, pose, number, pictures, out / f"position-{number}")


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


def _photograph_position(
    case: Case, sheet: Sheet, pose: Pose, number: int, pictures: list[np.ndarray], folder: Path
) -> None:
    landing = sheet.trace(case.camera, pose, seed=1000 * case.number + number)
    shot = Shot(landing, case.camera, case.sensor, case.display.eia_shape)

    def take(index: int) -> None:
        seed = (1000 * case.number + number) * 1000 + index
        data = _jpeg(shot.photograph(pictures[index], seed), case.camera)
        path = folder / f"IMG_{100 * number + index:04d}.jpg"
        write_atomically(path, lambda p: p.write_bytes(data))

    with threads(2) as submit:
        for future in [submit(take, index) for index in range(len(pictures))]:
            future.result()


def _jpeg(pixels: np.ndarray, camera: Camera) -> bytes:
    exif = Image.Exif()
    exif[_MODEL] = "simulated"
    diagonal = np.hypot(camera.columns, camera.rows)
    exif.get_ifd(_EXIF_IFD)[_FOCAL_LENGTH_35MM] = round(
        camera.focal_length_px / diagonal * _DIAGONAL_35MM
    )
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "JPEG", quality=_QUALITY, exif=exif)
    return stream.getvalue()


def main() -> None:
    """Photograph a case."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("case", type=int, help="number of the case; odd numbers are phones")
    parser.add_argument("--patterns", type=Path, required=True, help="folder of the patterns")
    parser.add_argument(
        "-o", "--out", type=Path, required=True, help="folder for one subfolder per position"
    )
    args = parser.parse_args()
    photograph_case(draw_case(args.case), args.patterns, args.out)


if __name__ == "__main__":
    main()
