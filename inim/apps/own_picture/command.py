"""`inim generate`: EIAs from the user's own colour and depth pictures."""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

from inim.apps.own_picture.options import add_picture
from inim.pipeline.options import (
    Command,
    add_shared,
    choices_of,
    default_out,
    finish,
    open_page,
    print_lines,
    print_warning,
)
from inim.system.errors import EXIT_PASSED, FileError, OutOfMemoryError, UsageError, naming

if TYPE_CHECKING:
    import numpy as np

    from inim.apps.own_picture.inputs import Input

_EPILOG = """depth
  With a unit, depth is missing where the value is 0, negative or not finite.
  Without one (--depth-unit none), it is missing where the value is not finite or
  is listed by --missing, and --near-is-large or --far-is-large is required.
  Distances that no depth camera has are refused, unless --near and --far confirm
  them.

photographs that contain depth
  Give only the file. It is treated as taken with parallel rays; with --intrinsics
  photo, it is unprojected with the camera parameters in the file.
"""


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Generate an elemental image array (EIA) from a colour picture with depth, a photograph "
        "that contains depth, an RGB-D picture of inim, pictures of several cameras, a light "
        "field, a mesh, Gaussian splats, or a scene."
    )
    parser.epilog = f"{_EPILOG}\n{parser.epilog}"
    add = parser.add_argument
    add(
        "input",
        type=Path,
        metavar="INPUT",
        help="a colour picture with --depth; a photograph that contains depth (HEIC, or JPEG from "
        "Android or Apple), or a folder of these; an RGB-D picture of inim (.exr); a .json that "
        "lists the pictures of several cameras; the folder of an HCI 4D light field; a mesh or "
        "Gaussian splats (see inim new-scene), lit and fitted to the display; or a scene (.xml); "
        "both are rendered with -D inim.capture_spp=N samples per pixel",
    )
    out = "EIA to write, .png or .exr (default: INPUT-eia.png); a folder if INPUT is one"
    algorithms = (
        "one algorithm with options, such as template:samples=1; see `inim info algorithms` "
        "(default: template; for several cameras: cameras)"
    )
    shared = ("display", "definitions", "open")
    add_shared(parser, *shared, out=out, algorithms=algorithms)
    add(
        "--fill",
        help="holes to fill: none, hidden (behind a nearer surface), all, or auto (default: the "
        "algorithm's own)",
    )
    add("--pdf", type=Path, metavar="FILE", help="also write a PDF that prints at true size")
    add(
        "--save-rgbd",
        type=Path,
        metavar="FILE",
        help="also write the fitted colour and depth as .exr",
    )
    add_picture(parser)
    add(
        "--all-views",
        action="store_true",
        help="light field: use all views instead of the centre view",
    )
    add_shared(parser, "up", "front")


def _run(args: argparse.Namespace) -> int:
    from inim.apps.own_picture.inputs import check_choices, check_options, kind_of

    args.kind = kind_of(args)
    check_options(args)
    if args.kind == "folder":
        check_choices(args)
        return _generate_folder(args)
    args.out = args.out or default_out(args.input, "eia.png")
    _generate(args)
    if args.open:
        from inim.report.view_page import view_eia

        page = args.out.with_name(f"{args.out.stem}-view.html")
        view_eia(args.out, page, args.display, choices_of(args)["definitions"])
        open_page(page)
    return EXIT_PASSED


def _generate_folder(args: argparse.Namespace) -> int:
    """Generate an EIA from each photograph of a folder, and list the failures."""
    from inim.apps.own_picture.depth_photo import SUFFIXES
    from inim.image.files.eia_file import EIA_SUFFIXES

    folder, out = args.input, args.out or default_out(args.input, "eia")
    if out.suffix.lower() in EIA_SUFFIXES or out.is_file():
        raise UsageError(f"-o {out}: {folder} is a folder; name a folder for its EIAs")
    photos = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    if not photos:
        raise FileError(
            f"{folder}: no photograph in it; give a folder with some ({', '.join(SUFFIXES)})"
        )
    stems = [path.stem for path in photos]
    failed = 0
    for path in photos:
        name = path.stem if stems.count(path.stem) == 1 else path.name
        print_lines(path)
        single = {"input": path, "kind": "photo", "out": out / f"{name}.png"}
        try:
            _generate(argparse.Namespace(**vars(args) | single))
        except (FileError, UsageError, OutOfMemoryError) as error:
            failed += 1
            print_warning(str(error), "failed")
    converted = f"{len(photos) - failed} of {len(photos)} photographs converted"
    return finish(not failed, f"{converted}; EIAs: {out}")


