"""Time of whole commands with an empty result cache and with cached results.

    python -m reports.bench.commands.run scenes/amphora.xml --runs 3 -o reports/bench/commands

The study takes several minutes. Every case is a separate process, timed from start to end, with a
defined content of its result cache. Each round runs all cases in turn. The first round is not
counted: it compiles the kernels that numba and Dr.Jit store on disk.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from inim.display.lens import check_lens_model
from inim.display.viewpoint import Viewpoint, parse_viewpoints
from inim.pipeline.options import add_shared
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import Request, definition_words, option_words
from inim.pipeline.stages.reconstruction import DisplayViews
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.stages.stage import Run
from inim.pipeline.timing import Rounds, Timing
from inim.render.scene_files.file import parse_definitions
from inim.system.cache import FOLDER_VARIABLE
from inim.system.errors import DisplayError
from inim.system.process.observer import Observer
from reports.bench.commands.page import page
from reports.bench.commands.same_scores import EVERYTHING, SCORES, VIEWS, differences, samples_of
from reports.bench.study import add_rounds, doubts, rounds_of, run_parts, run_validation
from reports.study import Study

#: Validated algorithms, and those of the case with one changed algorithm.
ALGORITHMS = "template,wang2024"
CHANGED = "template,gu2020"
# A round takes minutes.
_MAX_ROUNDS = 3
# Radiance of a light in a scene file, with one or three values.
_RADIANCE = re.compile(r'(name="(?:radiance|irradiance|intensity)"\s+value=")([^"]+)(")')
_DIMMING = 0.9
# Variables that name the folders of compiled kernels, of numba and of Dr.Jit.
_KERNEL_FOLDERS = ("NUMBA_CACHE_DIR", "DRJIT_CACHE_DIR")
_HELP, _COLD, _WHOLE = "--help", "cold", "nine viewpoints"


@dataclass(frozen=True)
class Case:
    """A command with the content of its result cache."""

    name: str
    cached: str  #: Description of the cached results.
    words: tuple[str, ...]  #: The command line after `python -m`, without the output folder.
    #: Name of the cache folder, shared by cases of a round and empty when the round begins; an
    #: empty name disables the cache.
    cache: str = ""
    compared_with: str = _COLD  #: Name of the case with which time and scores are compared.
    same: str | None = None  #: Values that must be equal to those of `compared_with`.
    is_compiled: bool = True  #: False for a run that finds no compiled kernel.
    folder: str = ""  #: Name of the report's folder; default: the case's name.

    @property
    def out(self) -> str:
        """Name of the folder of its report."""
        return self.folder or self.name

    @property
    def is_validation(self) -> bool:
        """True if the command writes a report."""
        return self.name != _HELP


def bench_commands(
    plan: Plan, rounds: Rounds, folder: Path, variables: Mapping[str, str]
) -> dict[str, Any]:
    """Run all cases in turn in each round, and compare their reports.

    `folder` is empty, for caches and reports. At most three rounds are counted. Times are in
    seconds. `beside` is the name of the compared case, and `share` the median divided by that
    case's. `parts` are the seconds of the parts of the last run. `traced` and `whole` are the
    traced samples, and the samples of a run that skips nothing. `unlike` are paths of values that
    differ from those of the compared case although they should be equal.
    """
    count = min(rounds.runs, _MAX_ROUNDS)
    cases, notes = _cases(plan, folder)
    runs: dict[str, list[dict[str, Any]]] = {case.name: [] for case in cases}
    for number in range(1 + count):
        for case in cases:
            run = _run(case, folder / "reports" / case.out, folder / f"{number}", variables)
            if number:
                runs[case.name].append(run)
        shutil.rmtree(folder / f"{number}", ignore_errors=True)
    paths = {case.name: folder / "reports" / case.out / "report.json" for case in cases}
    reports = {
        case.name: json.loads(paths[case.name].read_text("utf-8"))
        for case in cases
        if case.is_validation
    }
    rows = [_row(case, runs, reports) for case in cases]
    return {
        "title": plan.settings.title or plan.request.scene.stem,
        "lens_model": plan.settings.lens_model,
        "algorithms": ALGORITHMS,
        "viewpoints": [v.name for v in plan.viewpoints],
        "rounds": count,
        "cases": rows,
        "generation": observed_shares(plan),
        "notes": notes,
    }


def _cases(plan: Plan, folder: Path) -> tuple[list[Case], list[str]]:
    """Cases in the order of a round, and notes on omitted cases."""

    def validation(*more: str, scene: Path = plan.request.scene) -> tuple[str, ...]:
        words = ["inim.validate", str(scene), "--quiet"]
        words += option_words({"-D": definition_words(plan.definitions)})
        words += ["--display", plan.settings.display]
        return (*words, *more)

    usual = ("--algorithms", ALGORITHMS)
    nine = ("--algorithms", "template", "--viewpoints", _nine_viewpoints(plan))
    added, cache = _with_added_viewpoint(plan), "one"
    cases = [
        Case(_HELP, "–", ("inim", "--help")),
        Case(_COLD, "nothing", validation(*usual), cache),
        Case("unchanged", "all", validation(*usual), cache, same=EVERYTHING, folder=_COLD),
        Case("another folder", "all", validation(*usual), cache, same=EVERYTHING),
        Case("one algorithm changed", "all except its EIA and views",
             validation("--algorithms", CHANGED), cache, same=SCORES),
        Case("one viewpoint added", "all except that view",
             validation(*usual, "--viewpoints", added), cache, same=VIEWS),
    ]  # fmt: skip
    dimmed = _write_dimmed_scene(plan, folder / "dimmed")
    if dimmed is not None:
        words = validation(*usual, scene=dimmed)
        cases.append(Case("one light changed", "unusable results", words, cache))
    cases += [
        Case(_WHOLE, "nothing", validation(*nine), "whole", _WHOLE),
        Case("nine viewpoints, --lazy", "nothing", validation(*nine, "--lazy"), "lazy", _WHOLE,
             VIEWS),
        Case("--no-skip", "–", validation(*usual, "--no-skip"), same=EVERYTHING),
        Case("first run", "nothing, no kernels", validation(*usual), "first", is_compiled=False),
        Case("--preview", "nothing", validation(*usual, "--preview"), "preview"),
    ]  # fmt: skip
    note = "no case with a changed light: the scene file contains no radiance of a light"
    return cases, [] if dimmed else [note]


def _write_dimmed_scene(plan: Plan, folder: Path) -> Path | None:
    """Copy the scene with a dimmer first light; None if the file contains no radiance."""
    text = plan.request.scene.read_text("utf-8")

    def dim(match: re.Match[str]) -> str:
        values = (float(word) * _DIMMING for word in match[2].replace(",", " ").split())
        return match[1] + ", ".join(f"{value:.9g}" for value in values) + match[3]

    try:
        changed = _RADIANCE.sub(dim, text, count=1)
    except ValueError:  # a parameter, such as $power
        return None
    if changed == text:
        return None
    folder.mkdir()
    for name, path in plan.scene_file.named.items():
        if not Path(name).is_absolute():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, folder / name)
    copy = folder / plan.request.scene.name
    copy.write_text(changed, "utf-8")
    return copy


def _nine_viewpoints(plan: Plan) -> str:
    """Three by three viewpoints: the five named ones and the corners between them."""
    right, up = _viewpoints(plan, "right,up")
    corners = {"ne": (1, 1), "nw": (-1, 1), "se": (1, -1), "sw": (-1, -1)}
    positions = [
        f"{name}={x * right.x_mm!r} {y * up.y_mm!r} {right.z_mm!r}"
        for name, (x, y) in corners.items()
    ]
    return ",".join(["centre,left,right,up,down", *positions])


def _with_added_viewpoint(plan: Plan) -> str:
    """The scene's viewpoints and an additional one, halfway to a corner."""
    right, up = _viewpoints(plan, "right,up")
    return f"{plan.settings.viewpoints},added={right.x_mm / 2!r} {up.y_mm / 2!r} {right.z_mm!r}"


