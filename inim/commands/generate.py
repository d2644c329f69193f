"""`inim generate`: the user's own colour and depth picture becomes an elemental image array."""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from inim.commands.display_choice import add_display_arguments, chosen_display
from inim.errors import EXIT_PASSED, FileError, OutOfMemoryError, UsageError

if TYPE_CHECKING:
    import numpy as np

    from inim.display import Display
    from inim.from_camera.camera import Pinhole
    from inim.from_camera.depth_map import DepthMap
    from inim.from_camera.depth_values import DepthValues
    from inim.from_camera.fit import Fitted
    from inim.rgbd import RGBD
    from inim.settings import Settings

__all__ = [
    "add_arguments",
    "add_picture_arguments",
    "fitted_picture",
    "generate_picture",
    "generated",
    "run",
    "write_outputs",
]

_DEFAULT_ALGORITHM = "template"
_EPILOG = """depth
  Distances (--depth-unit mm, cm, m, or 5000 for 5000 units per metre): 0, negative and not finite
  values are missing. Numbers without a unit (--depth-unit none): only what is not finite, and
  --missing. Both grow away from the camera, unless --near-is-large.

perspective
  --intrinsics unprojects every sample to its place in space; the array then shows that space, and
  at the distance --frame-at the camera's picture fits it. --orthographic takes the picture as is.
  Linear depth keeps an unprojected scene straight, reciprocal depth an orthographic one.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `inim generate`."""
    parser.description = "Make an elemental image array of a camera's colour and depth picture."
    parser.epilog = _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    add_picture_arguments(parser)
    add_display_arguments(parser)
    add = parser.add_argument
    add("--hci", type=Path, metavar="DIR", help="instead of both: an HCI 4D light field")
    add("--true-views", action="store_true", help="with --hci: of all views, not of the centre one")
    add("--algorithm", default=_DEFAULT_ALGORITHM, help="see `inim algorithms`; template:samples=4")
    add("-o", "--out", type=Path, default=Path("eia.png"), help="EIA, .png or .exr (eia.png)")
    add("--pdf", type=Path, help="also a PDF that prints at true size")
    add("--rgbd", type=Path, help="also the fitted colour and depth, .exr")
    add("--debug", action="store_true", help="show tracebacks of internal errors")


def add_picture_arguments(parser: argparse.ArgumentParser | argparse._ArgumentGroup) -> None:
    """The two pictures, and what they mean: `fitted_picture` reads them."""
    add = parser.add_argument
    add("--color", type=Path, metavar="FILE", help="PNG, JPEG, ... (sRGB) or EXR (linear)")
    add("--depth", type=Path, metavar="FILE", help=".png, .pgm, .tif, .exr, .pfm or .npy")
    add("--depth-unit", metavar="UNIT", help="mm, cm, m, units per metre (5000), or none")
    add("--intrinsics", metavar="FX,FY,CX,CY", help="of the camera, pixels of the colour picture")
    add("--orthographic", action="store_true", help="take the picture as orthographic")
    add("--depth-map", default="linear", help="linear, or reciprocal (Li 2012)")
    direction = parser.add_mutually_exclusive_group()
    direction.add_argument("--near-is-large", action="store_true", help="white is near")
    direction.add_argument("--far-is-large", action="store_true", help="as distances are")
    add("--near", type=float, metavar="D", help="nearest depth mapped: mm, or without a unit plain")
    add("--far", type=float, metavar="D", help="farthest (defaults: the 0.5 and 99.5 %% quantiles)")
    add("--outside", default="clip", help="what lies beyond: clip takes it to the end, drop omits")
    add("--missing", default="", metavar="N,...", help="numbers of the file that mean no depth")
    add("--fill", default="none", help="missing depth: none, nearest, behind or far")
    add("--fit", default="contain", help="contain: all of the picture; cover: all of the array")
    add("--frame-at", type=float, metavar="D", help="distance at which it fits (the median)")
    add("--steepest", type=float, default=10.0, help="slope up to which samples are one surface")
    add("--swap-bytes", action="store_true", help="16-bit depth in the other byte order")