def _generate(args: argparse.Namespace) -> None:
    """Generate the EIA of an input, write the requested files and print the lines of output."""
    from inim.apps.own_picture.inputs import read_input

    started = time.perf_counter()
    _check_outputs(args)
    try:
        source = read_input(args)
        eia, holes = source.generated or _generate_eia(args, source)
        _write_outputs(args, source, eia, holes)
    except MemoryError as error:
        raise OutOfMemoryError(
            f"{args.input}: not enough memory for a picture of this size; scale it down"
        ) from error
    for warning in source.warnings:
        print_warning(warning)
    display, share = source.display, "unknown"
    if holes is not None:
        lensed = display.lensed
        count = (holes & lensed).sum() / max(1, lensed.sum())
        share = f"{count:.1%} of the pixels of the EIA"
    (rows, columns), pixel = display.eia_shape, display.pixel_pitch_mm
    paths = [path for path in (args.out, args.pdf, args.save_rgbd) if path is not None]
    print_lines(
        f"display    {display.name}: {display.layout.lens_counts()} lenses of "
        f"{display.pitch_mm:g} mm",
        *source.lines,
        f"holes      {share}" + (f", fill: {args.fill}" if args.fill else ""),
        f"size       {columns} x {rows} pixels of {pixel:.6g} mm: {columns * pixel:.6g} x "
        f"{rows * pixel:.6g} mm",
        f"written    {', '.join(map(str, paths))}",
        f"seconds    {time.perf_counter() - started:.1f}",
    )


def _check_outputs(args: argparse.Namespace) -> None:
    """Reject files to write that have another suffix, or are folders, inputs or given twice."""
    from inim.image.files.eia_file import EIA_SUFFIXES

    suffixes = (("-o", args.out, EIA_SUFFIXES), ("--pdf", args.pdf, (".pdf",)))
    outputs: dict[str, str] = {}
    for option, path, allowed in (*suffixes, ("--save-rgbd", args.save_rgbd, (".exr",))):
        if path is None:
            continue
        if path.suffix.lower() not in allowed:
            raise UsageError(
                f"{option} {path}: name a {' or '.join(allowed)} file; only a folder of "
                "photographs gives a folder"
            )
        if path.is_dir():
            raise FileError(f"{path}: is a folder; name a file with {option}")
        place = os.path.realpath(path)
        inputs = [os.path.realpath(p) for p in (args.input, args.depth) if p]
        if place in inputs or place in outputs:
            raise UsageError(
                f"{option} {path}: is also {outputs.get(place, 'an input file')}; choose another "
                "name"
            )
        outputs[place] = option


def _generate_eia(args: argparse.Namespace, source: Input) -> tuple[np.ndarray, np.ndarray | None]:
    """Linear RGB EIA of a picture; its holes, if files show them and the algorithm reports them."""
    from inim.apps.own_picture.inputs import algorithm_of
    from inim.image.files.eia_file import shows_holes
    from inim.pipeline.stages.generation import GeneratorHandle

    display, rgbd = source.display, source.rgbd
    assert rgbd is not None
    generator = GeneratorHandle(algorithm_of(args), display, rgbd.shape, rgbd.pixel_mm)
    with naming(args.input):
        run = generator.run(rgbd, holes=shows_holes(display))
    return run.eia, run.holes


def _write_outputs(
    args: argparse.Namespace, source: Input, eia: np.ndarray, holes: np.ndarray | None
) -> None:
    """Write the files of -o, --pdf and --save-rgbd together."""
    from inim.image.files.eia_file import write_eia, write_true_size_pdf
    from inim.image.files.image import write_rgbd
    from inim.system.process.atomic_file import published_together

    pixel_mm = source.display.pixel_pitch_mm
    with published_together():
        write_eia(args.out, eia, holes, pixel_mm)
        if args.pdf is not None:
            write_true_size_pdf(args.pdf, eia, pixel_mm)
        if args.save_rgbd is not None and source.rgbd is not None:
            write_rgbd(args.save_rgbd, source.rgbd)


COMMANDS = {
    "generate": Command(
        "generate EIAs from your own pictures",
        _add_arguments,
        _run,
        "inim generate color.png --depth depth.png --depth-unit mm --orthographic",
    ),
}
