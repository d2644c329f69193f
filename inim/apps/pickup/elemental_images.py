"""EIA and display from a picture of elemental images: a plenoptic camera's, or one taken through a
lens array.

The picture's pixels become the panel's: they are not resampled, except to rotate elemental images.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from inim.apps.pickup.lattice import Lattice, find_lattice
from inim.display import Display
from inim.display.pixels import pixel_rays, row_blocks
from inim.display.settings import save_display
from inim.image.color import linear_from_srgb
from inim.image.files.eia_file import write_eia
from inim.image.files.image import read_exr
from inim.image.files.picture import is_exr, open_picture
from inim.render.scene_files.file import choose_display, parse_definitions
from inim.system.errors import FileError, UsageError
from inim.system.process.atomic_file import published_together

_FORMATS = ("PNG", "JPEG", "TIFF", "PPM", "BMP")
_UNKNOWN = "not a picture that inim reads; save it as PNG, TIFF, JPEG or EXR"
_MOST_SATURATED = 0.02
# Of the white picture's bright parts: with less light, a quotient is mostly noise.
_DARKEST_WHITE = 0.1
# Settings that the lattice determines.
_MEASURED = (
    *("pitch_y_mm", "lattice", "pixel_pitch_mm", "lens_columns", "lens_rows", "panel_columns"),
    *("panel_rows", "shift_x_mm", "shift_y_mm", "rotation_deg"),
)


@dataclass(frozen=True)
class CapturedEIA:
    """EIA from a picture of elemental images."""

    eia: NDArray[np.float32]  #: (rows, columns, 3): linear RGB; 1 is white.
    display: Display  #: Display whose lenses fit the elemental images.
    lattice: Lattice
    lattice_picture: Path  #: The picture that has this lattice: the white one, if there is one.
    files: tuple[Path, ...]  #: Written files: EIA as .png and .exr, and the display file.


def pickup(
    picture: Path | str,
    display: Display | str | Path | None = None,
    *,
    white: Path | str | None = None,
    dark: Path | str | None = None,
    definitions: Mapping[str, Any] | None = None,
    about_px: float | None = None,
    orthoscopic: bool = False,
    raw: bool = False,
    out: Path | str | None = None,
) -> CapturedEIA:
    """Convert a picture of elemental images to an EIA and a display.

    Lattice, counts, rotation, shift and pixel pitch of the display are measured: one lens pitch is
    as long as one elemental image. Its lens pitch, gap and focal length are those of `display`.

    Parameters
    ----------
    picture : path
        Raw picture of a plenoptic camera, or photograph of the elemental images behind a lens
        array: PNG, TIFF, JPEG or linear EXR.
    display : Display, str or path, optional
        Display with the lenses: a value, the name of a preset or a display file.
    white, dark : path, optional
        Pictures of a uniform bright surface and with the cap on, of the same size, with the same
        aperture. The picture is divided by the white one, after subtraction of the dark one.
    about_px : float, optional
        Without a white picture: pitch of the elemental images within 2.5 %. The lattice follows
        from the seams between them.
    definitions : mapping, optional
        Settings to override: ``{"inim.gap_mm": 3.2}``.
    orthoscopic : bool
        False: the elemental images are those of a capture, which is pseudoscopic when it is shown
        (Lippmann 1908). Each is rotated by 180 degrees. True: they are used as they are.
    raw : bool
        Codes are proportional to light, as in a sensor's raw picture. False: they are sRGB. EXR
        files are linear in both cases.
    out : path, optional
        Display file to write (.xml), with the EIA next to it (.png and .exr). None writes no files.

    Raises
    ------
    InimError
        Pictures that are unreadable, differ in size, are saturated or have no lattice, or files
        that cannot be written.
    """
    path = Path(picture)
    if (white is None) == (about_px is None):
        raise UsageError(f"{path}: give either --white FILE or --pitch-px PIXELS, and not both")
    if about_px is not None and not 0 < about_px < math.inf:
        raise UsageError(f"--pitch-px {about_px:g}: give a number of pixels above 0")
    light = _read_light(path, raw)
    black: np.ndarray | float = 0.0
    if dark is not None:
        black = _read_same_size(Path(dark), raw, path, light.shape)
    light = (light - black).astype(np.float32)
    lattice_picture, lattice_light = path, light
    if white is not None:
        lattice_picture = Path(white)
        uniform = _read_same_size(lattice_picture, raw, path, light.shape)
        if (saturated := float((uniform >= 1).mean())) > _MOST_SATURATED:
            raise FileError(
                f"{white}: {saturated:.0%} of it is saturated; expose the white picture less"
            )
        lattice_light = uniform - black
    # The mean of the colours: their pixels coincide.
    lattice = find_lattice(lattice_light.mean(axis=-1), str(lattice_picture), about_px)
    if white is not None:
        light = _divide(light, lattice_light, str(white))
    design, _ = choose_display(display, parse_definitions(definitions or {}), "inim pickup")
    for key in definitions or {}:
        if str(key).removeprefix("inim.") in _MEASURED:
            raise UsageError(f"-D {key}: is measured in {lattice_picture.name}; leave it out")
    real = lattice_display(lattice, design, light.shape[:2])
    eia = light if orthoscopic else _rotate_elemental_images(light, real)
    eia = np.maximum(eia, 0).astype(np.float32)
    files = () if out is None else _write(Path(out), eia, real, (path, white, dark))
    return CapturedEIA(eia, real, lattice, lattice_picture, files)


def _read_light(path: Path, raw: bool) -> np.ndarray:
    """Linear light, (rows, columns, 3) float32; 1 is the largest code."""
    if is_exr(path):
        linear = read_exr(path)
        if not np.isfinite(linear).all():
            raise FileError(f"{path}: has colours that are not finite; save it again")
        return np.broadcast_to(linear, (*linear.shape[:2], 3))
    with open_picture(path, _FORMATS, 4, _UNKNOWN) as picture:
        if picture.mode.startswith("I"):  # grey of 16 bits
            codes, largest = np.asarray(picture, np.float32)[..., None], 65535
        else:
            codes, largest = np.asarray(picture.convert("RGB"), np.float32), 255
    light = codes / np.float32(largest)
    return np.broadcast_to(light if raw else linear_from_srgb(light), (*light.shape[:2], 3))


def _read_same_size(path: Path, raw: bool, picture: Path, shape: tuple[int, ...]) -> np.ndarray:
    light = _read_light(path, raw)
    if light.shape != shape:
        sizes = [f"{s[1]} x {s[0]}" for s in (light.shape, shape)]
        raise FileError(
            f"{path}: has {sizes[0]} pixels, but {picture.name} has {sizes[1]}; give pictures of "
            "one camera"
        )
    return light


def _divide(light: np.ndarray, white: np.ndarray, name: str) -> np.ndarray:
    """Light relative to white; 0 where the white picture is too dark."""
    bright = np.quantile(white, 0.9, axis=(0, 1))
    if not (bright > 0).all():
        raise FileError(f"{name}: is black; give a picture of a uniform bright surface")
    is_lit = white > _DARKEST_WHITE * bright
    quotient: np.ndarray = np.divide(light, white, out=np.zeros_like(light), where=is_lit)
    return quotient


def lattice_display(lattice: Lattice, design: Display, shape: tuple[int, int]) -> Display:
    """Display with the lenses of `design` above the elemental images of a picture.

    * `shape`: rows and columns of the picture, which becomes the panel.
    """
    pixel_mm = design.elemental_image_pitch_mm / lattice.pitch_px.value
    row_pitch_mm = design.pitch_mm * lattice.row_pitch_px.value / lattice.pitch_px.value
    return design.replace(
        name=f"{design.name}, measured lattice",
        lattice=lattice.kind,  # type: ignore[arg-type]
        pitch_y_mm=None if lattice.is_regular else row_pitch_mm,
        pixel_pitch_mm=pixel_mm,
        lens_columns=lattice.columns,
        lens_rows=lattice.rows,
        panel_columns=shape[1],
        panel_rows=shape[0],
        shift_x_mm=(lattice.x_px.value - shape[1] / 2) * pixel_mm,
        shift_y_mm=(shape[0] / 2 - lattice.y_px.value) * pixel_mm,
        rotation_deg=lattice.rotation_deg.value,
    )


def _rotate_elemental_images(light: np.ndarray, display: Display) -> np.ndarray:
    """Rotate each elemental image by 180 degrees about its centre, by linear interpolation."""
    # Centres of elemental images have their own pitch about the array's centre.
    scale = display.elemental_image_pitch_mm / display.pitch_mm / display.pixel_pitch_mm
    rows, columns = display.eia_shape
    x = display.shift_x_mm / display.pixel_pitch_mm
    y = display.shift_y_mm / display.pixel_pitch_mm
    rotated = np.zeros_like(light)
    for block in row_blocks(display):
        rays = pixel_rays(display, block)
        centre_x = columns / 2 + x + (rays.x0 - display.shift_x_mm) * scale
        centre_y = rows / 2 - y - (rays.y0 - display.shift_y_mm) * scale
        # Indices: a pixel's centre is half a pixel from its edge.
        column = 2 * centre_x - np.arange(columns)[None, :] - 1
        row = 2 * centre_y - np.arange(block.start, block.stop)[:, None] - 1
        for channel in range(3):
            rotated[block, :, channel] = ndimage.map_coordinates(
                light[..., channel], [row, column], order=1, mode="constant"
            )
    return rotated


def _write(
    out: Path, eia: NDArray[np.float32], display: Display, inputs: tuple[Path | str | None, ...]
) -> tuple[Path, ...]:
    if out.suffix.lower() != ".xml":
        raise UsageError(f"-o {out}: a display file is an .xml; name it {out.stem}.xml")
    files = tuple(out.with_suffix(suffix) for suffix in (".png", ".exr", ".xml"))
    for source in inputs:
        if source is not None and any(
            os.path.realpath(source) == os.path.realpath(f) for f in files
        ):
            raise UsageError(f"-o {out}: would replace {source}; give it another name")
    with published_together():
        for path in files[:2]:
            write_eia(path, eia, None, display.pixel_pitch_mm)
        save_display(display, out)
    return files