def run(args: argparse.Namespace) -> int:
    """Carry out `inim generate`; the exit code."""
    try:
        report, warnings = generate_picture(args)
    except MemoryError as error:
        raise OutOfMemoryError(
            f"{args.color or args.hci}: not enough memory for a picture of this size; scale it down"
        ) from error
    for warning in warnings:
        line = "".join(c if c.isprintable() else " " for c in warning)
        print(f"inim: warning: {line}", file=sys.stderr)
    print("\n".join(report))
    return EXIT_PASSED


@dataclass(frozen=True)
class _Camera:
    """Colour and depth as taken, on one grid."""

    color: np.ndarray
    values: DepthValues
    coarseness: float
    depth_size: tuple[int, int]
    missing: float
    warnings: tuple[str, ...]


def generate_picture(args: argparse.Namespace) -> tuple[list[str], list[str]]:
    """Make and write what the arguments ask for.

    Returns
    -------
    report, warnings : list of str
        Lines.
    """
    started = time.perf_counter()
    _check(args)
    display, settings = chosen_display(args.display, args.definitions, "inim generate")
    if args.hci is not None:
        from inim.commands.light_field import generate_light_field

        return generate_light_field(args, display, settings)
    intrinsics = _intrinsics(args)
    from inim.generators import check_algorithm

    check_algorithm(args.algorithm)
    taken = _read(args)
    fitted, depth_map = _fit(args, taken, intrinsics, display, settings)
    eia, empty = generated(args.algorithm, fitted.rgbd, display)
    report = _report(args, taken, intrinsics, fitted, depth_map, display, empty)
    written = write_outputs(args, fitted.rgbd, eia, empty, display)
    report.append(f"written    {', '.join(map(str, written))}")
    report.append(f"seconds    {time.perf_counter() - started:.1f}")
    return report, list(taken.warnings)


def fitted_picture(
    args: argparse.Namespace, display: Display, settings: Settings
) -> tuple[RGBD, tuple[str, ...]]:
    """The picture that `add_picture_arguments` describe, fitted to a display; and warnings."""
    _check_files(args)
    _check_choices(args)
    intrinsics = _intrinsics(args)
    taken = _read(args)
    return _fit(args, taken, intrinsics, display, settings)[0].rgbd, taken.warnings


def _check(args: argparse.Namespace) -> None:
    """What can be told from the arguments alone."""
    from inim.files.true_size import EIA_SUFFIXES

    if args.hci is not None:
        for name in ("color", "depth", "depth_unit", "intrinsics", "near", "far", "frame_at"):
            if getattr(args, name) is not None:
                option = f"--{name.replace('_', '-')}"
                raise UsageError(f"{option}: the light field of --hci has its own; leave it out")
    elif args.true_views:
        raise UsageError("--true-views: are those of a light field; name it with --hci DIR")
    else:
        _check_files(args)
    _check_choices(args)
    suffixes = (("-o", args.out, EIA_SUFFIXES), ("--pdf", args.pdf, (".pdf",)))
    outputs: dict[Path, str] = {}
    for option, path, allowed in (*suffixes, ("--rgbd", args.rgbd, (".exr",))):
        if path is None:
            continue
        if path.suffix.lower() not in allowed:
            raise UsageError(f"{option} {path}: name a {' or '.join(allowed)} file")
        if path.is_dir():
            raise FileError(f"{path}: is a folder; name a file with {option}")
        place = path.resolve()
        inputs = [p.resolve() for p in (args.color, args.depth) if p is not None]
        if place in inputs or place in outputs:
            raise UsageError(
                f"{option} {path}: is also {outputs.get(place, 'what is read')}; give it another "
                "name"
            )
        outputs[place] = option


