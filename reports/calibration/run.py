"""How well photographs calibrate a display: random hidden ones, by case and as a whole.

    python -m reports.calibration.run -o reports/calibration

For each case of `reports.calibration.cases` a display is misaligned, photographed from four
positions (`reports.calibration.photographs`) and calibrated from the folders of JPEGs and the
design alone. Each case has a process of its own. Cases that `calibration.json` holds already are
not made again: a run that was stopped goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

import inim
from inim.calibrate.decode import decode
from inim.calibrate.fit import Calibration, calibrate
from inim.calibrate.lattice import find_lenses
from inim.calibrate.patterns import write_patterns
from inim.calibrate.photographs import read_positions
from inim.display import Display
from inim.errors import InimError
from inim.files.image import write_atomically
from reports.calibration.cases import Case, draw_case
from reports.calibration.photographs import photograph_case


class Target(NamedTuple):
    """How well a parameter has to be found, and how the table shows it."""

    within: float
    unit: str
    scale: float


#: Of the parameters that a case hides.
TARGETS = {
    "rotation_deg": Target(0.01, "deg", 1.0),
    "pitch_mm": Target(0.001, "µm", 1e3),
    "shift_x_mm": Target(0.025, "µm", 1e3),
    "shift_y_mm": Target(0.025, "µm", 1e3),
    "gap_mm": Target(0.1, "µm", 1e3),
}
_TILTS = {"tilt_x_deg": Target(np.inf, "deg", 1.0), "tilt_y_deg": Target(np.inf, "deg", 1.0)}
_SHOWN = TARGETS | _TILTS
_SHARE_WITHIN, _SHARE_HELD = 0.95, 0.9
# A value that is given, misses its target, and by so many of its standard errors, is a wrong one.
_CONFIDENT = 4.0
_NAME = "calibration"


def measure(case: Case) -> dict[str, Any]:
    """Photograph a case, calibrate it, and set what was found beside what was hidden."""
    with tempfile.TemporaryDirectory() as folder:
        patterns, photographs = Path(folder, "patterns"), Path(folder, "photographs")
        started = perf_counter()
        write_patterns(case.design, patterns)
        photograph_case(case, patterns, photographs)
        taken = perf_counter()
        found: dict[str, Any] = {}
        certain, refused = (False, False), ""
        try:
            made = _calibrated(photographs, case.design)
            found, certain = _estimates(made), made.edges_seen
        except InimError as error:
            refused = str(error).replace(folder, "...")
        done = perf_counter()
    truth = {name: getattr(case.display, name) for name in (*_SHOWN, "focal_length_mm")}
    camera = case.camera
    truth |= {"focal_px": camera.focal_length_px, "k1": camera.k1, "k2": camera.k2}
    return {
        "case": case.number,
        "display": case.design.name,
        "truth": truth,
        "found": found,
        "shift_is_certain": {"shift_x_mm": bool(certain[0]), "shift_y_mm": bool(certain[1])},
        "refused": refused,
        "seconds": {"photographs": taken - started, "calibration": done - taken},
    }


def _calibrated(photographs: Path, design: Display) -> Calibration:
    positions = read_positions(photographs, design)
    lenses = {one.name: find_lenses(decode(one), design, one.name) for one in positions}
    return calibrate(lenses, design, focal_px=positions[0].focal_length_px)


def _estimates(found: Calibration) -> dict[str, Any]:
    return {
        name: {
            "value": one.value,
            "standard_error": one.error,
            "interval": list(one.interval),
            "known": bool(one.is_known),
        }
        for name, one in found.estimates.items()
    }


class _Errors(NamedTuple):
    """Of a parameter, one for each case that has it: its error and what was said of it."""

    off: np.ndarray
    standard: np.ndarray
    held: np.ndarray
    known: np.ndarray


def _errors(results: list[dict[str, Any]], name: str) -> _Errors:
    rows = []
    for one in results:
        if name in one["found"]:
            truth, said = one["truth"][name], one["found"][name]
            low, high = said["interval"]
            # A shift that is stated to be known modulo a pitch is so far off.
            certain = one["shift_is_certain"].get(name, True)
            by = 0.0 if certain else one["truth"]["pitch_mm"]
            pitches = by and by * round((said["value"] - truth) / by)
            off = said["value"] - truth - pitches
            held = low <= truth + pitches <= high
            rows.append((off, said["standard_error"], held, said["known"]))
    off, standard, held, known = np.array(rows, float).reshape(-1, 4).T
    return _Errors(off, standard, held > 0, known > 0)


def _wrong(result: dict[str, Any]) -> list[str]:
    """Parameters of a case that are given, and wrong."""
    found = []
    for name, target in TARGETS.items():
        errors = _errors([result], name)
        misses = np.abs(errors.off) > np.maximum(target.within, _CONFIDENT * errors.standard)
        if (misses & errors.known).any():
            found.append(name)
    return found


def table(results: list[dict[str, Any]]) -> str:
    """The results in Markdown: a summary, then all cases, worst first."""
    done = [one for one in results if not one["refused"]]
    seconds = [[one["seconds"][k] for k in ("photographs", "calibration")] for one in results]
    taken, fitted = np.median(seconds, axis=0)
    wrong = [f"{one['case']} ({', '.join(_wrong(one))})" for one in done if _wrong(one)]
    lines = [
        "# Displays calibrated from simulated photographs",
        "",
        "Made by `python -m reports.calibration.run -o reports/calibration`: "
        f"{len(results)} hidden displays, four camera positions each, {len(done)} calibrated. "
        f"Photographs of a case took {taken:.0f} s, its calibration {fitted:.0f} s (medians).",
        "",
        f"Wanted: {_SHARE_WITHIN:.0%} of the displays within the target, and 95 % intervals that "
        f"hold the truth in {_SHARE_HELD:.0%} of the cases or more. Given, off by more than the "
        f"target and by more than {_CONFIDENT:g} standard errors: {'; '.join(wrong) or 'none'}.",
        "",
        "| parameter | target | within it | error: median | 95 % | largest "
        "| standard error, median | intervals that hold | not given |",
        "| --- | --: | --: | --: | --: | --: | --: | --: | --: |",
        *(_summary(results, name, target) for name, target in _SHOWN.items()),
        "",
        "Cases, worst first: errors, and in bold those whose 95 % interval does not hold the "
        "truth. In brackets what was not given. Where the sheet's edges are not both seen, its "
        "shift is stated to be known modulo a pitch, and its error counts so: of "
        f"{2 * len(done)} shifts, {_uncertain(done)}.",
        "",
        f"| case | display | {' | '.join(f'{n} {t.unit}' for n, t in _headings())} |",
        f"| --: | --- |{' --: |' * len(_SHOWN)}",
        *map(_row, sorted(done, key=_badness, reverse=True)),
    ]
    refused = [one for one in results if one["refused"]]
    lines += ["", *(f"Case {one['case']} was refused: {one['refused']}" for one in refused)]
    return "\n".join(lines).rstrip() + "\n"


def _uncertain(results: list[dict[str, Any]]) -> int:
    return sum(not certain for one in results for certain in one["shift_is_certain"].values())


def _headings() -> list[tuple[str, Target]]:
    return [(name.rpartition("_")[0].replace("_", " "), t) for name, t in _SHOWN.items()]


def _summary(results: list[dict[str, Any]], name: str, target: Target) -> str:
    errors = _errors(results, name)
    off = np.abs(errors.off)
    if not off.size:
        return f"| `{name}` |" + " |" * 8
    unit, scale = target.unit, target.scale
    wanted = f"{target.within * scale:g} {unit}" if np.isfinite(target.within) else ""
    # A display that was refused is not within the target.
    share = f"{np.count_nonzero(off <= target.within) / len(results):.1%}" if wanted else ""
    figures = [np.median(off), np.quantile(off, 0.95), off.max(), np.median(errors.standard)]
    cells = [
        f"`{name}`",
        wanted,
        share,
        *(f"{scale * figure:.3g} {unit}" for figure in figures),
        f"{errors.held.mean():.1%}",
        str(np.count_nonzero(~errors.known)),
    ]
    return f"| {' | '.join(cells)} |"


def _badness(result: dict[str, Any]) -> float:
    """The largest error in targets."""
    return max(
        float(np.abs(_errors([result], name).off).max(initial=0)) / target.within
        for name, target in TARGETS.items()
    )


def _row(result: dict[str, Any]) -> str:
    cells = []
    for name, target in _SHOWN.items():
        errors = _errors([result], name)
        if not errors.off.size:
            cells.append("")
            continue
        text = f"{target.scale * errors.off[0]:+.3g}"
        text = text if errors.held[0] else f"**{text}**"
        cells.append(text if errors.known[0] else f"({text})")
    return f"| {result['case']} | {result['display']} | {' | '.join(cells)} |"


def _read(path: Path) -> list[dict[str, Any]]:
    if not path.is_file():
        return []
    held = json.loads(path.read_text("utf-8"))
    cases: list[dict[str, Any]] = held["cases"]
    return cases


def _write(path: Path, results: list[dict[str, Any]]) -> None:
    data = {"inim_version": inim.__version__, "cases": sorted(results, key=lambda r: r["case"])}
    text = json.dumps(data, indent=1) + "\n"
    write_atomically(path, lambda p: p.write_text(text, "utf-8"))


def main() -> None:
    """Measure what is not there yet, and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("-o", "--out", type=Path, default=Path("reports/calibration"))
    parser.add_argument("--cases", type=int, default=40, help="how many (default: %(default)s)")
    parser.add_argument("--one", type=int, metavar="N", help="measure this case, print it as JSON")
    args = parser.parse_args()
    if args.one is not None:
        print(json.dumps(measure(draw_case(args.one))))
        return
    path = args.out / f"{_NAME}.json"
    results = [one for one in _read(path) if one["case"] < args.cases]
    for number in sorted(set(range(args.cases)) - {one["case"] for one in results}):
        words = [sys.executable, "-m", "reports.calibration.run", "--one", str(number)]
        said = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True).stdout
        results.append(json.loads(said.splitlines()[-1]))
        _write(path, results)
        print(_row(results[-1]) + f" {results[-1]['refused']}", flush=True)
    text = table(results)
    write_atomically(path.with_suffix(".md"), lambda p: p.write_text(text, "utf-8"))


if __name__ == "__main__":
    main()
