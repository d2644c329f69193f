"""Commands `inim view` (the virtual display as an HTML file), `film` and `export`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from inim.commands import (
    Command,
    add_shared,
    check_report_arguments,
    choices_of,
    finish,
    new_scene_options,
    show_result,
)
from inim.errors import EXIT_PASSED, FileError, UsageError

if TYPE_CHECKING:
    import argparse


def _add_view_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Write the virtual display of a report, or of any elemental image array, as one "
        "self-contained HTML file."
    )
    out = "HTML file to write (OUT/virtual-display.html, EIA-view.html)"
    add_shared(parser, "source", "display", "definitions", "open", "serve", out=out)


def _view(args: argparse.Namespace) -> int:
    from inim.views.page import view_eia, view_report

    if args.source.is_dir():
        check_report_arguments(args)
        if args.serve:
            raise UsageError(f"--serve: {args.source} is a report; give an EIA, such as eia/*.png")
        path = view_report(args.source, args.out)
    else:
        path = view_eia(args.source, **choices_of(args), out=args.out)
    print(path, flush=True)
    show_result(path, args, args.source)
    return EXIT_PASSED


_FILM = "film.webp"
# Path of an eye in front of a turntable.
_STILL = "0 0, 0 0"


def _add_film_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Film a report's display with an eye that moves along a path, or the EIAs of a turntable "
        "with an eye at rest: an animated .gif or .webp, or an .mp4."
    )
    add = parser.add_argument
    add("folder", type=Path, metavar="OUT", help="folder of a report, or of a turntable")
    add_shared(
        parser,
        "lens_model",
        out=f"film to write: .gif, .webp or .mp4 (OUT/{_FILM})",
        algorithms="panes: algorithms, or reference (reference and the best algorithm); turntable: "
        "algorithms, or truth",
    )
    add(
        "--path",
        help="'circle' inside the viewing zone (default of a report), or eye positions "
        "'x y [z], x y [z], ...' in mm, visited in order and back",
    )
    add("--allow-flips", action="store_true", help="allow the path to leave the viewing zone")
    add(
        "--scene",
        type=Path,
        help="add a pane with the report's scene (.xml); with inim[perception], the other panes "
        "are scored against it as films, in JOD",
    )
    add("--frames", type=int, metavar="N", help="frames of a report (48)")
    rate = "frames per second (16, or the turntable's)"
    add("--rate", type=float, metavar="FPS", help=rate)
    add("--view-spp", type=int, default=32, metavar="N", help="samples per pixel (32)")
    add_shared(parser, "allow_folders", "quiet", "debug")


def _film(args: argparse.Namespace) -> int:
    from inim.display.misalignment import misaligned
    from inim.lens import lens_models
    from inim.report import Report
    from inim.views.film import REFERENCE, SCENE, FilmRequest
    from inim.views.frames import Source, TracedScene, render_in_worker
    from inim.views.turntable import JSON as TURNTABLE
    from inim.views.turntable import Turntable

    sources: dict[str, Source] = {}
    names = [name.strip() for name in args.algorithms.split(",")] if args.algorithms else []
    if (args.folder / TURNTABLE).is_file():
        turntable = Turntable.load(args.folder)
        if args.scene is not None or args.frames is not None:
            raise UsageError("--scene, --frames: are not for a turntable; leave them out")
        settings, design = turntable.data.settings, turntable.data.display.parameters
        misalign, model = settings.misalign, settings.lens_model
        frames, rate, path = len(turntable.data.frames), turntable.data.frames_per_second, _STILL
        for name in names or turntable.names[:2]:
            sources[name] = turntable.eia_paths(name, "--algorithms")
    else:
        report = Report.load(args.folder)
        settings, design, best = report.data.settings, report.display, report.data.best_algorithm
        misalign, model = report.data.misalign, report.data.lens_model
        frames, rate, path = 48 if args.frames is None else args.frames, 16.0, "circle"
        if args.scene is not None:
            sources[SCENE] = TracedScene.of(report, args.scene, args.allow_folders)
        for name in names or [REFERENCE, *([best] if best else [])]:
            sources[name] = report.eia_path(name, "--algorithms", true=REFERENCE)
    if not args.lens_model and model not in lens_models():
        raise FileError(
            f"{args.folder}: its report's lens model {model[:40]!r} is not known here; give "
            "--lens-model"
        )
    request = FilmRequest(
        out=args.out or args.folder / _FILM,
        sources=sources,
        label=args.folder,
        design=design,
        misaligned_display=misaligned(design, misalign),
        lens_model=args.lens_model or model,
        spp=args.view_spp,
        path=args.path or path,
        frames=frames,
        frames_per_second=rate if args.rate is None else args.rate,
        pixels_per_lens=settings.view_pixels_per_lens,
        luminance_cd_m2=settings.luminance_cd_m2,
        allow_flips=args.allow_flips,
    )
    render_in_worker(request, quiet=args.quiet, debug=args.debug)
    if not args.quiet:
        print(request.out)
    return EXIT_PASSED


_EXPORT_OPTIONS = (
    *("pdf", "views", "hci", "quilt", "grid", "tiles", "view_size", "aspect", "view_spp"),
    *("native", "scene", "allow_folders", "quiet", "debug"),
)


def _add_export_arguments(parser: argparse.ArgumentParser) -> None:
    from inim.views.export import SPP, TILES

    parser.description = (
        "Write an EIA as a PDF to print, its sub-aperture views (one pixel per lens) as images or "
        "as an HCI light field, or a quilt of views rendered through the lens array; or the native "
        "picture of a Looking Glass from a quilt; or the EIAs of a relic on a turntable."
    )
    add = parser.add_argument
    algorithms = (
        "report: algorithm, or truth for the ground-truth EIA (the best algorithm); turntable: "
        "algorithms next to the ground truth (layered,template)"
    )
    source = "a report's folder, or an EIA (.png, .exr); turntable: a scene (.xml) or a mesh"
    add_shared(parser, "display", "definitions", source=source, algorithms=algorithms)
    add(
        "--turntable",
        type=int,
        metavar="N",
        help="write the EIAs of a relic at N angles of a whole turn, as PNG files and as videos "
        "for the panel; when repeated after an interruption, the command continues",
    )
    add_shared(parser, "up", "front", out="folder for --turntable (default: SOURCE-turntable)")
    add("--rate", type=float, metavar="FPS", help="frames of the videos per second (24)")
    add("--pdf", type=Path, metavar="FILE", help="write a PDF that prints at true size")
    add(
        "--views",
        type=Path,
        metavar="DIR",
        help="write sub-aperture views, view_ROW_COLUMN.png, into this folder",
    )
    add(
        "--hci",
        type=Path,
        metavar="DIR",
        help="write an HCI light field into this folder; with the true disparity for a report",
    )
    add(
        "--grid",
        metavar="COLSxROWS",
        help="number of sub-aperture views (default: the pixels per lens)",
    )
    add(
        "--quilt",
        type=Path,
        metavar="FILE",
        help="write a quilt, .png; _qsCOLSxROWSaASPECT is added to its name",
    )
    add(
        "--native",
        type=Path,
        metavar="FILE",
        help="write the native picture of a lenticular display, .png; the source is a quilt of any "
        "program (.png, .jpg)",
    )
    add("--tiles", metavar="COLSxROWS", help=f"tiles of the quilt ({TILES})")
    add("--view-size", metavar="WxH", help="size of a tile in pixels (8x6: 420x560)")
    add(
        "--aspect",
        type=float,
        help="displayed width over height of a tile (default: square pixels)",
    )
    add("--view-spp", type=int, metavar="N", help=f"samples per pixel of a tile ({SPP})")
    add(
        "--scene",
        type=Path,
        metavar="XML",
        help="scene file for a quilt of the ground truth (default: the report's scene)",
    )
    add_shared(parser, "allow_folders", "quiet", "debug")


def _export(args: argparse.Namespace) -> int:
    from inim.views.export import export

    if args.turntable is not None:
        return _export_turntable(args)
    for option in ("out", "rate", "up", "front"):
        if getattr(args, option) is not None:
            raise UsageError(f"--{option}: is for --turntable; add that")
    notes: list[str] = []
    options = {name: getattr(args, name) for name in _EXPORT_OPTIONS}
    choices = choices_of(args)
    choices.pop("algorithms", None)
    files = export(args.source, algorithm=args.algorithms, **choices, **options, say=notes.append)
    if not args.quiet:
        print("\n".join([*map(str, files), *notes]))
    return EXIT_PASSED


def _export_turntable(args: argparse.Namespace) -> int:
    from inim.files.triangle_mesh import MESH_SUFFIXES
    from inim.views.turntable import export_turntable
    from inim.worker.output import default_out

    shared = ("allow_folders", "quiet", "debug")
    for name in _EXPORT_OPTIONS:
        if name not in shared and getattr(args, name) is not None:
            raise UsageError(f"--{name.replace('_', '-')}: is not for --turntable; leave it out")
    is_mesh = args.source.suffix.lower() in MESH_SUFFIXES
    out = args.out or default_out(args.source, "turntable")
    passed = export_turntable(
        args.source,
        out,
        args.turntable,
        *([] if args.rate is None else [args.rate]),
        new_scene=new_scene_options(args, args.source, is_mesh=is_mesh),
        allow_folders=tuple(args.allow_folders),
        command=args.command_line,
        quiet=args.quiet,
        debug=args.debug,
        **choices_of(args),
    )
    return finish(passed, f"{'written' if passed else 'FAILED'}: {out}", quiet=args.quiet)


COMMANDS = {
    "view": Command("view a report's EIAs, or any EIA, in a browser", _add_view_arguments, _view),
    "film": Command(
        "make a film of a report's display, seen by a moving eye", _add_film_arguments, _film
    ),
    "export": Command(
        "write an EIA as PDF, views, light field or quilt", _add_export_arguments, _export
    ),
}