def _check_files(args: argparse.Namespace) -> None:
    for name in ("color", "depth"):
        if getattr(args, name) is None:
            raise UsageError(f"--{name}: missing; give --color FILE and --depth FILE")
    if bool(args.intrinsics) == args.orthographic:
        raise UsageError(
            "give either --intrinsics fx,fy,cx,cy (a camera's picture, unprojected) or "
            "--orthographic (taken as it is)"
        )


def _check_choices(args: argparse.Namespace) -> None:
    import math

    from inim.from_camera.depth_map import DEPTH_MAPS
    from inim.from_camera.fit import FITS
    from inim.from_camera.missing import FILL_RULES

    words = {
        "--depth-map": (args.depth_map, DEPTH_MAPS),
        "--fill": (args.fill, FILL_RULES),
        "--fit": (args.fit, FITS),
        "--outside": (args.outside, ("clip", "drop")),
    }
    for option, (word, known) in words.items():
        if word not in known:
            raise UsageError(f"{option} {word}: use {', '.join(known[:-1])} or {known[-1]}")
    if not (math.isfinite(args.steepest) and args.steepest > 0):
        raise UsageError(f"--steepest {args.steepest:g}: a slope above 0; 10 is 84 degrees")
    if args.frame_at is not None and args.orthographic:
        raise UsageError("--frame-at: an orthographic picture is as large at every distance")


def _intrinsics(args: argparse.Namespace) -> Pinhole | None:
    from inim.from_camera.camera import parse_intrinsics

    return None if args.orthographic else parse_intrinsics(args.intrinsics)


def _read(args: argparse.Namespace) -> _Camera:
    from dataclasses import replace

    import numpy as np

    from inim.from_camera.color_file import read_color
    from inim.from_camera.depth_file import read_depth
    from inim.from_camera.depth_values import Meaning, parse_unit, read_meaning
    from inim.from_camera.missing import fill_missing
    from inim.from_camera.registration import check_same_view, edge_shift, resampled

    said = Meaning(
        None if args.depth_unit is None else parse_unit(args.depth_unit),
        True if args.near_is_large else False if args.far_is_large else None,
        _numbers(args.missing),
        args.near is not None and args.far is not None,
    )
    color = read_color(args.color)
    file = read_depth(args.depth, swap_bytes=args.swap_bytes)
    rows, columns = color.shape[:2]
    size = file.values.shape
    check_same_view((rows, columns), (size[0], size[1]), str(args.depth))
    values = read_meaning(file, said, str(args.depth))
    warnings = [*values.warnings]
    missing = float(np.isnan(values.depth).mean())
    filled = fill_missing(values.depth, args.fill, near_is_large=values.near_is_large)
    values = replace(values, depth=resampled(filled, (rows, columns)))
    if size != (rows, columns):
        warnings.append(
            f"{args.depth}: {size[1]} x {size[0]} pixels, colour {columns} x {rows}: depth was "
            "brought to the colour's size by nearest pixel"
        )
    shift = edge_shift(color, values.depth)
    if shift.found:
        warnings.append(
            f"{args.depth}: its edges match those of {args.color} better {shift.right:+.0f} pixels "
            f"to the right and {shift.down:+.0f} down: the two may be misaligned; register depth "
            "to colour first"
        )
    return _Camera(
        color, values, max(1.0, columns / size[1]), (size[1], size[0]), missing, tuple(warnings)
    )


def _numbers(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(",") if part.strip())
    except ValueError:
        raise UsageError(f"--missing {text}: write numbers, separated by commas") from None