def _viewpoints(plan: Plan, text: str) -> tuple[Viewpoint, ...]:
    s = plan.settings
    return parse_viewpoints(text, plan.display, s.viewing_distance_mm, s.pupil_mm, s.focus_mm)


def _run(case: Case, out: Path, caches: Path, variables: Mapping[str, str]) -> dict[str, Any]:
    """Run a case; return its seconds and its peak memory."""
    words = [*case.words]
    if case.is_validation:
        shutil.rmtree(out, ignore_errors=True)
        words += ["-o", str(out)]
    cache = str(caches / case.cache) if case.cache else "off"
    kernels = {} if case.is_compiled else dict.fromkeys(_KERNEL_FOLDERS, str(caches / "kernels"))
    return run_validation(words, {**variables, FOLDER_VARIABLE: cache, **kernels}, repr(case.name))


def _row(
    case: Case, runs: Mapping[str, Sequence[Mapping[str, Any]]], reports: Mapping[str, Any]
) -> dict[str, Any]:
    """Results of a case, under the names of bench.json."""
    seconds = [run["seconds"] for run in runs[case.name]]
    timing = Timing(seconds[0], tuple(seconds))
    other_times = Timing(0.0, tuple(run["seconds"] for run in runs[case.compared_with]))
    row = {
        "name": case.name,
        "finds": case.cached,
        "beside": case.compared_with,
        "times_s": seconds,
        "median_s": timing.median_s,
        "min_s": timing.min_s,
        "spread": timing.spread,
        "share": timing.median_s / other_times.median_s,
        "share_min": timing.min_s / other_times.min_s,
        "peak_bytes": max(run["peak_bytes"] for run in runs[case.name]),
        "traced": None,
        "whole": None,
        "same": case.same,
        "unlike": None,
        "parts": {},
    }
    if case.is_validation:
        report, other = reports[case.name], reports[case.compared_with]
        row["traced"], row["whole"] = samples_of(report["skipped"], other["skipped"])
        if case.folder:
            row["traced"] = 0  # the compared case's report, from the cache
        else:
            row["parts"] = run_parts(report["timings"])
        if case.same is not None:
            row["unlike"] = differences(report, other, case.same)
    return row


