"""Photographs of a hidden display that shows the calibration's patterns, as a camera writes them.

    inim calibrate patterns --display nominal -o out/patterns
    python -m reports.calibration.photographs 0 --patterns out/patterns -o out/photographs

makes case 0 of `reports.calibration.cases`: a folder of JPEGs for each camera position. What was
hidden is written to no file there. Even cases are nominal displays, odd ones phones.

Where rays land (`reports.calibration.landing`), the picture on the panel says what light they
bring: the panel's gamma and black level, and dark gaps between its pixels. Then the sensor: light
falls off by cos^4, blur, exposure, shot and read noise, sRGB codes, JPEG of quality 90 with a focal
length in EXIF.
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

from inim.files.image import write_atomically
from inim.image.color import srgb_from_linear, srgb_to_uint8
from inim.process.threads import threads
from reports.calibration.cases import Case, Sensor, draw_case
from reports.calibration.landing import SAMPLES, Camera, Landing, Pose, Sheet

_QUALITY = 90
_BRIGHT_QUANTILE = 0.99
# Codes come from a table of so many lights: half a code in the darkest shade.
_LIGHTS = 1 << 14
_CODES = srgb_to_uint8(srgb_from_linear(np.arange(_LIGHTS + 1) / _LIGHTS))
_EXIF_IFD, _FOCAL_LENGTH_35MM, _MODEL = 0x8769, 41989, 0x0110
_DIAGONAL_35MM = np.hypot(36, 24)


class Shot:
    """A camera at a place, ready to photograph any picture on the panel.

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
        shines = (np.abs(landing.column - column - 0.5) <= half) & (
            np.abs(landing.row - row - 0.5) <= half
        )
        self._weight = landing.weight * shines / np.float32(SAMPLES)
        y, x = np.indices((camera.rows, camera.columns), np.float32)
        tangent_squared = (
            (x + 0.5 - camera.centre_x_px) ** 2 + (y + 0.5 - camera.centre_y_px) ** 2
        ) / camera.focal_length_px**2
        self._falloff = (1 / (1 + tangent_squared) ** 2).astype(np.float32)
        white = self._light(np.full(panel, 255, np.uint8))
        self._gain = np.float32(sensor.exposure / np.quantile(white, _BRIGHT_QUANTILE))

    def _light(self, codes: np.ndarray) -> np.ndarray:
        """What the sensor's pixels get of a picture on the panel, linear."""
        sensor = self._sensor
        scale = (np.arange(256) / 255) ** sensor.panel_gamma
        shown = (sensor.panel_black + (1 - sensor.panel_black) * scale).astype(np.float32)
        light = shown[codes].ravel()[self._pixel]
        light *= self._weight
        seen = light.reshape(self._camera.rows, self._camera.columns, SAMPLES).sum(axis=-1)
        blurred: np.ndarray = gaussian_filter(seen * self._falloff, sensor.blur_px, truncate=3)
        return blurred

    def photograph(self, codes: np.ndarray, seed: int) -> np.ndarray:
        """A photograph of a picture on the panel.

        Parameters
        ----------
        codes : (rows, columns) uint8
            Grey.
        seed : int
            Of the noise.

        Returns
        -------
        (rows, columns, 3) uint8, sRGB
        """
        sensor, random = self._sensor, np.random.default_rng(seed)
        light, dark = self._light(codes), np.float32(sensor.read_noise**2)
        found = np.empty((*light.shape, len(sensor.tint)), np.uint8)
        for channel, tint in enumerate(sensor.tint):
            seen = light * (self._gain * np.float32(tint))
            noise = np.sqrt(seen / np.float32(sensor.full_well) + dark)
            seen += noise * random.standard_normal(seen.shape, np.float32)
            places = (seen * _LIGHTS + np.float32(0.5)).astype(np.int32)
            found[..., channel] = _CODES[np.clip(places, 0, _LIGHTS)]
        return found


def photograph_case(case: Case, patterns: Path, out: Path, *, facets: int | None = None) -> None:
    """Write the photographs of all positions of a case: ``position-1/IMG_0001.jpg`` and so on.

    Parameters
    ----------
    case : Case
    patterns : Path
        Folder with the PNGs that the panel shows, in the order of their names.
    out : Path
    facets : int, optional
        Of the sheet; see `inim.lens.full.sheet_mesh`.
    """
    shown = [np.asarray(Image.open(path).convert("L")) for path in sorted(patterns.glob("*.png"))]
    sheet = Sheet(case.display, facets)
    for number, pose in enumerate(case.poses, 1):
        _position(case, sheet, pose, number, shown, out / f"position-{number}")


def run_inim(*words: str | Path) -> None:
    """Run a command of the project as a user does."""
    subprocess.run([sys.executable, "-m", "inim", *map(str, words)], check=True)


def calibrated(case: Case, folder: Path) -> Path:
    """The display file of a case: patterns, photographs and calibration, as a user makes them.

    Parameters
    ----------
    case : Case
    folder : Path
        Gets `patterns`, `photographs`, `display.xml` and `display-calibration`.
    """
    patterns, photographs = folder / "patterns", folder / "photographs"
    design, found = ("--display", case.design.name), folder / "display.xml"
    run_inim("calibrate", "patterns", *design, "-o", patterns)
    photograph_case(case, patterns, photographs)
    run_inim("calibrate", photographs, *design, "-o", found)
    return found


def _position(
    case: Case, sheet: Sheet, pose: Pose, number: int, shown: list[np.ndarray], folder: Path
) -> None:
    landing = sheet.trace(case.camera, pose, seed=1000 * case.number + number)
    shot = Shot(landing, case.camera, case.sensor, case.display.eia_shape)

    def take(index: int) -> None:
        seed = (1000 * case.number + number) * 1000 + index
        data = _jpeg(shot.photograph(shown[index], seed), case.camera)
        path = folder / f"IMG_{100 * number + index:04d}.jpg"
        write_atomically(path, lambda p: p.write_bytes(data))

    with threads(2) as submit:
        for one in [submit(take, index) for index in range(len(shown))]:
            one.result()


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
    parser.add_argument("case", type=int, help="number of the case; odd ones are phones")
    parser.add_argument("--patterns", type=Path, required=True, help="folder of the pictures shown")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of folders")
    args = parser.parse_args()
    photograph_case(draw_case(args.case), args.patterns, args.out)


if __name__ == "__main__":
    main()
