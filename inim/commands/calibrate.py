"""`inim calibrate`: a real display's parameters, from photographs of patterns that it shows."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from inim.commands.options import (
    Command,
    add_choices,
    add_debug,
    add_exit_codes,
    choices_of,
    print_outcome,
    print_warning,
)
from inim.errors import EXIT_CHECK_FAILED, EXIT_PASSED, UsageError

if TYPE_CHECKING:
    from inim.calibrate.fit import Calibration
    from inim.calibrate.lattice import Lenses
    from inim.calibrate.model import Camera
    from inim.display import Display
    from inim.documents.calibration import CalibrationDocument

_PATTERNS = "patterns"
_EPILOG = """first
  inim calibrate patterns --display phone -o DIR
  writes the pictures to photograph, and a page that shows them full screen. Photograph all of them
  from each of four positions or more: straight on from two distances, and from two sides.

then
  inim calibrate PHOTOS --display phone -o mydisplay.xml
  PHOTOS holds a folder for each camera position, whose pictures sort in the order of the patterns.

"""
# Pixels whose sides differ by more are not square.
_SQUARE = 0.005


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    add_exit_codes(parser)
    parser.epilog = _EPILOG + (parser.epilog or "")
    parser.description = (
        "Fit a display's pitch, rotation, shift, gap, tilt and focal length to photographs of "
        "patterns that it shows; write a display file for --display, and a report. Code 1: "
        "the photographs do not determine all of them."
    )
    parser.add_argument(
        "photos",
        metavar="PHOTOS|patterns",
        help="folder of folders of photographs, one for each position; or the word patterns",
    )
    add_choices(parser, "display", "definitions")
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        help="display file (PHOTOS.xml), its report beside it; of patterns, their folder",
    )
    parser.add_argument(
        "--intrinsics",
        metavar="FX,FY,CX,CY,K1,K2",
        help="of the camera where known, as OpenCV gives them, pixels; fitted otherwise",
    )
    add_debug(parser)


def _run(args: argparse.Namespace) -> int:
    from inim.scene.file import choose_display

    display, settings = choose_display(**choices_of(args), source="inim calibrate")
    if args.photos == _PATTERNS:
        return _write_patterns(args, display)
    return _calibrate(args, display, settings.display)


def _write_patterns(args: argparse.Namespace, display: Display) -> int:
    from inim.calibrate.patterns import write_patterns

    if args.intrinsics is not None:
        raise UsageError("--intrinsics: patterns have no camera; leave it out")
    page = write_patterns(display, args.out or Path(_PATTERNS))
    print_outcome(f"patterns: open {page} on the display")
    return EXIT_PASSED


def _calibrate(args: argparse.Namespace, display: Display, preset: str) -> int:
    from inim.calibrate.fit import calibrate, check_display

    photos = Path(args.photos)
    out = args.out or Path(f"{photos.resolve().name}.xml")
    if out.suffix.lower() != ".xml":
        raise UsageError(f"-o {out}: a display file is an .xml; name it {out.stem}.xml")
    camera = _camera(args.intrinsics)
    check_display(display)
    lenses, focal_px = _lenses(photos, display)
    found = calibrate(lenses, display, camera=camera, focal_px=focal_px)
    document = _write(found, args, out, preset)
    print("\n".join(_table(found)))
    for warning in document.warnings:
        print_warning(warning)
    print_outcome(f"calibrated: {out}, {_report_folder(out) / 'calibration.html'}")
    return EXIT_CHECK_FAILED if found.unknown else EXIT_PASSED


def _camera(text: str | None) -> Camera | None:
    """What `--intrinsics` says."""
    from inim.calibrate.model import Camera

    if text is None:
        return None
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
            "and alike, for pixels are taken to be square"
        )
    # Pixel centres are at half-integers here, at integers there.
    return Camera((fx + fy) / 2, cx + 0.5, cy + 0.5, k1, k2)


def _lenses(photos: Path, display: Display) -> tuple[dict[str, Lenses], float | None]:
    """The lenses that each position shows, and the focal length that the photographs state."""
    from inim.calibrate.decode import decode
    from inim.calibrate.lattice import find_lenses
    from inim.calibrate.photographs import read_positions

    positions = read_positions(photos, display)
    stated = {one.focal_length_px for one in positions}
    if len(stated - {None}) > 1:
        raise UsageError(
            f"{photos}: the camera's focal length is not the same in all positions; photograph all "
            "with one lens and without zoom"
        )
    found = {one.name: find_lenses(decode(one), display, one.name) for one in positions}
    return found, stated.pop() if len(stated) == 1 else None


def _report_folder(out: Path) -> Path:
    return out.with_name(f"{out.stem}-calibration")


def _write(
    found: Calibration, args: argparse.Namespace, out: Path, preset: str
) -> CalibrationDocument:
    """Write the report's folder, then the display file."""
    import shlex

    from inim.calibrate.output import calibration_document, display_file, residual_maps
    from inim.documents.files import write_text
    from inim.pipeline.request import option_words
    from inim.report.calibration import FILES, write_calibration
    from inim.worker.output import published

    options = {
        "-o": out,
        "--display": args.display,
        "--intrinsics": args.intrinsics,
        "-D": args.definitions,
    }
    command = shlex.join(["inim", "calibrate", args.photos, *option_words(options)])
    title = f"Calibration: {Path(args.photos).resolve().name}"
    document = calibration_document(found, title, command)
    folder = _report_folder(out)
    with published(folder, FILES) as staging:
        write_calibration(document, residual_maps(found), staging)
    write_text(out, display_file(found, preset))
    return document


def _table(found: Calibration) -> list[str]:
    """The display's parameters, a line each."""
    lines = []
    for name, one in found.estimates.items():
        if name not in found.guess.display.given():
            continue
        value = f"{one.value:12.5f} ± {one.error:.2g}" if one.is_known else "not determined"
        lines.append(f"{name:18}{value}")
    return lines


COMMANDS = {
    "calibrate": Command(
        "a real display's parameters, from photographs of patterns", _add_arguments, _run
    )
}