def observed_shares(plan: Plan) -> dict[str, Any]:
    """Shares of the panel that nine viewpoints observe, by lens model.

    Without `full`: it scatters rays between the lenses, so views may observe the whole EIA.
    """
    renderer = Renderer("llvm", Observer())
    viewpoints, rows = _viewpoints(plan, _nine_viewpoints(plan)), []
    for model in ("pinhole", "thin", "thick"):
        try:
            check_lens_model(model, plan.misaligned_display)
        except DisplayError:  # the lens cannot be manufactured
            continue
        optics = replace(plan.optics, lens_model=model)
        views = DisplayViews(viewpoints, optics, renderer, run=Run())
        assert views.observed is not None
        rows.append({"name": model, "observed_share": float(views.observed.mean())})
    return {"viewpoints": [v.name for v in viewpoints], "algorithms": rows}


def measure(
    scene: Path, definitions: Sequence[str], display: str | None, **rounds: Any
) -> dict[str, Any]:
    """Measure in a temporary folder."""
    variables = dict(os.environ)  # copied before the backend adds its variables
    changes = parse_definitions(definitions, str(scene))
    request = Request(
        scene, Path("unused"), definitions=changes, display=display, algorithms=("template",)
    )
    with tempfile.TemporaryDirectory() as folder:
        return bench_commands(make_plan(request), Rounds(**rounds), Path(folder), variables)


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scene, its settings and the rounds."""
    add_shared(parser, "scene", "definitions", "display")
    add_rounds(parser)


def cases(args: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """All commands, which share rounds."""
    options = {name: getattr(args, name) for name in ("scene", "definitions", "display")}
    return {"commands": {**options, **rounds_of(args)}}


STUDY = Study(
    "reports.bench.commands.run", "Bench: whole commands", __doc__, arguments, cases, measure, page,
    stem="bench", doubts=doubts,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.main())
