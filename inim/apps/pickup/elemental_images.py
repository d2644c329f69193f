"""EIA and display from a picture taken through a lens array, whose pixels become the panel's."""

import math
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
from inim.image.files.eia_file import write_eia
from inim.image.files.picture import read_light
from inim.render.scene_files.file import choose_display
from inim.system.errors import FileError, UsageError
from inim.system.process.atomic_file import published_together

# Share of saturated pixels, and light in that of bright parts: a quotient by less is mostly noise.
_MOST_SATURATED, _DARKEST_WHITE = 0.02, 0.1


@dataclass(frozen=True)
class CapturedEIA:
    """EIA from a picture of elemental images."""

    eia: NDArray[np.float32]  #: (rows, columns, 3): linear RGB; 1 is white.
    display: Display  #: Display whose lenses fit the elemental images.
    lattice: Lattice
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

    The lattice gives counts, rotation, shift and pixel pitch of the display, so that a lens covers
    an elemental image. Its lens pitch, gap and focal length are those of `display`.

    Parameters
    ----------
    picture : path
        PNG, TIFF, JPEG or linear EXR.
    display : Display, str or path, optional
        Display with the lenses: a value, the name of a preset or a display file.
    white, dark : path, optional
        Pictures of a uniform bright surface and with the cap on, with the same aperture. The
        picture is divided by the white one, after subtraction of the dark one.
    definitions : mapping, optional
        Settings to override: ``{"inim.gap_mm": 3.2}``.
    about_px : float, optional
        Without a white picture: pitch of the elemental images within 2.5 %.
    orthoscopic : bool
        False: the elemental images are those of a capture, which is pseudoscopic when it is shown
        (Lippmann 1908). Each is rotated by 180 degrees. True: they are used as they are.
    raw : bool
        Codes are proportional to light, as in a sensor's raw picture. False: they are sRGB.
    out : path, optional
        Display file to write (.xml), with the EIA next to it (.png and .exr). None writes no files.

    Raises
    ------
    InimError
        Pictures that are unreadable, differ in size, are saturated, or have no lattice.
    """
    path = Path(picture)
    if (white is None) == (about_px is None):
        raise UsageError(f"{path}: give either --white FILE or --pitch-px PIXELS, and not both")
    if about_px is not None and not 0 < about_px < math.inf:
        raise UsageError(f"--pitch-px {about_px:g}: give a number of pixels above 0")
    if out is not None and Path(out).suffix.lower() != ".xml":
        raise UsageError(f"-o {out}: a display file is an .xml; name it {Path(out).stem}.xml")
    files = [Path(out).with_suffix(s) for s in (".png", ".exr", ".xml")] if out is not None else []
    for source in (picture, white, dark):
        if source is not None and Path(source).resolve() in [file.resolve() for file in files]:
            raise UsageError(f"-o {out}: would replace {source}; give it another name")
    design, _ = choose_display(display, definitions, "inim pickup")
    light = read_light(path, raw)
    rows, columns, _ = light.shape

    def read(other: Path | str) -> NDArray[np.float32]:
        pixels = read_light(Path(other), raw)
        if pixels.shape != light.shape:
            raise FileError(
                f"{other}: has {pixels.shape[1]} x {pixels.shape[0]} pixels, but {path.name} has "
                f"{columns} x {rows}; give pictures of one camera"
            )
        return pixels

    black = 0 if dark is None else read(dark)
    light = light - black
    if white is None:
        lattice = find_lattice(light.mean(axis=-1), str(path), about_px)
    else:
        uniform = read(white)
        if (saturated := float((uniform >= 1).mean())) > _MOST_SATURATED:
            raise FileError(f"{white}: {saturated:.0%} of it is saturated; expose it less")
        uniform = uniform - black
        lattice = find_lattice(uniform.mean(axis=-1), str(white))
        is_lit = uniform > np.maximum(_DARKEST_WHITE * np.quantile(uniform, 0.9, axis=(0, 1)), 0)
        light = np.divide(light, uniform, out=np.zeros_like(light), where=is_lit)
    pixel_mm = design.elemental_image_pitch_mm / lattice.pitch_px.value
    row_pitch_mm = design.pitch_mm * lattice.row_pitch_px.value / lattice.pitch_px.value
    real = design.replace(
        name=f"{design.name}, measured lattice",
        lattice=lattice.kind,
        pitch_y_mm=None if lattice.is_regular else row_pitch_mm,
        pixel_pitch_mm=pixel_mm,
        lens_columns=lattice.columns,
        lens_rows=lattice.rows,
        panel_columns=columns,
        panel_rows=rows,
        shift_x_mm=(lattice.x_px.value - columns / 2) * pixel_mm,
        shift_y_mm=(rows / 2 - lattice.y_px.value) * pixel_mm,
        rotation_deg=lattice.rotation_deg.value,
    )
    for key in definitions or {}:
        name = key.removeprefix("inim.")
        if getattr(real, name, None) != getattr(design, name, None):
            raise UsageError(f"-D {key}: is measured in the picture; leave it out")
    eia = light if orthoscopic else _rotate_elemental_images(light, lattice, real)
    eia = np.maximum(eia, 0).astype(np.float32)
    with published_together():
        for file in files[:2]:
            write_eia(file, eia, None, pixel_mm)
        for file in files[2:]:
            save_display(real, file)
    return CapturedEIA(eia, real, lattice, tuple(files))


def _rotate_elemental_images(
    light: np.ndarray, lattice: Lattice, display: Display
) -> NDArray[np.float32]:
    """Rotate each elemental image by 180 degrees about its centre, by linear interpolation."""
    centres, rotated = lattice.centres_px().reshape(-1, 2), np.zeros_like(light)
    for block in row_blocks(display):
        lens = pixel_rays(display, block).lens
        row, column = np.nonzero(lens >= 0)
        x, y = 2 * centres[lens[row, column]].T - 1
        row += block.start
        for channel in range(3):
            rotated[row, column, channel] = ndimage.map_coordinates(
                light[..., channel], [y - row, x - column], order=1, mode="constant"
            )
    return rotated
