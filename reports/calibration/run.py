"""Accuracy of the calibration, measured on randomly misaligned displays.

    python -m reports.calibration.run -o reports/calibration
    python -m reports.calibration.run --disturbed --cases 60 -o reports/calibration

For each case of `reports.calibration.cases` a display is misaligned and photographed
(`reports.calibration.photographs`), disturbed cases from two positions and others from four. The
calibration uses only the JPEG folders and the nominal display. Each case runs in a separate
process. Cases that `calibration.json` or `disturbed.json` contains are not repeated: a stopped run
continues with the next case.
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
from inim.calibration.fit import Calibration
from inim.calibration.patterns import write_patterns
from inim.calibration.run import calibrate
from inim.errors import InimError
from inim.process.atomic_file import write_atomically
from inim.tolerate.findings import share_interval
from reports.calibration.cases import Case, draw_case, draw_disturbed
from reports.calibration.photographs import photograph_case


class Target(NamedTuple):
    """Largest accepted error of a parameter, with the table's unit and scale factor."""

    max_error: float
    unit: str
    scale: float


#: Targets of the misaligned parameters.
TARGETS = {
    "rotation_deg": Target(0.01, "deg", 1.0),
    "pitch_mm": Target(0.001, "µm", 1e3),
    "shift_x_mm": Target(0.025, "µm", 1e3),
    "shift_y_mm": Target(0.025, "µm", 1e3),
    "gap_mm": Target(0.1, "µm", 1e3),
}
_TILTS = {"tilt_x_deg": Target(np.inf, "deg", 1.0), "tilt_y_deg": Target(np.inf, "deg", 1.0)}
_COLUMNS = TARGETS | _TILTS
_TARGET_SHARE, _COVERAGE = 0.95, 0.9
# Required share of intervals with the truth in disturbed cases; a larger one is too cautious.
_DISTURBED_COVERAGE = (0.9, 0.99)
# A determined value is wrong if its error exceeds the target and this number of standard errors.
_MAX_STANDARD_ERRORS = 4.0
_NAME, _DISTURBED_NAME = "calibration", "disturbed"


def measure(case: Case) -> dict[str, Any]:
    """Photograph and calibrate a case; the result has the keys of calibration.json."""
    with tempfile.TemporaryDirectory() as folder:
        patterns, photographs = Path(folder, "patterns"), Path(folder, "photographs")
        started = perf_counter()
        write_patterns(case.design, patterns)
        photograph_case(case, patterns, photographs)
        photographed = perf_counter()
        estimates: dict[str, Any] = {}
        certain, refused, warnings = (False, False), "", list[str]()
        try:
            calibration = calibrate(
                photographs, case.design, out=Path(folder, "display.xml"), warn=warnings.append
            )
            refused = "; ".join(calibration.failures)
            if not refused:
                estimates, certain = _estimates(calibration), calibration.edges_seen
        except InimError as error:
            refused = str(error).replace(folder, "...")
        count = sum(1 for _ in photographs.rglob("*.jpg"))
        ended = perf_counter()
    truth = {name: getattr(case.display, name) for name in (*_COLUMNS, "focal_length_mm")}
    camera = case.camera
    truth |= {"focal_px": camera.focal_length_px, "k1": camera.k1, "k2": camera.k2}
    return {
        "case": case.number,
        "display": case.design.name,
        "truth": truth,
        "found": estimates,
        "shift_is_certain": {"shift_x_mm": bool(certain[0]), "shift_y_mm": bool(certain[1])},
        "refused": refused,
        "warnings": warnings,
        "photographs": count,
        "disturbances": case.disturbances,
        "seconds": {"photographs": photographed - started, "calibration": ended - photographed},
    }


def _estimates(calibration: Calibration) -> dict[str, Any]:
    return {
        name: {
            "value": estimate.value,
            "standard_error": estimate.error,
            "interval": list(estimate.interval),
            "known": bool(estimate.is_known),
        }
        for name, estimate in calibration.estimates.items()
    }


