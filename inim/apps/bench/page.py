"""The report of a bench: `bench.json`, `bench.md`, `bench.html` and the plots."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from msgspec.structs import asdict

from inim.apps.bench.document import BenchDocument, BenchScene, BenchScore, Scores
from inim.report import plots
from inim.report.labels import MISSING, number, per_cent
from inim.report.study import PagePart, StudyPage, Table
from inim.system.document import decode, encode

#: The label of a time axis.
TIME = "milliseconds per EIA"
# Below this share of wrong pixels the axis is linear, so that zero has a place on it.
_LINEAR_SHARE = 1e-3
#: Parts of the page, from the document as it is read from `bench.json`.
PartsOf = Callable[[BenchDocument], Sequence[PagePart]]


def scene_parts(data: BenchDocument) -> list[PagePart]:
    """Time against error, where methods were timed on a scene."""
    if data.scene is None:
        return []
    intro = (
        "Points at the bottom left are best. Pareto-optimal algorithms are coloured. For "
        "each grey algorithm, another is at least as fast and as good. The scored EIA is the timed "
        "EIA, in display-ready 8-bit sRGB. The whisker of a point ends at the fastest run."
    )
    tables = [_scene_table(data.scene)]
    return [
        PagePart("scene", "Time against error", intro, tables, "pareto", _draw_scene(data.scene))
    ]


def write_bench(data: BenchDocument, folder: Path, parts_of: PartsOf = scene_parts) -> None:
    """Write all forms of a bench into a folder, `bench.json` last: it marks a whole one.

    * `data`: its `files` are listed here.
    * `folder`: empty; the plots are written first, for the page shows them.
    """
    data = decode(encode(data), BenchDocument)  # as it is read: infinite values are null
    bench_page(data, parts_of(data)).write(data, folder, "bench")


def bench_page(data: BenchDocument, parts: Sequence[PagePart]) -> StudyPage:
    """The page of a bench as it is read from `bench.json`."""
    facts = [_thread_words(data), data.backend.device, f"inim {data.inim_version}"]
    if data.scene is not None:
        facts.insert(0, f"Display {data.scene.display.parameters.name}")
    return StudyPage("Conditions", facts, _remarks(data, parts), parts, data.warnings)


def milliseconds(value: float | None) -> str:
    """Format a time with about three significant digits, the reproducible ones."""
    if value is None:
        return MISSING
    return number(value, 3 if value < 1 else 2 if value < 100 else 0 if value >= 1000 else 1)


def times(value: float | None) -> str:
    """A ratio."""
    return MISSING if value is None else f"{number(value, 2 if value < 100 else 0)} ×"


def _rate(value: float | None) -> str:
    return MISSING if value is None else number(value, 1 if value < 100 else 0)


#: Columns with the times of an algorithm, by field of `BenchAlgorithm`.
TIME_COLUMNS: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "ms per EIA": lambda timing: milliseconds(timing["median_ms"]),
    "fastest": lambda timing: milliseconds(timing["min_ms"]),
    "spread": lambda timing: f"± {per_cent(timing['spread'], 1)}",
    "runs": lambda timing: str(timing["runs"]),
    "Mpx/s": lambda timing: _rate(timing["mpx_per_s"]),
    "kernel times": lambda timing: times(timing["ratio"]),
    "by fastest": lambda timing: times(timing["ratio_min"]),
}


def _time_cells(timing: Mapping[str, Any]) -> list[str]:
    return [cell_of(timing) for cell_of in TIME_COLUMNS.values()]


def _scene_table(scene: BenchScene) -> Table:
    """Times and errors of all algorithms, of the reference kernel and of the noise floor."""
    heads = [
        "algorithm", *TIME_COLUMNS, "prepare s", "cold s", "wrong source", "holes",
        *(score.label for score in scene.scores), "front",
    ]  # fmt: skip
    rows = [
        [
            a.name,
            *_time_cells(asdict(a)),
            number(a.prepare_s, 3),
            number(a.cold_s, 2),
            per_cent(a.wrong_source, 3),
            per_cent(a.hole_fraction, 2),
            *_score_cells(a.scores, scene.scores),
            "yes" if a.pareto else "no",
        ]
        for a in scene.algorithms
    ]
    unit = {"mpx_per_s": None, "ratio": 1.0, "ratio_min": 1.0}
    kernel = _time_cells(asdict(scene.yardstick) | unit)
    rows.append(["reference kernel", *kernel, *[MISSING] * (len(heads) - 1 - len(kernel))])
    floor = _score_cells(scene.noise_floor, scene.scores)
    rows.append(["noise floor", *[MISSING] * (len(heads) - 2 - len(floor)), *floor, MISSING])
    return Table("Time against error, medians", heads, rows)


def _score_cells(values: Scores, scores: Sequence[BenchScore]) -> list[str]:
    """One cell for each of the scores; a missing one was not measured, a null one is infinite."""
    cells = []
    for score in scores:
        is_infinite = score.best is None and values.get(score.key, 0.0) is None
        value = math.inf if is_infinite else values.get(score.key)
        cells.append(number(value, 0 if is_infinite else score.digits))
    return cells


def _thread_words(data: BenchDocument) -> str:
    """The number of threads with its noun."""
    return f"{data.threads} thread{'s' * (data.threads != 1)}"


def _remarks(data: BenchDocument, parts: Sequence[PagePart]) -> list[str]:
    """Conditions, in sentences."""
    slow = [a.name for a in data.scene.algorithms if a.slow] if data.scene is not None else []
    lines = [
        f"{_thread_words(data)}, {data.backend.device}; load average "
        f"{number(data.load.start, 2)} at the start, {number(data.load.end, 2)} at the end, on "
        f"{data.load.cores or MISSING} cores.",
        f"Medians of {data.rounds.runs} runs after {data.rounds.warmups} warm-ups, alternating "
        "with the reference kernel: one 4-byte gather per display pixel where its ray meets the "
        "central depth plane. A kernel time is the time of that kernel. Spread: half the distance "
        "between the quartiles.",
    ]
    if slow:
        lines.append(f"Slow, therefore timed in fewer runs: {', '.join(slow)}.")
    lines += [line for part in parts for line in part.remarks]
    return [*lines, *data.notes]


def _draw_scene(scene: BenchScene) -> Any:
    """Small multiples over one time axis: wrong sources, then the scores that are plotted."""
    plotted = [score for score in scene.scores if score.plotted]
    figure, axes = plots.new_figure(1 + len(plotted), 4.6, sharex=True)
    axes[0].set_xscale("log")  # of all of them
    title, label = "Wrong source", "panel pixels with a wrong source, %"
    names = [_panel(axes[0], scene, "wrong_source", lambda share: 100 * share)]
    plots.style(axes[0], title, f"{TIME} (↙ better)", label)
    for axis, score in zip(axes[1:], plotted, strict=True):
        names.append(_score_panel(axis, scene, score))
    linear = 100 * _LINEAR_SHARE  # below, so that zero has a place on the axis
    axes[0].set_yscale("symlog", linthresh=linear, linscale=0.5)
    axes[0].set_ylim(-0.3 * linear, max(10 * linear, 2.5 * axes[0].get_ylim()[1]))
    for axis in axes:
        plots.plain_ticks(axis)
    figure.canvas.draw()  # now all has its place, and names can be set apart in it
    for axis, texts in zip(axes, names, strict=True):
        plots.set_apart(axis, texts)
    return figure


def _score_panel(axis: Any, scene: BenchScene, score: BenchScore) -> list[plots.Name]:
    """Draw a panel with its better end at the bottom, and return the names to place."""
    key, label, best = score.key, score.label, score.best
    is_higher = score.better == "higher"
    errors = [algorithm.result(key) for algorithm in scene.algorithms]
    transform: Callable[[float], float] = float
    if is_higher and best is not None:
        transform, label = (lambda value: best - value), f"{best:g} − {label}"
        if all(value is None or value < best for value in errors):
            axis.set_yscale("log")
    elif is_higher:
        axis.invert_yaxis()
    plots.style(axis, score.title, f"{TIME} (↙ better)", label)
    return _panel(axis, scene, key, transform, is_higher)


def _panel(
    axis: Any,
    scene: BenchScene,
    key: str,
    transform: Callable[[float], float],
    is_higher_better: bool = False,
) -> list[plots.Name]:
    """Draw one panel, and return the names to place."""
    sign = -1 if is_higher_better else 1
    points = [
        plots.TimedPoint(a.name, a.median_ms, sign * value, transform(value), a.min_ms)
        for a in scene.algorithms
        if (value := a.result(key)) is not None
    ]
    names = plots.draw_time_against_error(axis, points)
    axis.axvline(scene.yardstick.median_ms, **plots.LINES["kernel"])
    plots.across(axis, "reference kernel", x=scene.yardstick.median_ms)
    floor = scene.noise_floor.get(key)
    if floor is not None:
        axis.axhline(transform(floor), **plots.LINES["floor"])
        plots.across(axis, "noise floor", y=transform(floor))
    axis.margins(0.12, 0.12)
    return names
