"""`inim calibrate` and `inim photo`: parameters of a real display, and photographs of it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from inim.commands import (
    Command,
    add_shared,
    choices_of,
    display_and_settings,
    finish,
    print_warning,
)
from inim.errors import FileError, UsageError, suggest_words

if TYPE_CHECKING:
    from inim.calibration.model import Intrinsics, Pose
    from inim.calibration.result import Calibration
    from inim.display import Display
    from inim.documents.display import CalibrationDocument, CameraPosition, PhotoDocument


_PATTERNS = "patterns"
# Coefficients of lens distortion that no camera has.
_MOST_DISTORTION = 10.0
_EPILOG = """first
  inim calibrate patterns --display phone -o DIR
  writes seven patterns and a page that shows them full screen. Photograph all seven from at least
  two positions, 15 to 25 degrees off the display's axis: from one side, and from above or below.
  Or film two rounds of them from each position. A lenticular display has ten patterns; photograph
  them from straight on, and from 10 to 15 degrees to the left and to the right.

then
  inim calibrate PHOTOS --display phone -o mydisplay.xml
  PHOTOS contains one folder of photographs, or one video, for each camera position. The names of
  the photographs must sort in the order of the patterns.

"""


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.epilog = f"{_EPILOG}{parser.epilog}"
    parser.description = (
        "Measure a display's pitch, rotation, shift, gap, tilt and focal length from photographs "
        "or videos of patterns on it. Write a display file for --display, and a report. Exit code "
        "1: the photographs do not determine all parameters, or contradict the model; in the "
        "second case no display file is written."
    )
    parser.add_argument(
        "photos",
        metavar="PHOTOS|patterns",
        help="folder with one subfolder of photographs, or one video, per camera position; or the "
        "word patterns, to write the patterns",
    )
    out = (
        "display file to write (default: PHOTOS.xml, or PHOTOS.json, a visual.json, of a "
        "lenticular display); for patterns, a folder"
    )
    add_shared(parser, "display", "definitions", "debug", out=out)
    parser.add_argument(
        "--intrinsics",
        metavar="FX,FY,CX,CY,K1,K2",
        help="camera parameters in pixels, as OpenCV defines them (default: fitted)",
    )
    parser.add_argument(
        "--steady",
        action="store_true",
        help="the camera stood on a firm support and nobody touched it: narrower intervals",
    )


def _run(args: argparse.Namespace) -> int:
    return _write_patterns(args) if args.photos == _PATTERNS else _calibrate(args)


def _write_patterns(args: argparse.Namespace) -> int:
    from inim.calibration.fit import check_display
    from inim.calibration.patterns import write_patterns

    display, _ = display_and_settings(args)
    check_display(display)
    for option, is_given in (
        ("--intrinsics", args.intrinsics is not None),
        ("--steady", args.steady),
    ):
        if is_given:
            raise UsageError(f"{option}: patterns have no camera; leave it out")
    page = write_patterns(display, args.out or Path(_PATTERNS))
    return finish(True, f"patterns: open {page} on the display")


def _calibrate(args: argparse.Namespace) -> int:
    from inim.calibration.run import calibrate, output_paths

    choices = choices_of(args)
    calibration = calibrate(
        args.photos,
        choices.get("display"),
        definitions=choices["definitions"],
        intrinsics=args.intrinsics,
        out=args.out,
        is_steady=args.steady,
        command=args.command_line,
        warn=print_warning,
    )
    print("\n".join(_parameter_lines(calibration)))
    file, folder = output_paths(args.photos, args.out, calibration.nominal)
    page = folder / "calibration.html"
    failures = calibration.failures
    result = f"calibrated: {file}, {page}"
    if failures:
        result = f"not calibrated, no {file} is written: {page}"
    return finish(not (failures or calibration.undetermined), result)


def _parameter_lines(calibration: Calibration) -> list[str]:
    """Lines with the display's parameters."""
    from inim.display.looking_glass import LookingGlass

    lines = []
    for name, estimate in calibration.estimates.items():
        if name not in calibration.guess.display.parameters():
            continue
        value = (
            f"{estimate.value:12.5f} ± {estimate.error:.2g}"
            if estimate.is_known
            else "not determined"
        )
        lines.append(f"{name:18}{value}")
    if calibration.view_error is not None:
        file = LookingGlass.of(calibration.display)
        lines += [
            f"{name:18}{value:12.5f}"
            for name, value in (
                ("pitch", file.pitch), ("slope", file.slope), ("center", file.center),
                ("viewCone", file.view_cone), ("views, lenses ±", calibration.view_error),
            )
        ]  # fmt: skip
    kinds = calibration.observations.kinds
    for name, smooth, changes in zip(
        calibration.names, calibration.smooth, abs(calibration.left_out).max(axis=1), strict=True
    ):
        sizes = [f"{k.scale * size:.3f} {k.unit}" for k, size in zip(kinds, smooth, strict=True)]
        line = f"fit of {name}: smooth residuals {', '.join(sizes)}"
        left_out = f"; without it {changes:.1f} standard errors" if changes else ""
        lines.append(line + left_out)
    return lines