def _fit(
    args: argparse.Namespace,
    taken: _Camera,
    intrinsics: Pinhole | None,
    display: Display,
    settings: Settings,
) -> tuple[Fitted, DepthMap]:
    from inim.from_camera.camera import check_pinhole
    from inim.from_camera.depth_map import depth_range, map_depth
    from inim.from_camera.fit import fit_picture

    if intrinsics is not None:
        rows, columns = taken.color.shape[:2]
        check_pinhole(intrinsics, (rows, columns))
    ends = depth_range(taken.values, args.near, args.far)
    depth_map = map_depth(args.depth_map, taken.values, ends, display)
    fitted = fit_picture(
        taken.color,
        taken.values,
        depth_map,
        display,
        camera=intrinsics,
        pixels_per_pitch=settings.capture_pixels_per_pitch,
        fit=args.fit,
        frame_at=args.frame_at,
        steepest=args.steepest,
        coarseness=taken.coarseness,
        drop=args.outside == "drop",
    )
    return fitted, depth_map


def generated(algorithm: str, rgbd: RGBD, display: Display) -> tuple[np.ndarray, np.ndarray | None]:
    """A picture's EIA, linear RGB, and where it shows nothing, if the algorithm says."""
    from inim.generators import prepare
    from inim.pipeline.plugin_guard import blamed, run_generator

    with blamed(algorithm, "prepare"):
        generator = prepare(display, algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm)
    eia, _, empty = run_generator(algorithm, generator, rgbd, display)
    return eia, empty


def write_outputs(
    args: argparse.Namespace,
    rgbd: RGBD | None,
    eia: np.ndarray,
    empty: np.ndarray | None,
    display: Display,
) -> list[Path]:
    """Write what -o, --pdf and --rgbd ask for; what was written."""
    from inim.files.image import write_rgbd
    from inim.files.true_size import write_eia, write_true_size_pdf

    write_eia(args.out, eia, empty, display.pixel_pitch_mm)
    if args.pdf is not None:
        write_true_size_pdf(args.pdf, eia, display.pixel_pitch_mm)
    if args.rgbd is not None and rgbd is not None:
        write_rgbd(args.rgbd, rgbd)
    return [path for path in (args.out, args.pdf, args.rgbd) if path is not None]


def _report(
    args: argparse.Namespace,
    taken: _Camera,
    intrinsics: Pinhole | None,
    fitted: Fitted,
    depth_map: DepthMap,
    display: Display,
    empty: np.ndarray | None,
) -> list[str]:
    import numpy as np

    rows, columns = taken.color.shape[:2]
    unit = " mm" if taken.values.has_unit else ""
    pixel, panel = display.pixel_pitch_mm, display.eia_shape
    if intrinsics is None:
        projection = "orthographic"
    else:
        angle = 2 * np.degrees(np.arctan(columns / (2 * intrinsics.fx)))
        projection = f"unprojected ({angle:.3g} degrees wide), frame at {fitted.frame_at:.4g}{unit}"
    holes = "not told by this algorithm"
    if empty is not None:
        holes = f"{(empty & display.lensed).sum() / max(1, display.lensed.sum()):.1%} of the pixels"
    return [
        f"display    {display.name}: {display.lens_columns} x {display.lens_rows} lenses of "
        f"{display.pitch_mm:g} mm",
        f"picture    colour {columns} x {rows}, depth {taken.depth_size[0]} x "
        f"{taken.depth_size[1]}, {projection}",
        f"depth      {depth_map.near:.5g} (near) .. {depth_map.far:.5g} (far){unit}, "
        f"{depth_map.name}, onto {float(depth_map.z_mm(np.array(depth_map.near))):.4g} .. "
        f"{float(depth_map.z_mm(np.array(depth_map.far))):.4g} mm",
        f"missing    {taken.missing:.1%} of the depth picture, fill: {args.fill}",
        f"clipped    {fitted.clipped:.1%} of the samples lay beyond, "
        f"{'left out' if args.outside == 'drop' else 'taken to the ends'}",
        f"empty      {fitted.empty:.1%} of the array's area",
        f"holes      {holes} of the EIA",
        f"size       {panel[1]} x {panel[0]} pixels of {pixel:.6g} mm: {panel[1] * pixel:.6g} x "
        f"{panel[0] * pixel:.6g} mm",
    ]
