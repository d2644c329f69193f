"""`inim inspect`: what a display can do, before anything is rendered."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from inim.commands.options import Command, add_choices, add_debug, add_exit_codes
from inim.errors import EXIT_PASSED, FileError, UsageError, known_words

if TYPE_CHECKING:
    from inim.display import Display
    from inim.inspect.findings import Findings
    from inim.settings import Settings

_NAME = "inspect"


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    add_exit_codes(parser)
    parser.description = (
        "Say what a display can do, before anything is rendered: depth, viewing zone, voxel size, "
        "spots, crosstalk, and what its pixels per lens cost and give."
    )
    parser.add_argument("display", metavar="SCENE|PRESET", help="scene (.xml), nominal or phone")
    add_choices(parser, "definitions")
    parser.add_argument(
        "--distance",
        type=float,
        metavar="MM",
        help="viewing distance (the scene's, or twice the nearest usable one)",
    )
    parser.add_argument(
        "--lens-model", help="lens model: pinhole, thin or thick (thick, if it can be ground)"
    )
    parser.add_argument("-o", "--out", type=Path, help="folder for inspect.json, .svg and .png")
    parser.add_argument("--json", action="store_true", help="JSON instead of text")
    add_debug(parser)


def _run(args: argparse.Namespace) -> int:
    from inim.documents.document import encode
    from inim.inspect.output import as_text, inspect_document

    findings = _findings(args, *_choose(args.display, args.definitions))
    shown = encode(inspect_document(findings))
    files = [] if args.out is None else _write(findings, shown, args.out)
    print(shown if args.json else as_text(findings))
    if files and not args.json:
        print("\nwritten: " + ", ".join(str(args.out / name) for name in files))
    return EXIT_PASSED


def _choose(display: str, items: list[str]) -> tuple[Display, Settings]:
    """The display and the settings of a scene file or, for a preset, of the definitions alone."""
    from inim.display import DISPLAYS
    from inim.scene.file import choose_display, parse_definitions

    if display not in DISPLAYS and not (display.lower().endswith(".xml") or Path(display).exists()):
        raise UsageError(
            f"{display}: neither a scene file nor a preset; give a .xml file, or "
            f"{known_words(display, DISPLAYS)}; and change single values with -D inim.KEY=VALUE"
        )
    chosen = display if display in DISPLAYS else Path(display)
    return choose_display(chosen, parse_definitions(items), display)


def _findings(args: argparse.Namespace, design: Display, settings: Settings) -> Findings:
    from inim.display.misalignment import mounted
    from inim.display.viewpoint import default_distance_mm
    from inim.inspect.findings import DEFAULT_LENS_MODEL, inspect_display
    from inim.lens import lens_model as find_lens_model

    distance = settings.viewing_distance_mm if args.distance is None else args.distance
    if distance is not None and not (math.isfinite(distance) and distance > 0):
        raise UsageError(f"--distance {distance:g}: give a distance above 0, in millimetres")
    model = find_lens_model(settings.lens_model)
    stated = model.name if model.mesh is None else model.stand_in  # a mesh is for the renderer
    return inspect_display(
        design,
        default_distance_mm(design) if distance is None else distance,
        mounted=mounted(design, settings.misalign),
        lens_model=args.lens_model or (None if stated == DEFAULT_LENS_MODEL else stated),
        source=args.display,
    )


def _write(findings: Findings, shown: str, folder: Path) -> list[str]:
    """The figure first and the JSON last: where the JSON is, all is."""
    from inim.files.image import write_atomically
    from inim.inspect.figure import draw_figure

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(
            f"{folder}: cannot be made a folder ({error.strerror}); choose another with -o"
        ) from None
    path = folder / f"{_NAME}.json"
    drawn = draw_figure(findings, folder, _NAME)
    write_atomically(path, lambda p: p.write_text(shown + "\n", encoding="utf-8"))
    return [*drawn, path.name]


COMMANDS = {
    "inspect": Command(
        "say what a display can do, before anything is rendered", _add_arguments, _run
    )
}