def _add_photo_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Simulate a photograph of a display measured by `inim calibrate`, from one of the "
        "calibration's positions or from a new position with photographs of the patterns. Compare "
        "it with the real photograph: shift, blur, tone; SSIM, PSNR and FLIP."
    )
    parser.add_argument("photo", type=Path, metavar="PHOTO", help="JPEG or PNG, as photographed")
    parser.add_argument("--eia", type=Path, required=True, help="EIA on the panel, PNG or EXR")
    add_shared(parser, "display", "definitions", "debug", out="folder (PHOTO-photo)")
    position_options = parser.add_mutually_exclusive_group()
    position_options.add_argument(
        "--position", metavar="NAME", help="camera position of the calibration"
    )
    position_options.add_argument(
        "--patterns",
        type=Path,
        metavar="FOLDER",
        help="photographs or video of all patterns from another camera position",
    )


def _photo(args: argparse.Namespace) -> int:
    import numpy as np

    from inim.calibration.model import Intrinsics
    from inim.calibration.patterns import read_colors
    from inim.calibration.photo import compare, photo_document, simulate
    from inim.files.eia_file import read_eia
    from inim.report.calibration import PHOTO_FILES, write_photo
    from inim.worker.output import default_out, output_files

    if not (args.display or "").lower().endswith(".xml"):
        raise UsageError("--display: give the display file that inim calibrate wrote")
    display, _ = display_and_settings(args)
    calibration = _calibration(Path(args.display))
    fitted = calibration.camera
    camera = Intrinsics(*(getattr(fitted, field) for field in Intrinsics._fields))
    shape = fitted.height_px, fitted.width_px
    photograph = read_colors(args.photo)
    _check_shape(args.photo, photograph.shape[:2], shape)
    if args.patterns is None:
        pose, position = _calibrated_pose(calibration.positions, args.position)
    else:
        pose, position = _pose(args.patterns, display, camera, shape), args.patterns.resolve().name
    eia, _ = read_eia(args.eia, display)
    if not np.isfinite(eia).all() or eia.min() < 0:
        raise FileError(
            f"{args.eia}: has values that are negative or not finite; generate it again"
        )
    light, is_display = simulate(eia, display, camera, pose, shape)
    difference = compare(photograph, light, is_display, str(args.photo))
    document = photo_document(
        difference,
        display,
        camera.focal_px * display.pitch_mm / float(sum(x * x for x in pose.eye_mm) ** 0.5),
        title=f"Photograph: {args.photo.name}",
        command=args.command_line,
        photograph=str(args.photo),
        eia=str(args.eia),
        position=position,
    )
    out = args.out or default_out(args.photo, "photo")
    pictures = {
        "photograph": difference.photograph,
        "simulation": difference.stages[0].picture,
        "matched": difference.stages[-1].picture,
    }
    with output_files(out, PHOTO_FILES) as staging:
        write_photo(document, pictures, difference.flow, staging)
    return finish(True, "\n".join([*_lines(document), f"compared: {out / 'photo.html'}"]))


