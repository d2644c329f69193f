"""What a validation costs cold, and with something to find again: whole commands.

    python -m reports.bench.commands.run scenes/amphora.xml --runs 3 -o reports/bench/commands

takes some minutes. Every case is a process as a user would start it, timed from its start to its
end, with a result cache of its own; all cases take turns in every round, the first of which is not
counted. So the kernels that numba and Dr.Jit keep on disk are there, and the cache is what a case
says it is.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from inim.cache import FOLDER_VARIABLE
from inim.display.viewpoint import Viewpoint, parse_viewpoints
from inim.errors import EXIT_CHECK_FAILED, EXIT_PASSED, WorkerError
from inim.files.image import read_rgbd
from inim.pipeline.plan import Plan
from inim.pipeline.request import definition_words, option_words
from inim.timing import Rounds, Timing
from reports.bench.commands.masked import bench_masked
from reports.bench.commands.report import parts_of
from reports.bench.commands.same_scores import EVERYTHING, SCORES, VIEWS, samples_of, unlike
from reports.bench.process import run_measured
from reports.bench.study import add_scene_arguments, new_parser, plan_of, run_study

#: What is validated, and what is when one algorithm is another.
ALGORITHMS = "template,wang2024"
CHANGED = "template,gu2020"
# A round takes minutes: more would cost more than they tell.
_MOST_ROUNDS = 3
# A light's strength in a scene file, which may have one value or three.
_STRENGTH = re.compile(r'(name="(?:radiance|irradiance|intensity)"\s+value=")([^"]+)(")')
_DIMMED = 0.9
_HELP, _COLD, _WHOLE = "--help", "cold", "nine viewpoints"


@dataclass(frozen=True)
class Case:
    """A command and what it finds.

    Attributes
    ----------
    name : str
    finds : str
        What is in its cache, in words.
    words : tuple of str
        The command line after `python -m`, without its output folder.
    store : str
        Cases of a round with the same one share it; it is empty when the round begins. "": none.
    compared_with : str
        The case whose time and scores its own are compared with.
    same : str, optional
        What of its report has to be equal to that of `compared_with`; nothing if None.
    """

    name: str
    finds: str
    words: tuple[str, ...]
    store: str = ""
    compared_with: str = _COLD
    same: str | None = None

    @property
    def is_validation(self) -> bool:
        """Whether it writes a report."""
        return self.name != _HELP


def bench_commands(
    plan: Plan, rounds: Rounds, listener: Any, folder: Path, variables: Mapping[str, str]
) -> dict[str, Any]:
    """Run every case in turn, round after round, and compare what they report.

    Parameters
    ----------
    plan : Plan
        Of a validation of the scene.
    rounds : Rounds
        At most three; the warm-ups and threads are for the generation of part of an EIA, and
        commands have one warm-up.
    listener : Observer
    folder : Path
        Empty; for caches and reports.
    variables : mapping of str to str
        The environment of the commands, but for the store.

    Returns
    -------
    dict
        Under the names of bench.json. Times are seconds; a case's `share` is its median over that
        of the case it is `beside`; `traced` and `whole` are samples of the renderer; `unlike` are
        the paths of values in its report that should equal those of `beside` and do not.
    """
    count = min(rounds.runs, _MOST_ROUNDS)
    cases, notes = _cases(plan, folder)
    runs: dict[str, list[dict[str, Any]]] = {case.name: [] for case in cases}
    for number in range(1 + count):
        for case in cases:
            listener.stage(f"round {number} of {count}: {case.name}")
            found = _run(case, folder / "reports" / case.name, folder / f"{number}", variables)
            if number:
                runs[case.name].append(found)
        shutil.rmtree(folder / f"{number}", ignore_errors=True)
    reports = {case.name: _report(folder, case) for case in cases if case.is_validation}
    rows = [_row(case, runs, reports) for case in cases]
    for row in rows:
        listener.line(_in_words(row))
    listener.stage("generate what is observed")
    rgbd = read_rgbd(folder / "reports" / _COLD / "rgbd.exr")
    masked = bench_masked(plan, rgbd, _viewpoints(plan, _nine(plan)), rounds, listener)
    return {
        "title": plan.settings.title or plan.request.scene.stem,
        "scene": {"path": str(plan.request.scene), "sha256": plan.file.sha256},
        "display": {
            "parameters": plan.display.parameters(),
            "derived": plan.display.derived_quantities(),
        },
        "lens_model": plan.settings.lens_model,
        "algorithms": ALGORITHMS,
        "viewpoints": [v.name for v in plan.viewpoints],
        "rounds": count,
        "cases": rows,
        "generation": masked,
        "notes": notes,
    }


def _cases(plan: Plan, folder: Path) -> tuple[list[Case], list[str]]:
    """In the order of a round, and a note on what is left out."""

    def validation(*more: str, scene: Path = plan.request.scene) -> tuple[str, ...]:
        words = ["inim.validate", str(scene), "--quiet"]
        words += option_words({"-D": definition_words(plan.definitions)})
        words += ["--display", plan.settings.display]
        return (*words, *more)

    usual = ("--algorithms", ALGORITHMS)
    many = ("--algorithms", "template", "--viewpoints", _nine(plan))
    one = "one"
    cases = [
        Case(_HELP, "–", ("inim", "--help")),
        Case(_COLD, "nothing", validation(*usual), one),
        Case("unchanged", "all", validation(*usual), one, same=EVERYTHING),
        Case(
            "one algorithm changed",
            "all but its EIA and views",
            validation("--algorithms", CHANGED),
            one,
            same=SCORES,
        ),
        Case(
            "one viewpoint added",
            "all but that view",
            validation(*usual, "--viewpoints", _added(plan)),
            one,
            same=VIEWS,
        ),
    ]
    dimmed = _dimmed(plan, folder / "dimmed")
    if dimmed is not None:
        words = validation(*usual, scene=dimmed)
        cases.append(Case("one light changed", "no such pictures", words, one))
    cases += [
        Case(_WHOLE, "nothing", validation(*many), "whole", compared_with=_WHOLE),
        Case(
            "nine viewpoints, --lazy",
            "nothing",
            validation(*many, "--lazy"),
            "lazy",
            compared_with=_WHOLE,
            same=VIEWS,
        ),
        Case("--no-skip", "–", validation(*usual, "--no-skip"), same=EVERYTHING),
    ]
    note = "no case with another light: the scene's own file states no strength of a light"
    return cases, [] if dimmed else [note]


def _dimmed(plan: Plan, folder: Path) -> Path | None:
    """A copy of the scene, a tenth of its first light's strength less; None: it states none."""
    text = plan.request.scene.read_text("utf-8")

    def less(found: re.Match[str]) -> str:
        values = (float(word) * _DIMMED for word in found[2].replace(",", " ").split())
        return found[1] + ", ".join(f"{value:.9g}" for value in values) + found[3]

    try:
        changed = _STRENGTH.sub(less, text, count=1)
    except ValueError:  # a parameter, such as $power
        return None
    if changed == text:
        return None
    folder.mkdir()
    for name, path in plan.file.named.items():
        if not Path(name).is_absolute():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, folder / name)
    copy = folder / plan.request.scene.name
    copy.write_text(changed, "utf-8")
    return copy


