"""Accuracy of the calibration, measured on randomly misaligned displays.

    python -m reports.calibration.run -o reports/calibration

For each disturbed case of `reports.calibration.cases` a display is misaligned and photographed
(`reports.calibration.photographs`) from two positions: 14 photographs. The calibration uses only
the JPEG folders and the nominal display. Some cases are repeated with 168 photographs, as many as
Gray code took. Each case runs in a separate process. Cases that `calibration.json` contains are not
repeated: a stopped run continues with the next case.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

import inim
from inim.calibration.patterns import write_patterns
from inim.calibration.result import Calibration
from inim.calibration.run import calibrate
from inim.errors import InimError
from inim.process.atomic_file import write_atomically
from inim.tolerate.findings import share_interval
from reports.calibration.cases import Case, draw_disturbed
from reports.calibration.photographs import photograph_case


class Column(NamedTuple):
    """Unit and scale factor of a parameter in the tables."""

    unit: str
    scale: float


#: Parameters of the display that generators use.
COLUMNS = {
    "rotation_deg": Column("deg", 1.0),
    "pitch_mm": Column("µm", 1e3),
    "shift_x_mm": Column("µm", 1e3),
    "shift_y_mm": Column("µm", 1e3),
    "gap_mm": Column("µm", 1e3),
    "tilt_x_deg": Column("deg", 1.0),
    "tilt_y_deg": Column("deg", 1.0),
}
# Required share of intervals with the truth; a larger one is too cautious.
_COVERAGE = (0.9, 0.99)
# These cases are repeated with as many photographs as Gray code took: four positions, and bursts of
# six photographs of each pattern.
_REPEATED_PERIOD, _REPEATED_FIRST, _REPEATED_POSITIONS, _BURST = 11, 3, 4, 6
_NAME = "calibration"


def measure(
    case: Case,
    burst: int = 1,
    file: str = "display.xml",
    inspect: Callable[[Case, Calibration, Path], dict[str, Any]] | None = None,
) -> dict[str, Any]:
    """Photograph and calibrate a case; the result has the keys of calibration.json.

    * `file`: name of the display file; `inspect`: gives further keys of the result, from the
      calibration and its display file, unless it is refused.
    """
    further: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        patterns, photographs = Path(folder, "patterns"), Path(folder, "photographs")
        started = perf_counter()
        write_patterns(case.design, patterns)
        photograph_case(case, patterns, photographs, burst)
        photographed = perf_counter()
        estimates: dict[str, Any] = {}
        certain, refused, warnings = (False, False), "", list[str]()
        try:
            calibration = calibrate(
                photographs,
                case.design,
                out=Path(folder, file),
                is_steady=case.is_steady,
                warn=warnings.append,
            )
            refused = "; ".join(calibration.failures)
            if not refused:
                estimates, certain = estimates_of(calibration), calibration.edges_seen
                further = inspect(case, calibration, Path(folder, file)) if inspect else {}
        except InimError as error:
            refused = str(error).replace(folder, "...")
        count = burst * sum(1 for _ in photographs.rglob("IMG_*"))
        ended = perf_counter()
    truth = {name: getattr(case.display, name) for name in (*COLUMNS, "focal_length_mm")}
    camera = case.camera
    truth |= {"focal_px": camera.focal_length_px, "k1": camera.k1, "k2": camera.k2}
    return {
        "case": case.number,
        "display": case.design.name,
        "truth": truth,
        "found": estimates,
        "shift_is_certain": {"shift_x_mm": bool(certain[0]), "shift_y_mm": bool(certain[1])},
        "refused": refused,
        "warnings": [warning.replace(folder, "...") for warning in warnings],
        "photographs": count,
        "disturbances": case.disturbances,
        "seconds": {"photographs": photographed - started, "calibration": ended - photographed},
        **further,
    }


def estimates_of(calibration: Calibration) -> dict[str, Any]:
    """Values, errors and intervals of all estimates."""
    return {
        name: {
            "value": estimate.value,
            "standard_error": estimate.error,
            "interval": list(estimate.interval),
            "known": bool(estimate.is_known),
        }
        for name, estimate in calibration.estimates.items()
    }


class Errors(NamedTuple):
    """Errors of one parameter, with an element for each case that estimates it.

    Attributes
    ----------
    error : (cases,) array
        Estimate minus truth.
    standard_error : (cases,) array
    covered : (cases,) bool
        True if the 95 % interval contains the truth.
    determined : (cases,) bool
        True if the photographs determine the parameter.
    """

    error: np.ndarray
    standard_error: np.ndarray
    covered: np.ndarray
    determined: np.ndarray


def errors_of(results: list[dict[str, Any]], name: str) -> Errors:
    """Errors of a parameter in the results that have it."""
    rows = []
    for result in results:
        if name in result["found"]:
            truth, estimate = result["truth"][name], result["found"][name]
            low, high = estimate["interval"]
            # An ambiguous shift is determined modulo a pitch, and its error is measured so.
            certain = result["shift_is_certain"].get(name, True)
            period = 0.0 if certain else result["truth"]["pitch_mm"]
            pitches = period and period * round((estimate["value"] - truth) / period)
            error = estimate["value"] - truth - pitches
            covered = low <= truth + pitches <= high
            rows.append((error, estimate["standard_error"], covered, estimate["known"]))
    error, standard_error, covered, determined = np.array(rows, float).reshape(-1, 4).T
    return Errors(error, standard_error, covered > 0, determined > 0)


def _headings() -> list[tuple[str, Column]]:
    return [(name.rpartition("_")[0].replace("_", " "), c) for name, c in COLUMNS.items()]


def table(results: list[dict[str, Any]], repeats: list[dict[str, Any]], command: str) -> str:
    """Coverage of the intervals, in Markdown; worst case first."""
    calibrated = [result for result in results if not result["refused"]]
    low, high = (f"{share:.0%}" for share in _COVERAGE)
    counts = sorted({result["photographs"] for result in results})
    lines = [
        "# Displays calibrated from disturbed photographs",
        "",
        f"Generated by `{command}`: {len(results)} displays with {' or '.join(map(str, counts))} "
        f"photographs each, {len(calibrated)} calibrated, {len(results) - len(calibrated)} "
        f"refused. Required: {low} to {high} of the 95 % intervals contain the truth, or the "
        "command refuses. Parameters that a calibration does not determine have no interval here.",
        "",
        *coverage_lines(calibrated, COLUMNS),
        "",
        "| disturbance | cases | refused | calibrated, all intervals contain the truth |",
        "| --- | --: | --: | --: |",
        *_disturbance_rows(results),
        "",
        "Errors of each case, with their number of standard errors; the largest number first. "
        "Bold: the 95 % interval does not contain the truth. Brackets: not determined.",
        "",
        *_case_table(sorted(calibrated, key=_largest_deviation, reverse=True)),
        "",
    ]
    lines += [
        f"* Case {result['case']} ({result['display']}; {', '.join(result['disturbances'])}) "
        f"refused: {result['refused']}"
        for result in results
        if result["refused"]
    ]
    if repeats:
        lines += ["", *_repeat_lines(results, repeats)]
    return "\n".join(lines).rstrip() + "\n"


def _repeat_lines(results: list[dict[str, Any]], repeats: list[dict[str, Any]]) -> list[str]:
    """Errors of repeated cases with few and with many photographs."""
    by_case = {result["case"]: result for result in results}
    pairs = [result for repeat in repeats for result in (by_case[repeat["case"]], repeat)]
    count = repeats[0]["photographs"]
    return [
        f"The same displays with {count} photographs: {_REPEATED_POSITIONS} positions, and "
        f"{_BURST} photographs of each pattern, of which the mean is used.",
        "",
        *_case_table(pairs),
    ]


def _share_text(covered: np.ndarray) -> str:
    """Share of intervals with the truth, and its interval."""
    if not covered.size:
        return ""
    low, high = share_interval(int(np.count_nonzero(covered)), covered.size)
    return f"{covered.mean():.1%} ({low:.1%} to {high:.1%})"


def coverage_lines(results: list[dict[str, Any]], columns: Mapping[str, Column]) -> list[str]:
    """Table of the coverage of the intervals by parameter, and of all."""
    errors = {name: errors_of(results, name) for name in columns}
    pooled = np.concatenate([e.covered[e.determined] for e in errors.values()])
    return [
        "| parameter | intervals | with the truth | share (95 % interval, Wilson) "
        "| error: median | largest | standard error, median | not determined |",
        "| --- | --: | --: | --: | --: | --: | --: | --: |",
        *(_coverage_row(name, errors[name], column) for name, column in columns.items()),
        f"| all | {pooled.size} | {np.count_nonzero(pooled)} | {_share_text(pooled)} | | | | |",
    ]


def _coverage_row(name: str, errors: Errors, column: Column) -> str:
    """Row of the table of coverage."""
    error, standard_error, covered = (values[errors.determined] for values in errors[:3])
    figures = [""] * 3
    if error.size:
        sizes = np.abs(error)
        figures = [
            f"{column.scale * figure:.3g} {column.unit}"
            for figure in (np.median(sizes), sizes.max(), np.median(standard_error))
        ]
    cells = [
        f"`{name}`",
        str(covered.size),
        str(np.count_nonzero(covered)),
        _share_text(covered),
        *figures,
        str(np.count_nonzero(~errors.determined)),
    ]
    return f"| {' | '.join(cells)} |"


def _disturbance_rows(results: list[dict[str, Any]]) -> list[str]:
    """Refusals and calibrations with correct intervals for each disturbance, and without any."""
    names = sorted({name for result in results for name in result["disturbances"]})
    groups = {name: [r for r in results if name in r["disturbances"]] for name in names}
    groups["none"] = [r for r in results if not {*r["disturbances"]} - {"steady"}]
    rows = []
    for name, group in groups.items():
        refused = sum(bool(result["refused"]) for result in group)
        correct = sum(not result["refused"] and not _missed(result) for result in group)
        rows.append(f"| {name} | {len(group)} | {refused} | {correct} |")
    return rows


def _missed(result: dict[str, Any]) -> list[str]:
    """Determined parameters of a case whose intervals do not contain the truth."""
    errors = {name: errors_of([result], name) for name in COLUMNS}
    return [name for name, e in errors.items() if (e.determined & ~e.covered).any()]


def _largest_deviation(result: dict[str, Any]) -> float:
    """Largest error of a case's determined parameters, in standard errors."""
    deviations = [0.0]
    for name in COLUMNS:
        errors = errors_of([result], name)
        deviations += list(np.abs(errors.error / errors.standard_error)[errors.determined])
    return max(deviations)


