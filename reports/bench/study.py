"""Functions shared by the benchmark studies: command line, conditions, test pictures, output.

A study is a script that answers a question of this project with the public functions of
`inim.apps.bench.run`. It runs in the repository's root, as ``python -m reports.bench.NAME.run``,
and writes the same files as ``inim bench``.
"""

from __future__ import annotations

import argparse
import shlex
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace

from inim import reconstruct
from inim.apps.bench.page import write_bench
from inim.apps.bench.run import load_average, record
from inim.display import Display, Viewpoint
from inim.display.lens import LensModelName, white_exposure
from inim.image.rgbd import RGBD
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import Request
from inim.pipeline.timing import Rounds
from inim.render.scene_files.file import parse_definitions
from inim.render.scene_files.two_spheres import two_spheres
from inim.report.study import PagePart
from inim.system.errors import EXIT_CHECK_FAILED, EXIT_PASSED, InimError, WorkerError
from inim.system.process.observer import Observer
from inim.system.worker.output import publish, staging_folder
from inim.system.worker.serve import ConsoleObserver
from reports.bench.process import run_measured

#: Measures, with an empty folder for temporary files, and returns `study` of bench.json.
Measure = Callable[[Rounds, Observer, Path], Mapping[str, Any]]


def new_parser(description: str | None, out: str) -> argparse.ArgumentParser:
    """Command line with the options of every study; `out` is the default output folder."""
    parser = argparse.ArgumentParser(description=(description or "").partition("\n")[0])
    parser.add_argument("-o", "--out", type=Path, default=Path(out), help=f"folder ({out})")
    parser.add_argument("--runs", type=int, default=Rounds.runs, metavar="N", help="timed runs (9)")
    parser.add_argument(
        "--warmups", type=int, default=Rounds.warmups, metavar="N", help="runs before (2)"
    )
    parser.add_argument("--threads", type=int, metavar="T", help="threads to time with (all)")
    parser.add_argument("--quiet", action="store_true", help="print errors only")
    return parser


def add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of studies of scenes."""
    parser.add_argument(
        "-D", dest="definitions", action="append", default=[], metavar="KEY=VALUE",
        help="override an inim.* setting or a scene parameter; may be repeated",
    )  # fmt: skip
    parser.add_argument("--display", help="display preset: nominal or phone")


def plan_of(args: argparse.Namespace, scene: Path) -> Plan:
    """Plan of the validation of a scene, with its display, viewpoints and sampling."""
    definitions = parse_definitions(args.definitions)
    request = Request(
        scene, args.out, definitions=definitions, display=args.display, algorithms=("template",)
    )
    return make_plan(request)


def run_validation(words: Sequence[str], variables: Mapping[str, str], name: str) -> dict[str, Any]:
    """Run a Python module that validates a scene; return the results of `run_measured`.

    Parameters
    ----------
    words : sequence of str
        The command line after ``python -m``.
    variables : mapping of str to str
        Environment variables.
    name : str
        Name of the run in error messages.

    Raises
    ------
    WorkerError
        The run is incomplete. A check may fail, on a small display.
    """
    run = run_measured([sys.executable, "-m", *words], variables)
    if run["code"] not in (EXIT_PASSED, EXIT_CHECK_FAILED):
        raise WorkerError(f"{name}: exit code {run['code']}: {run['message']}")
    return run


def run_study(
    args: argparse.Namespace,
    module: str,
    title: str,
    measure: Measure,
    parts_of: Callable[[Mapping[str, Any]], Sequence[PagePart]],
) -> int:
    """Measure, write the results, and return the exit code.

    Parameters
    ----------
    args : Namespace
        Parsed options of `new_parser`.
    module : str
        Module name of the study, for the recorded command.
    title : str
    measure : callable
    parts_of : callable
        Returns the parts of the page for the result of `measure`.
    """
    load = load_average()  # load by other processes, before this one loads libraries
    try:
        rounds = Rounds(args.runs, args.warmups, args.threads)
        with staging_folder(args.out, ("bench.json", "bench.html", "bench.md")) as staging:
            from inim.render import variant

            command = shlex.join(["python", "-m", module, *sys.argv[1:]])
            document = record(title, command, variant.use("llvm"), rounds, load)
            folder = staging / "work"
            folder.mkdir()
            with ConsoleObserver(args.quiet, lambda *_: None) as listener:
                study = dict(measure(rounds, listener, folder))
            shutil.rmtree(folder)
            final_load = replace(document.load, end=load_average())
            document = replace(document, study=study, load=final_load)
            write_bench(document, staging, lambda document: parts_of(document.study))
            publish(staging, args.out, "bench.json")
    except InimError as error:
        print(f"{module}: error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def square_display(lenses: int, pixels: int = 17, **changes: Any) -> Display:
    """Display of `lenses` by `lenses` of the paper's lenses, with `pixels` by `pixels` each."""
    display = Display(
        pitch_mm=1.0,
        focal_length_mm=3.0,
        gap_mm=3.3,
        pixel_pitch_mm=1.0 / pixels,
        lens_columns=lenses,
        lens_rows=lenses,
        name=f"{lenses} x {lenses} lenses",
    )
    return display.replace(**changes) if changes else display


def picture_of(display: Display, pixels_per_pitch: int) -> RGBD:
    """Display-ready picture of the two spheres with `pixels_per_pitch` pixels per lens pitch."""
    shape = display.capture_shape(pixels_per_pitch)
    return two_spheres(display, shape, display.pitch_mm / pixels_per_pitch)


def views_of(
    display: Display, viewpoints: Sequence[Viewpoint], lens_model: LensModelName = "thick"
) -> Callable[[np.ndarray], list[np.ndarray]]:
    """Function that reconstructs the views of an EIA, exposed so that panel white is white."""
    exposure = white_exposure(display, lens_model)

    def views(eia: np.ndarray) -> list[np.ndarray]:
        return [reconstruct(eia, display, eye, lens_model) * exposure for eye in viewpoints]

    return views