class _Errors(NamedTuple):
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


def _errors(results: list[dict[str, Any]], name: str) -> _Errors:
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
    return _Errors(error, standard_error, covered > 0, determined > 0)


def _wrong_parameters(result: dict[str, Any]) -> list[str]:
    """Parameters of a case that count as determined although their values are wrong."""
    names = []
    for name, target in TARGETS.items():
        errors = _errors([result], name)
        limit = np.maximum(target.max_error, _MAX_STANDARD_ERRORS * errors.standard_error)
        if ((np.abs(errors.error) > limit) & errors.determined).any():
            names.append(name)
    return names


def table(results: list[dict[str, Any]]) -> str:
    """Results in Markdown: a summary, then all cases, worst first."""
    calibrated = [result for result in results if not result["refused"]]
    seconds = [[r["seconds"][k] for k in ("photographs", "calibration")] for r in results]
    photograph_s, calibration_s = np.median(seconds, axis=0)
    wrong = {result["case"]: _wrong_parameters(result) for result in calibrated}
    wrong_text = "; ".join(f"{case} ({', '.join(names)})" for case, names in wrong.items() if names)
    lines = [
        "# Displays calibrated from simulated photographs",
        "",
        "Generated by `python -m reports.calibration.run -o reports/calibration`: "
        f"{len(results)} misaligned displays with four camera positions each, {len(calibrated)} "
        f"calibrated. The photographs of a case took {photograph_s:.0f} s and its calibration "
        f"{calibration_s:.0f} s (medians).",
        "",
        f"Requirements: {_TARGET_SHARE:.0%} of the displays are within the target, and the 95 % "
        f"intervals contain the truth in at least {_COVERAGE:.0%} of the cases. Determined values "
        f"with an error above the target and above {_MAX_STANDARD_ERRORS:g} standard errors: "
        f"{wrong_text or 'none'}.",
        "",
        "| parameter | target | within target | error: median | 95 % | largest "
        "| standard error, median | intervals with the truth | not determined |",
        "| --- | --: | --: | --: | --: | --: | --: | --: | --: |",
        *(_summary_row(results, name, target) for name, target in _COLUMNS.items()),
        "",
        "The next table lists the error of each case, worst case first. Bold: the 95 % interval "
        "does not contain the truth. Brackets: the photographs do not determine the parameter. A "
        "shift is ambiguous by a pitch if the photographs do not show both edges of the sheet; its "
        f"error is then measured modulo a pitch. Ambiguous shifts: {_ambiguous(calibrated)} of "
        f"{2 * len(calibrated)}.",
        "",
        f"| case | display | {' | '.join(f'{n} {t.unit}' for n, t in _headings())} |",
        f"| --: | --- |{' --: |' * len(_COLUMNS)}",
        *map(_case_row, sorted(calibrated, key=_largest_error, reverse=True)),
    ]
    refused = [result for result in results if result["refused"]]
    lines += ["", *(f"Case {result['case']} failed: {result['refused']}" for result in refused)]
    return "\n".join(lines).rstrip() + "\n"


def _ambiguous(results: list[dict[str, Any]]) -> int:
    """Number of shifts that are ambiguous by a pitch."""
    return sum(not certain for result in results for certain in result["shift_is_certain"].values())


def _headings() -> list[tuple[str, Target]]:
    return [(name.rpartition("_")[0].replace("_", " "), t) for name, t in _COLUMNS.items()]