def _nine(plan: Plan) -> str:
    """Three by three viewpoints: the named five, and between them the corners."""
    right, up = _viewpoints(plan, "right,up")
    corners = {"ne": (1, 1), "nw": (-1, 1), "se": (1, -1), "sw": (-1, -1)}
    places = [
        f"{name}={x * right.x_mm!r} {y * up.y_mm!r} {right.z_mm!r}"
        for name, (x, y) in corners.items()
    ]
    return ",".join(["centre,left,right,up,down", *places])


def _added(plan: Plan) -> str:
    """The scene's viewpoints and one more, halfway to a corner."""
    right, up = _viewpoints(plan, "right,up")
    return f"{plan.settings.viewpoints},added={right.x_mm / 2!r} {up.y_mm / 2!r} {right.z_mm!r}"


def _viewpoints(plan: Plan, text: str) -> tuple[Viewpoint, ...]:
    s = plan.settings
    return parse_viewpoints(text, plan.display, s.viewing_distance_mm, s.pupil_mm, s.focus_mm)


def _run(case: Case, out: Path, stores: Path, variables: Mapping[str, str]) -> dict[str, Any]:
    """One run: seconds and peak memory, of a command that came to its end."""
    words = [sys.executable, "-m", *case.words]
    if case.is_validation:
        shutil.rmtree(out, ignore_errors=True)
        words += ["-o", str(out)]
    store = str(stores / case.store) if case.store else "off"
    found = run_measured(words, {**variables, FOLDER_VARIABLE: store})
    # A check may fail on a display as small as one likes: the run was whole all the same.
    if found["code"] not in (EXIT_PASSED, EXIT_CHECK_FAILED):
        raise WorkerError(
            f"commands: {case.name!r} ended with code {found['code']}: {found['said']}"
        )
    return found


def _report(folder: Path, case: Case) -> dict[str, Any]:
    text = (folder / "reports" / case.name / "report.json").read_text("utf-8")
    report: dict[str, Any] = json.loads(text)
    return report


def _row(
    case: Case, runs: Mapping[str, Sequence[Mapping[str, Any]]], reports: Mapping[str, Any]
) -> dict[str, Any]:
    """A case, under the names of bench.json."""
    taken = [run["seconds"] for run in runs[case.name]]
    timing = Timing(taken[0], tuple(taken))
    other_times = Timing(0.0, tuple(run["seconds"] for run in runs[case.compared_with]))
    row = {
        "name": case.name,
        "finds": case.finds,
        "beside": case.compared_with,
        "times_s": taken,
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
    }
    if case.is_validation:
        report, other = reports[case.name], reports[case.compared_with]
        row["traced"], row["whole"] = samples_of(report["skipped"], other["skipped"])
        if case.same is not None:
            row["unlike"] = unlike(report, other, case.same)
    return row


def _in_words(row: Mapping[str, Any]) -> str:
    said = "" if row["unlike"] is None else "same scores" if not row["unlike"] else "OTHER SCORES"
    return (
        f"{row['name']:27}  {row['median_s']:8.2f} s  {row['share']:7.1%} of {row['beside']!r}  "
        f"{row['peak_bytes'] / 2**20:6.0f} MiB  {said}"
    )


# -- the command --------------------------------------------------------------------------------


def main() -> int:
    """Carry out the study; the exit code."""
    variables = dict(os.environ)  # before the backend adds its own: as a user's commands have them
    parser = new_parser(__doc__, "bench-commands")
    parser.add_argument("scene", type=Path, help="Mitsuba scene (.xml)")
    add_scene_arguments(parser)
    args = parser.parse_args()

    def measure(rounds: Rounds, listener: Any, folder: Path) -> dict[str, Any]:
        plan = plan_of(args, args.scene)
        return {"commands": bench_commands(plan, rounds, listener, folder, variables)}

    title = f"Bench: commands on {args.scene.stem}"
    return run_study(args, "reports.bench.commands.run", title, measure, parts_of)


if __name__ == "__main__":
    sys.exit(main())
