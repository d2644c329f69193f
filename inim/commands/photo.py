"""`inim photo`: a photograph of a calibrated display beside what it should look like."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inim.commands.options import (
    Command,
    add_choices,
    add_debug,
    add_exit_codes,
    choices_of,
    print_outcome,
)
from inim.errors import EXIT_PASSED, UsageError, known_words

if TYPE_CHECKING:
    from inim.calibrate.model import Camera, Pose
    from inim.display import Display
    from inim.documents.calibration import CalibrationDocument, CameraPosition, PhotoDocument


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    add_exit_codes(parser)
    parser.description = (
        "Simulate a photograph of a display that `inim calibrate` has measured, taken from one of "
        "the positions of that calibration or from where the patterns were photographed again, "
        "and tell how it differs from the real one: shift, blur, tone; SSIM, PSNR and FLIP."
    )
    parser.add_argument("photo", type=Path, metavar="PHOTO", help="JPEG or PNG, as photographed")
    parser.add_argument("--eia", type=Path, required=True, help="what the panel shows, PNG or EXR")
    add_choices(parser, "display", "definitions")
    stood = parser.add_mutually_exclusive_group()
    stood.add_argument(
        "--position", metavar="NAME", help="of the calibration, where the camera stood"
    )
    stood.add_argument(
        "--patterns",
        type=Path,
        metavar="FOLDER",
        help="photographs of all patterns from where the camera stood, if elsewhere",
    )
    parser.add_argument("-o", "--out", type=Path, help="folder (PHOTO-photo)")
    add_debug(parser)


def _run(args: argparse.Namespace) -> int:
    from inim.calibrate.model import Camera
    from inim.calibrate.photo import compare, photo_document, simulate
    from inim.calibrate.photographs import read_colors
    from inim.files.eia_file import read_eia
    from inim.scene.file import choose_display
    from inim.worker.output import default_out

    if not (args.display or "").lower().endswith(".xml"):
        raise UsageError("--display: name the display file that inim calibrate wrote")
    display, _ = choose_display(**choices_of(args), source="inim photo")
    calibration = _calibration(Path(args.display))
    fitted = calibration.camera
    camera = Camera(*(getattr(fitted, field) for field in Camera._fields))
    shape = fitted.height_px, fitted.width_px
    photograph = read_colors(args.photo)
    _check_shape(args.photo, photograph.shape[:2], shape)
    if args.patterns is None:
        pose, position = _calibrated_pose(calibration.positions, args.position)
    else:
        pose, position = _pose(args.patterns, display, camera, shape), args.patterns.resolve().name
    eia, _ = read_eia(args.eia, display)
    light, seen = simulate(eia, display, camera, pose, shape)
    found = compare(photograph, light, seen, str(args.photo))
    document = photo_document(
        found,
        display,
        camera.focal_px * display.pitch_mm / _distance_mm(pose),
        title=f"Photograph: {args.photo.name}",
        command=_command(args),
        photograph=str(args.photo),
        eia=str(args.eia),
        position=position,
    )
    out = args.out or default_out(args.photo, "photo")
    pictures = {
        "photograph": found.photograph,
        "simulation": found.stages[0].picture,
        "matched": found.stages[-1].picture,
    }
    _write(document, pictures, found.flow, out)
    print("\n".join(_lines(document)))
    print_outcome(f"compared: {out / 'photo.html'}")
    return EXIT_PASSED


def _calibration(display: Path) -> CalibrationDocument:
    """The calibration that `inim calibrate` wrote next to a display file."""
    from inim.documents import read_document
    from inim.documents.calibration import CalibrationDocument

    path = display.with_name(f"{display.stem}-calibration") / "calibration.json"
    return read_document(
        path, "keep the report that inim calibrate wrote beside it", CalibrationDocument
    )


def _check_shape(name: Path, shape: tuple[int, ...], wanted: tuple[int, int]) -> None:
    if shape != wanted:
        raise UsageError(
            f"{name}: {shape[1]} x {shape[0]} pixels, and those of the calibration have "
            f"{wanted[1]} x {wanted[0]}; photograph with the same camera, held the same way"
        )


def _calibrated_pose(positions: list[CameraPosition], name: str | None) -> tuple[Pose, str]:
    """Pose and name of a position of a calibration."""
    import numpy as np

    from inim.calibrate.model import Pose

    places = {position.name: position for position in positions}
    if name is None and len(places) > 1:
        raise UsageError(
            f"--position: the camera stood in one; use {' or '.join(places)}, or --patterns FOLDER "
            "of photographs from where it stood"
        )
    name = next(iter(places)) if name is None else name
    if name not in places:
        raise UsageError(f"--position {name}: {known_words(name, places)}")
    return Pose(np.array(places[name].turn), np.array(places[name].eye_mm)), name


def _pose(folder: Path, display: Display, camera: Camera, shape: tuple[int, int]) -> Pose:
    """Where a camera stood that photographed the patterns."""
    from inim.calibrate.decode import decode
    from inim.calibrate.fit import stand
    from inim.calibrate.lattice import find_lenses
    from inim.calibrate.photographs import read_position

    seen = read_position(folder, display)
    _check_shape(folder, seen.shape, shape)
    return stand(find_lenses(decode(seen), display, seen.name), display, camera, seen.name)


def _distance_mm(pose: Pose) -> float:
    return float(sum(x * x for x in pose.eye_mm) ** 0.5)


def _command(args: argparse.Namespace) -> str:
    import shlex

    from inim.pipeline.request import option_words

    options = {
        "--eia": args.eia,
        "--display": args.display,
        "--position": args.position,
        "--patterns": args.patterns,
        "-D": args.definitions,
        "-o": args.out,
    }
    return shlex.join(["inim", "photo", str(args.photo), *option_words(options)])


def _write(document: PhotoDocument, pictures: dict[str, Any], flow: Any, out: Path) -> None:
    from inim.report.calibration import PHOTO_FILES, write_photo
    from inim.worker.output import published

    with published(out, PHOTO_FILES) as staging:
        write_photo(document, pictures, flow, staging)


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
    "photo": Command(
        "a photograph of a calibrated display beside its simulation", _add_arguments, _run
    )
}