def _summary_row(results: list[dict[str, Any]], name: str, target: Target) -> str:
    errors = _errors(results, name)
    sizes = np.abs(errors.error)
    if not sizes.size:
        return f"| `{name}` |" + " |" * 8
    unit, scale, limit = target.unit, target.scale, target.max_error
    limit_text = f"{limit * scale:g} {unit}" if np.isfinite(limit) else ""
    # A display without a calibration is not within the target.
    share = f"{np.count_nonzero(sizes <= limit) / len(results):.1%}" if limit_text else ""
    standard_error = np.median(errors.standard_error)
    figures = [np.median(sizes), np.quantile(sizes, 0.95), sizes.max(), standard_error]
    cells = [
        f"`{name}`",
        limit_text,
        share,
        *(f"{scale * figure:.3g} {unit}" for figure in figures),
        f"{errors.covered.mean():.1%}",
        str(np.count_nonzero(~errors.determined)),
    ]
    return f"| {' | '.join(cells)} |"


def _largest_error(result: dict[str, Any]) -> float:
    """Largest error of a case relative to its target."""
    return max(
        float(np.abs(_errors([result], name).error).max(initial=0)) / target.max_error
        for name, target in TARGETS.items()
    )


def _case_row(result: dict[str, Any]) -> str:
    cells = []
    for name, target in _COLUMNS.items():
        errors = _errors([result], name)
        if not errors.error.size:
            cells.append("")
            continue
        text = f"{target.scale * errors.error[0]:+.3g}"
        text = text if errors.covered[0] else f"**{text}**"
        cells.append(text if errors.determined[0] else f"({text})")
    return f"| {result['case']} | {result['display']} | {' | '.join(cells)} |"


def disturbed_table(results: list[dict[str, Any]], command: str) -> str:
    """Coverage of the intervals in disturbed cases, in Markdown; worst case first."""
    calibrated = [result for result in results if not result["refused"]]
    errors = {name: _errors(calibrated, name) for name in _COLUMNS}
    pooled = np.concatenate([e.covered[e.determined] for e in errors.values()])
    low, high = (f"{share:.0%}" for share in _DISTURBED_COVERAGE)
    counts = sorted({result["photographs"] for result in results})
    lines = [
        "# Displays calibrated from disturbed photographs",
        "",
        f"Generated by `{command}`: {len(results)} displays with {' or '.join(map(str, counts))} "
        f"photographs each, {len(calibrated)} calibrated, {len(results) - len(calibrated)} "
        f"refused. Required: {low} to {high} of the 95 % intervals contain the truth, or the "
        "command refuses. Parameters that a calibration does not determine have no interval here.",
        "",
        "| parameter | intervals | with the truth | share (95 % interval, Wilson) "
        "| error: median | largest | standard error, median | not determined |",
        "| --- | --: | --: | --: | --: | --: | --: | --: |",
        *(_coverage_row(name, errors[name], target) for name, target in _COLUMNS.items()),
        f"| all | {pooled.size} | {np.count_nonzero(pooled)} | {_share_text(pooled)} | | | | |",
        "",
        "| disturbance | cases | refused | calibrated, all intervals contain the truth |",
        "| --- | --: | --: | --: |",
        *_disturbance_rows(results),
        "",
        "Errors of each case, with their number of standard errors; the largest number first. "
        "Bold: the 95 % interval does not contain the truth. Brackets: not determined.",
        "",
        "| case | display | disturbances | "
        + " | ".join(f"{name} {target.unit}" for name, target in _headings())
        + " |",
        f"| --: | --- | --- |{' --: |' * len(_COLUMNS)}",
        *map(_disturbed_row, sorted(calibrated, key=_largest_deviation, reverse=True)),
        "",
    ]
    lines += [
        f"* Case {result['case']} ({result['display']}; {', '.join(result['disturbances'])}) "
        f"refused: {result['refused']}"
        for result in results
        if result["refused"]
    ]
    return "\n".join(lines).rstrip() + "\n"


def _share_text(covered: np.ndarray) -> str:
    if not covered.size:
        return ""
    low, high = share_interval(int(np.count_nonzero(covered)), covered.size)
    return f"{covered.mean():.1%} ({low:.1%} to {high:.1%})"