def _case_table(results: list[dict[str, Any]]) -> list[str]:
    headings = " | ".join(f"{name} {column.unit}" for name, column in _headings())
    return [
        f"| case | display | photographs | disturbances | {headings} |",
        f"| --: | --- | --: | --- |{' --: |' * len(COLUMNS)}",
        *map(_case_row, results),
    ]


def _case_row(result: dict[str, Any]) -> str:
    cells = []
    for name, column in COLUMNS.items():
        errors = errors_of([result], name)
        if not errors.error.size:
            cells.append("")
            continue
        error, deviation = errors.error[0], errors.error[0] / errors.standard_error[0]
        text = f"{column.scale * error:+.3g} ({deviation:+.1f})"
        text = text if errors.covered[0] else f"**{text}**"
        cells.append(text if errors.determined[0] else f"[{text}]")
    names = ", ".join(result["disturbances"])
    begin = f"{result['case']} | {result['display']} | {result['photographs']} | {names}"
    return f"| {begin} | {' | '.join(cells)} |"


def measure_missing(
    results: list[dict[str, Any]], numbers: Iterable[int], words: list[str], module: str
) -> Iterator[dict[str, Any]]:
    """Measure cases without a result, each in its own process, by a module's `--case`."""
    for number in sorted({*numbers} - {result["case"] for result in results}):
        command = [sys.executable, "-m", module, *words, "--case", str(number)]
        output = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
        yield json.loads(output.splitlines()[-1])


