"""Calibration of a display from a folder of photographs, with its files."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.calibration.decode import decode
from inim.calibration.fit import check_display, fit_display
from inim.calibration.fringes import Fringes, find_fringes
from inim.calibration.lattice import Lenses, find_lenses
from inim.calibration.model import Intrinsics
from inim.calibration.output import calibration_document, display_file, residual_maps
from inim.calibration.patterns import read_positions
from inim.calibration.result import Calibration
from inim.display import Display
from inim.display.looking_glass import LookingGlass
from inim.documents.document import write_text
from inim.errors import UsageError
from inim.report.calibration import FILES, write_calibration
from inim.scene.file import choose_display, parse_definitions
from inim.worker.output import output_files

# Pixels whose sides differ by more are not square.
_SQUARE = 0.005


def calibrate(
    photos: Path | str,
    display: Display | str | Path | None = None,
    *,
    definitions: Mapping[str, Any] | None = None,
    intrinsics: str | Sequence[float] | None = None,
    out: Path | str | None = None,
    is_steady: bool = False,
    command: str = "",
    warn: Callable[[str], object] = warnings.warn,
) -> Calibration:
    """Measure a display's parameters from photographs of patterns on it.

    Also writes a display file, and a report next to it, into the folder `OUT-calibration`. There is
    no display file if the result has `failures`.

    Parameters
    ----------
    photos : path
        Folder with one subfolder of photographs, or one video, per camera position; see
        `inim.calibration.patterns.write_patterns`.
    display : Display, str or path, optional
        The display as designed: a value, the name of a preset or a display file.
    definitions : mapping, optional
        Settings to override: ``{"inim.gap_mm": 3.2}``.
    intrinsics : str or six floats, optional
        ``FX, FY, CX, CY, K1, K2`` in pixels, as OpenCV defines them; by default fitted.
    out : path, optional
        Display file to write; default: `PHOTOS.xml` in the current folder, or `PHOTOS.json` of a
        slanted lenticular display, which is its `visual.json`.
    is_steady : bool
        True if the camera stood on a firm support and nobody touched it. Photographs by a moving
        camera with a rolling shutter are skewed, which few positions do not distinguish from a
        shift of the sheet.
    command : str
        Command line, for the record.
    warn : callable
        Receives warnings as text; by default `warnings.warn`.

    Returns
    -------
    Calibration
        Its `display` is the measured one; `undetermined` lists parameters that the photographs do
        not determine.

    Raises
    ------
    InimError
        Unusable photographs, a display that cannot be calibrated, or files that cannot be written.
    """
    photos = Path(photos)
    design, settings = choose_display(
        display, parse_definitions(definitions or {}), "inim calibrate"
    )
    file, folder = output_paths(photos, out, design)
    ending = _ending(design)
    if file.suffix.lower() != ending:
        article = "an" if ending == ".xml" else "a"
        raise UsageError(
            f"-o {file}: a display file is {article} {ending}; name it {file.stem}{ending}"
        )
    camera = _camera(intrinsics)
    check_display(design)
    lenses, focal_px = _lenses(photos, design, warn)
    calibration = fit_display(lenses, design, camera=camera, focal_px=focal_px, is_steady=is_steady)
    title = f"Calibration: {photos.resolve().name}"
    document = calibration_document(calibration, title, command, is_steady)
    with output_files(folder, FILES) as staging:
        write_calibration(document, residual_maps(calibration), staging)
    if not calibration.failures:
        text = (
            LookingGlass.of(calibration.display).text()
            if design.layout.of_cylinders
            else display_file(calibration, settings.display)
        )
        write_text(file, text)
    for warning in document.warnings:
        warn(warning)
    return calibration


def _ending(design: Display) -> str:
    """Ending of display files: of lenticular displays, the vendor's `visual.json`."""
    return ".json" if design.layout.of_cylinders else ".xml"


def output_paths(photos: Path | str, out: Path | str | None, design: Display) -> tuple[Path, Path]:
    """Display file and folder of the report."""
    default = f"{Path(photos).resolve().name}{_ending(design)}"
    file = Path(default if out is None else out)
    return file, file.with_name(f"{file.stem}-calibration")


def _camera(intrinsics: str | Sequence[float] | None) -> Intrinsics | None:
    """Camera given by `--intrinsics`, as text or as numbers."""
    if intrinsics is None:
        return None
    text = intrinsics if isinstance(intrinsics, str) else ",".join(map(str, intrinsics))
    try:
        fx, fy, cx, cy, k1, k2 = map(float, text.split(","))
    except ValueError:
        raise UsageError(
            f"--intrinsics {text}: write FX,FY,CX,CY,K1,K2 in pixels of the photographs, such as "
            "3020,3020,2015.5,1511.5,0.02,-0.05"
        ) from None
    if not (fx > 0 and abs(fx - fy) < _SQUARE * fx):
        raise UsageError(
            f"--intrinsics {text}: focal lengths of {fx:g} and {fy:g} pixels; both must be above 0 "
            "and equal, because pixels are assumed to be square"
        )
    # Pixel centres are at half-integers here, at integers there.
    return Intrinsics((fx + fy) / 2, cx + 0.5, cy + 0.5, k1, k2)


def _lenses(
    photos: Path, display: Display, warn: Callable[[str], object]
) -> tuple[dict[str, Lenses | Fringes], float | None]:
    """Lenses, or fringes of cylinders, of each position, and the focal length in the metadata."""
    positions = read_positions(photos, display)
    stated = {position.focal_length_px for position in positions}
    if len(stated - {None}) > 1:
        raise UsageError(
            f"{photos}: the camera's focal length differs between positions; photograph all with "
            "one lens and without zoom"
        )
    find: Any = find_fringes if display.layout.of_cylinders else find_lenses
    lenses: dict[str, Lenses | Fringes] = {}
    for position in positions:
        decoded = decode(position)
        for warning in decoded.warnings:
            warn(warning)
        lenses[position.name] = find(decoded, display, position.name)
    return lenses, stated.pop() if len(stated) == 1 else None