def _coverage_row(name: str, errors: _Errors, target: Target) -> str:
    error, standard_error, covered = (values[errors.determined] for values in errors[:3])
    figures = [""] * 3
    if error.size:
        sizes = np.abs(error)
        figures = [
            f"{target.scale * figure:.3g} {target.unit}"
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
    groups["none"] = [r for r in results if not r["disturbances"]]
    rows = []
    for name, group in groups.items():
        refused = sum(bool(result["refused"]) for result in group)
        correct = sum(not result["refused"] and not _missed(result) for result in group)
        rows.append(f"| {name} | {len(group)} | {refused} | {correct} |")
    return rows


def _missed(result: dict[str, Any]) -> list[str]:
    """Determined parameters of a case whose intervals do not contain the truth."""
    errors = {name: _errors([result], name) for name in _COLUMNS}
    return [name for name, e in errors.items() if (e.determined & ~e.covered).any()]


def _largest_deviation(result: dict[str, Any]) -> float:
    """Largest error of a case's determined parameters, in standard errors."""
    deviations = [0.0]
    for name in _COLUMNS:
        errors = _errors([result], name)
        deviations += list(np.abs(errors.error / errors.standard_error)[errors.determined])
    return max(deviations)


def _disturbed_row(result: dict[str, Any]) -> str:
    cells = []
    for name, target in _COLUMNS.items():
        errors = _errors([result], name)
        if not errors.error.size:
            cells.append("")
            continue
        error, deviation = errors.error[0], errors.error[0] / errors.standard_error[0]
        text = f"{target.scale * error:+.3g} ({deviation:+.1f})"
        text = text if errors.covered[0] else f"**{text}**"
        cells.append(text if errors.determined[0] else f"[{text}]")
    names = ", ".join(result["disturbances"])
    return f"| {result['case']} | {result['display']} | {names} | {' | '.join(cells)} |"


def _read(path: Path) -> list[dict[str, Any]]:
    if not path.is_file():
        return []
    cases: list[dict[str, Any]] = json.loads(path.read_text("utf-8"))["cases"]
    return cases


def _write(path: Path, results: list[dict[str, Any]]) -> None:
    data = {"inim_version": inim.__version__, "cases": sorted(results, key=lambda r: r["case"])}
    text = json.dumps(data, indent=1) + "\n"
    write_atomically(path, lambda p: p.write_text(text, "utf-8"))


def main() -> None:
    """Measure the missing cases and write the results."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("-o", "--out", type=Path, default=Path("reports/calibration"))
    parser.add_argument("--cases", type=int, default=40, help="number of cases (%(default)s)")
    parser.add_argument("--case", type=int, metavar="N", help="measure case N, print it as JSON")
    parser.add_argument("--disturbed", action="store_true", help="disturbed cases")
    parser.add_argument(
        "--positions", type=int, default=2, help="positions of disturbed cases (%(default)s)"
    )
    args = parser.parse_args()
    if args.case is not None:
        disturbed = args.disturbed
        case = draw_disturbed(args.case, args.positions) if disturbed else draw_case(args.case)
        print(json.dumps(measure(case)))
        return
    path = args.out / f"{_DISTURBED_NAME if args.disturbed else _NAME}.json"
    kind = ["--disturbed", "--positions", str(args.positions)] if args.disturbed else []
    script = ["-m", "reports.calibration.run", *kind]
    results = [result for result in _read(path) if result["case"] < args.cases]
    for number in sorted(set(range(args.cases)) - {result["case"] for result in results}):
        command = [sys.executable, *script, "--case", str(number)]
        output = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
        results.append(json.loads(output.splitlines()[-1]))
        _write(path, results)
        print(_case_row(results[-1]) + f" {results[-1]['refused']}", flush=True)
    line = " ".join(["python", *script, "--cases", str(args.cases), "-o", str(args.out)])
    text = disturbed_table(results, line) if args.disturbed else table(results)
    write_atomically(path.with_suffix(".md"), lambda p: p.write_text(text, "utf-8"))


if __name__ == "__main__":
    main()