def _calibration(display: Path) -> CalibrationDocument:
    """The calibration that `inim calibrate` wrote next to a display file."""
    from inim.documents import read_document
    from inim.documents.display import CalibrationDocument

    path = display.with_name(f"{display.stem}-calibration") / "calibration.json"
    calibration = read_document(
        path, "keep the report of inim calibrate next to the display file", CalibrationDocument
    )
    _check_camera(path, calibration)
    return calibration


def _check_camera(path: Path, calibration: CalibrationDocument) -> None:
    """Raise `FileError` for a camera or a position that cannot exist."""
    import numpy as np

    camera = calibration.camera
    wrong = [
        f"{field} = {value:g}"
        for field, value, is_valid in (
            ("width_px", camera.width_px, camera.width_px > 0),
            ("height_px", camera.height_px, camera.height_px > 0),
            ("focal_px", camera.focal_px, camera.focal_px > 0),
            ("k1", camera.k1, abs(camera.k1) < _MOST_DISTORTION),
            ("k2", camera.k2, abs(camera.k2) < _MOST_DISTORTION),
        )
        if not is_valid
    ]
    for position in calibration.positions:
        turn = np.array(position.turn)
        if not position.zoom > -1:
            wrong.append(f"{position.name}: zoom = {position.zoom:g}")
        if not position.eye_mm[2] > 0:
            wrong.append(f"{position.name}: eye_mm is not in front of the display")
        if not (np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) and np.linalg.det(turn) > 0):
            wrong.append(f"{position.name}: turn is not a rotation")
    if wrong:
        raise FileError(f"{path}: {wrong[0]}; calibrate the display again")


def _check_shape(name: Path, shape: tuple[int, ...], expected: tuple[int, int]) -> None:
    if shape != expected:
        raise UsageError(
            f"{name}: {shape[1]} x {shape[0]} pixels, but the calibration's photographs have "
            f"{expected[1]} x {expected[0]}; use the same camera in the same orientation"
        )


def _calibrated_pose(positions: list[CameraPosition], name: str | None) -> tuple[Pose, str]:
    """Pose and name of a position of a calibration."""
    import numpy as np

    from inim.calibration.model import Pose

    places = {position.name: position for position in positions}
    if name is None and len(places) > 1:
        raise UsageError(
            f"--position: missing; use {' or '.join(places)}, or --patterns FOLDER with "
            "photographs from another position"
        )
    name = next(iter(places)) if name is None else name
    if name not in places:
        raise UsageError(f"--position {name}: {suggest_words(name, places)}")
    position = places[name]
    changes = (position.zoom, position.skew, position.stretch)
    return Pose(np.array(position.turn), np.array(position.eye_mm), *changes), name


def _pose(folder: Path, display: Display, camera: Intrinsics, shape: tuple[int, int]) -> Pose:
    """Pose of the camera that photographed the patterns."""
    from inim.calibration.decode import decode
    from inim.calibration.fit import fit_pose
    from inim.calibration.lattice import find_lenses
    from inim.calibration.patterns import read_position

    position = read_position(folder, display)
    _check_shape(folder, position.shape, shape)
    return fit_pose(
        find_lenses(decode(position), display, position.name), display, camera, position.name
    )


def _lines(document: PhotoDocument) -> list[str]:
    geometry = document.geometry
    gammas = ", ".join(f"{curve.gamma:.3f}" for curve in document.tone.values())
    return [
        f"geometry  {geometry.right_px:+.3f} px right, {geometry.down_px:+.3f} px down "
        f"(± {geometry.standard_error_px:.3f})",
        f"blur      {document.blur_sigma_px:.2f} px",
        f"tone      gamma {gammas}",
        *(
            f"SSIM {stage.scores['ssim']:.4f}, PSNR {stage.scores['psnr_db']:.2f} dB, "
            f"FLIP {stage.scores['flip']:.4f}: {stage.name}"
            for stage in document.stages
        ),
    ]


COMMANDS = {
    "calibrate": Command("measure a real display from photographs", _add_arguments, _run),
    "photo": Command(
        "compare a photograph of a display with a simulated one", _add_photo_arguments, _photo
    ),
}
