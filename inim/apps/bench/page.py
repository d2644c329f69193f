"""The report of a bench: `bench.json`, `bench.csv`, `bench.md`, `bench.html` and the plot."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from inim.apps.bench.document import (
    BenchAlgorithm,
    BenchDocument,
    BenchError,
    BenchScene,
    Estimate,
)
from inim.apps.bench.front import WRONG_SOURCE
from inim.report import plots
from inim.report.labels import MISSING, number, per_cent, precise
from inim.report.study import PagePart, StudyPage, Table
from inim.scores.metrics import HEADLINE
from inim.system.document import decode, encode, write_text

#: Names of the files, the JSON first.
FILES = ("bench.json", "bench.csv", "bench.html", "bench.md", "time.svg", "time.png")
#: The label of a time axis.
TIME = "milliseconds per EIA"
# Below this share of wrong sources the axis is linear, so that zero has a place on it.
_LINEAR_SHARE = 1e-3
_MIB = 2**20


def write_bench(data: BenchDocument, folder: Path) -> None:
    """Write all forms of a bench into an empty folder, `bench.json` last: it marks a whole one."""
    data = decode(encode(data), BenchDocument)  # as it is read: infinite values are null
    write_text(folder / "bench.csv", bench_csv(data))
    bench_page(data).write(data, folder, "bench")


def bench_page(data: BenchDocument) -> StudyPage:
    """The page of a bench as it is read from `bench.json`."""
    lead = (
        "Points at the bottom left are best. Bars are 95 % intervals. A line joins the options of "
        "an algorithm. Filled points are on the front: no other algorithm is significantly better "
        "in time or error, and not significantly worse in the other. ≠: unequal rays or colours."
    )
    tables = [_table(data.errors, scene) for scene in data.scenes]
    part = PagePart("time", "Time against error", lead, tables, "time", _draw(data))
    displays = dict.fromkeys(scene.display.parameters.name for scene in data.scenes)
    facts = [
        *(f"Display {name}" for name in displays),
        f"{data.threads} thread{'s' * (data.threads != 1)}",
        data.backend.device,
        f"inim {data.inim_version}",
    ]
    warnings = [f"{scene.name}: {text}" for scene in data.scenes for text in scene.warnings]
    return StudyPage("Conditions", facts, _remarks(data), [part], warnings)


def bench_csv(data: BenchDocument) -> str:
    """A line for each scene, size and algorithm: times, memory, errors and their intervals."""
    stream = io.StringIO()
    rows = [_csv_row(data, scene, a) for scene in data.scenes for a in scene.algorithms]
    writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


def _csv_row(data: BenchDocument, scene: BenchScene, a: BenchAlgorithm) -> dict[str, Any]:
    rows, columns = scene.display.derived.eia_rows, scene.display.derived.eia_columns
    row = {
        "scene": scene.path, "size": scene.size, "panel_rows": rows, "panel_columns": columns,
        "picture_rows": scene.picture.rows, "picture_columns": scene.picture.columns,
        "algorithm": a.name, "terms": a.terms, "is_equal": a.is_equal,
        "runs": a.runs, "memory_bytes": a.memory_bytes, "prepare_s": a.prepare_s,
        "hole_fraction": a.hole_fraction,
        **{f"eia_{key}": value for key, value in a.eia.items()},
    }  # fmt: skip
    no_estimate = Estimate(value=None, interval=(None, None))
    errors = {error.key: a.errors.get(error.key, no_estimate) for error in data.errors}
    estimates = {"time_ms": a.time_ms, "kernel_times": a.kernel_times, **errors}
    for key, estimate in estimates.items():
        low, high = estimate.interval
        row |= {key: estimate.value, f"{key}_low": low, f"{key}_high": high}
    return row | {f"on_front_{error.key}": error.key in a.fronts for error in data.errors}


def milliseconds(value: float | None) -> str:
    """Format a time with about three significant digits, the reproducible ones."""
    return number(value, _time_digits(value))


def _time_digits(value: float | None) -> int:
    if value is None or value >= 1000:
        return 0
    return 3 if value < 1 else 2 if value < 100 else 1


def _precise_time(estimate: Estimate) -> str:
    value = estimate.value
    return MISSING if value is None else precise(value, estimate.interval, _time_digits(value))


def _table(errors: Sequence[BenchError], scene: BenchScene) -> Table:
    """Time, memory and errors of all algorithms; errors on whose front one is have a star."""
    plain = list(dict.fromkeys(key for a in scene.algorithms for key in a.eia))
    heads = [
        "algorithm", "rays", "ms per EIA", "kernel times", "runs", "memory MiB", "prepare s",
        *(error.label for error in errors), "holes", *(f"EIA {key}, noisy" for key in plain),
    ]  # fmt: skip
    rows = [
        [
            a.name,
            a.terms + " ≠" * (not a.is_equal),
            _precise_time(a.time_ms),
            _precise_time(a.kernel_times),
            str(a.runs),
            MISSING if a.memory_bytes is None else number(a.memory_bytes / _MIB, 1),
            number(a.prepare_s, 3),
            *(_error_cell(a, error) for error in errors),
            per_cent(a.hole_fraction, 2),
            *(number(a.eia.get(key), 3) for key in plain),
        ]
        for a in scene.algorithms
    ]
    kernel = ["reference kernel", MISSING, milliseconds(scene.yardstick.median_ms), "1"]
    rows.append([*kernel, *[MISSING] * (len(heads) - len(kernel))])
    return Table(f"Time against error: {scene.name}", heads, rows)


def scene_lines(errors: Sequence[BenchError], scene: BenchScene) -> list[str]:
    """Lines for the terminal: times, wrong sources, scores, and warnings."""
    table = _table(errors, scene)
    columns = [0, 2, 3, *(table.heads.index(error.label) for error in errors)]
    cells = [[row[column] for column in columns] for row in (table.heads, *table.rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in cells]
    return [scene.name, *lines, *(f"warning: {scene.name}: {text}" for text in scene.warnings)]


def _error_cell(algorithm: BenchAlgorithm, error: BenchError) -> str:
    estimate = algorithm.errors.get(error.key)
    if estimate is None or estimate.value is None:
        return MISSING
    unit = 100 if error.key == WRONG_SOURCE else 1
    ends = [None if end is None else unit * end for end in estimate.interval]
    star = " *" * (error.key in algorithm.fronts)
    return precise(unit * estimate.value, ends, error.digits) + star


def _remarks(data: BenchDocument) -> list[str]:
    """Conditions, in sentences."""
    slow = dict.fromkeys(a.name for scene in data.scenes for a in scene.algorithms if a.slow)
    others = ", ".join(per_cent(scene.others, 0) for scene in data.scenes)
    checked = ", ".join(f"{scene.checked_pixels:,}" for scene in data.scenes)
    lines = [
        f"Other programs used {others} of {data.cores or MISSING} cores.",
        f"Trimmed means of {data.runs} runs, alternating with the reference kernel: one "
        "4-byte gather per display pixel where its ray meets the central depth plane. A kernel "
        f"time is the time of that kernel. First calls and {data.warmups} warm-ups count "
        "for no algorithm.",
        "The input, 8-bit sRGB, and the panel's output exist; memory is the peak of a process that "
        "prepares an algorithm and generates one EIA, without imports and kernels.",
        "Wrong source: share of panel pixels with another source than the exact first hit in "
        f"rational numbers, of all or of a random sample: {checked}. Scores of views are on the "
        "relic, to the reference, without noise, the mean over the viewpoints. Scores of the EIA "
        "are to the ground truth and include its noise.",
        "*: on the front of this error. ≠: rays or colours differ from those of most algorithms.",
    ]
    if slow:
        lines.append(f"Slow, therefore timed in fewer runs: {', '.join(slow)}.")
    return lines


def _draw(data: BenchDocument) -> Any:
    """A row of panels for each scene and size: wrong sources and the headline score over time."""
    figure, axes = plots.new_figure(2, 3.4 * len(data.scenes), rows=len(data.scenes))
    panels = zip(axes[::2], axes[1::2], data.scenes, strict=True)
    lines: dict[str, Any] = {}
    for source_axis, view_axis, scene in panels:
        plots.style(source_axis, scene.name, TIME, "panel pixels with a wrong source, %")
        plots.style(view_axis, "", TIME, "1 − SSIM on the relic")
        lines |= _panel(source_axis, scene, WRONG_SOURCE, lambda share: 100 * share)
        lines |= _panel(view_axis, scene, HEADLINE, lambda ssim: 1 - ssim)
        linear = 100 * _LINEAR_SHARE
        source_axis.set_yscale("symlog", linthresh=linear, linscale=0.5)
        source_axis.set_ylim(-0.3 * linear, max(10 * linear, 1.5 * source_axis.get_ylim()[1]))
        view_axis.set_yscale("log")
        for axis in (source_axis, view_axis):
            axis.set_xscale("log")
            plots.plain_ticks(axis)
    figure.legend(lines.values(), lines, loc="outside lower center", ncols=5, **plots.LEGEND)
    return figure


def _panel(axis: Any, scene: BenchScene, key: str, transform: Any) -> dict[str, Any]:
    """Draw a line with error bars for each algorithm; return the lines by algorithm."""
    families: dict[str, list[BenchAlgorithm]] = {}
    for a in scene.algorithms:
        if key in a.errors and a.errors[key].value is not None:
            families.setdefault(a.name.partition(":")[0], []).append(a)
    lines = {}
    for family, members in families.items():
        members.sort(key=lambda a: a.time_ms.value or 0.0)
        colour = plots.colour_of(family)
        (lines[family],) = axis.plot([], [], plots.marker_of(family), color=colour, linestyle="-")
        xs, x_bars = _bars([a.time_ms for a in members], float)
        ys, y_bars = _bars([a.errors[key] for a in members], transform)
        axis.errorbar(xs, ys, y_bars, x_bars, color=colour, linewidth=1, elinewidth=1, capsize=2)
        for x, y, a in zip(xs, ys, members, strict=True):
            fill = colour if key in a.fronts else "white"
            axis.plot(x, y, plots.marker_of(family), color=colour, markerfacecolor=fill, zorder=3)
            axis.annotate("" if a.is_equal else " ≠", (x, y), color=plots.SOFT, va="bottom")
    axis.axvline(scene.yardstick.median_ms, **plots.LINES["kernel"])
    return lines


def _bars(estimates: Sequence[Estimate], transform: Any) -> tuple[list[float], list[list[float]]]:
    """Transformed values, and lengths of their bars below and above; 0 for an unknown end."""
    values = [transform(estimate.value) for estimate in estimates]
    below, above = [], []
    for value, estimate in zip(values, estimates, strict=True):
        ends = sorted(transform(end) for end in estimate.interval if end is not None)
        below.append(max(value - ends[0], 0.0) if len(ends) == 2 else 0.0)
        above.append(max(ends[1] - value, 0.0) if len(ends) == 2 else 0.0)
    return values, [below, above]