def _write(path: Path, text: str) -> None:
    write_atomically(path, lambda p: p.write_text(text, "utf-8"))


def main() -> None:
    """Measure the missing cases and write the results."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("-o", "--out", type=Path, default=Path("reports/calibration"))
    parser.add_argument("--cases", type=int, default=60, help="number of cases (%(default)s)")
    parser.add_argument("--case", type=int, metavar="N", help="measure case N, print it as JSON")
    parser.add_argument("--positions", type=int, default=2, help="camera positions (%(default)s)")
    parser.add_argument(
        "--burst", type=int, default=1, help="photographs of each pattern (%(default)s)"
    )
    args = parser.parse_args()
    if args.case is not None:
        print(json.dumps(measure(draw_disturbed(args.case, args.positions), args.burst)))
        return
    path = args.out / f"{_NAME}.json"
    data: dict[str, list[dict[str, Any]]] = {"cases": [], "repeats": []}
    if path.is_file():
        stored = json.loads(path.read_text("utf-8"))
        data = {kind: stored[kind] for kind in data}
    numbers = range(args.cases)
    repeated = numbers[_REPEATED_FIRST::_REPEATED_PERIOD]
    most_photographs = ["--positions", str(_REPEATED_POSITIONS), "--burst", str(_BURST)]
    for kind, chosen, words in (
        ("cases", numbers, ["--positions", str(args.positions)]),
        ("repeats", repeated, most_photographs),
    ):
        for result in measure_missing(data[kind], chosen, words, "reports.calibration.run"):
            data[kind] = sorted([*data[kind], result], key=lambda r: r["case"])
            _write(path, json.dumps({"inim_version": inim.__version__, **data}, indent=1) + "\n")
            print(_case_row(result) + f" {result['refused']}", flush=True)
    line = f"python -m reports.calibration.run --cases {args.cases} -o {args.out}"
    _write(path.with_suffix(".md"), table(data["cases"], data["repeats"], line))


if __name__ == "__main__":
    main()
