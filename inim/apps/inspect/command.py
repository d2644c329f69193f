"""Command `inim inspect`, about a display."""

import argparse
from pathlib import Path

from inim.pipeline.options import Command, add_shared, print_lines
from inim.system.errors import EXIT_PASSED


def _add_inspect_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Compute the properties of a display without rendering: depth, viewing zone, voxel size, "
        "spot size, crosstalk, and the effect of more or fewer pixels per lens."
    )
    parser.add_argument(
        "display", metavar="FILE|PRESET", help="scene or display (.xml), visual.json, or preset"
    )
    lens_model = "lens model: pinhole, thin or thick (default: thick, if it can be manufactured)"
    out = "folder for inspect.json, .svg and .png (default: write none)"
    add_shared(parser, "definitions", "json", lens_model=lens_model, out=out)
    parser.add_argument(
        "--distance",
        type=float,
        metavar="MM",
        help="viewing distance (default: the scene's, or twice the nearest usable distance)",
    )
    parser.add_argument(
        "--save",
        type=Path,
        metavar="FILE",
        help="also write the display: .xml, or .json, the visual.json of a Looking Glass",
    )


def _inspect(args: argparse.Namespace) -> int:
    from inim.apps.inspect.findings import inspect
    from inim.system.document import encode
    from inim.system.process.atomic_file import published_together

    with published_together():
        inspection = inspect(
            args.display,
            definitions=args.definitions,
            lens_model=args.lens_model,
            distance_mm=args.distance,
            out=args.out,
        )
        if args.save is not None:
            inspection.document.display.save(args.save)
    print(encode(inspection.document) if args.json else inspection)
    if args.out is not None and not args.json:
        print()
        print_lines("written: " + ", ".join(str(args.out / name) for name in inspection.files))
    return EXIT_PASSED


COMMANDS = {
    "inspect": Command(
        "compute a display's depth, viewing zone and resolution",
        _add_inspect_arguments,
        _inspect,
        "inim inspect phone -D inim.gap_mm=3",
    ),
}
