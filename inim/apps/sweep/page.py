"""The page of a sweep: scores by scene and algorithm, displays by relic, failures, costs.

Scores of different scenes are never averaged into one rank: a scene's row is compared with itself
only, and a figure for several scenes is the mean of each one's loss against its own reference.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple

from inim.apps.sweep.document import SweepTable
from inim.display.settings import DISPLAY_KEYS, Settings
from inim.report import plots
from inim.report.labels import MISSING, is_number, mm, number
from inim.report.page import (
    Section,
    badge,
    bullets,
    document_page,
    element,
    folded,
    how_to_reproduce,
    lead,
    plot,
    table,
    text,
    text_table,
)
from inim.scores.metrics import HEADLINE, HEADLINE_TO_SCENE, HEADLINE_WORDS, MAIN, all_metrics
from inim.system.document import write_text

PAGE = "sweep.html"

_MOST_ACROSS = 3
_PANEL_HEIGHT = 4.0  # inches
_SCORES = (
    "Each number is a mean over the viewpoints. The large number is the SSIM on the relic to the "
    "reference view. It measures the algorithm alone. The small numbers are the SSIM on the relic "
    "to the ground truth, which includes the loss of the display, and the SSIM of the whole image "
    "to the reference view. Do not compare rows, because scores depend on the scene."
)
_PARETO = (
    "A point is the mean over the scenes. Points at the bottom left are best. Pareto-optimal "
    "algorithms are coloured. For each grey algorithm, another is at least as fast and as good. "
)
_UNITS = {"yardsticks": "kernel times", "seconds": "seconds"}
_TIMES = {
    "yardsticks": "Times are multiples of the reference kernel's time in the same process.",
    "seconds": "Each time was measured once, without warm-up, while other work ran. For times "
    "relative to the reference kernel, put time = true into the study.",
}
_BEST = (
    "Mean SSIM on the relic to the ground truth of the best algorithm on each display, next to "
    "the reference. The resolution of views follows the number of lenses, so each display is "
    "compared at its own resolution. FLIP weights differences by visibility. The depth is that of "
    "the relic on the display, in millimetres and as a share of its own depth at the same width. "
    "The ground truth is the relic compressed into the display's depth range, so a display with "
    "less depth has an easier task. A display is bold if no other has both a higher score and "
    "more depth."
)
_DEPTHS_DIFFER = (
    "The displays show {relic} with different depths, {low} to {high}. Compare scores at equal "
    "depth, or see the plot of score against depth."
)
_DEPTH_PLOT = (
    "Displays at the top right are best: they have high scores and much depth. A display is "
    "coloured if no other has both a higher score and more depth."
)
_HEAT = (
    "SSIM on the relic to the ground truth of the best algorithm, and the relic's depth on the "
    "display, for two listed parameters. Further parameters have a panel for each of their values."
)
_MOST_HEAT_PANELS = 24
# Tables of scores that are not folded.
_MOST_MATRICES = 6
_QUERY = """SELECT scene, display, algorithm, avg(ssim_on_relic_to_reference) AS ssim
FROM 'sweep.parquet' WHERE status = 'ok'
GROUP BY ALL ORDER BY scene, display, ssim DESC;"""


def write_page(path: Path, rows: Sequence[Mapping[str, Any]], about: SweepTable) -> None:
    """Write the page, whole or not at all; parameters as of `render_sweep`."""
    write_text(path, render_sweep(rows, about))


def render_sweep(rows: Sequence[Mapping[str, Any]], about: SweepTable) -> str:
    """The whole page."""
    results = results_of(rows)
    counts = [
        f"{len(names_of(results, field))} {field}{'s' * (len(names_of(results, field)) != 1)}"
        for field in ("scene", "display", "algorithm")
    ]
    passed = all(row["status"] == "ok" and row.get("passed") for row in rows)
    judged = any(row.get(CRITERION) is not None for row in rows)
    finished_count = sum(not result.failed for result in results)
    words = f"{finished_count} of {len(results)} results, {len(rows)} rows"
    query = element("p", "All rows are in sweep.parquet, in this page's folder; for example:")
    query += element("pre", element("code", text(_QUERY)), tabindex=0)
    return document_page(
        about,
        "sweep.parquet",
        [text(" × ".join(counts)), f"inim {text(about.inim_version)}"],
        [
            Section("failures", "Failures", failures(rows)),
            Section("displays", "Best display for a relic", best_displays(results)),
            Section("parameters", "Scores by two parameters", _heat_maps(results)),
            Section("scores", "Scores", _matrices(results)),
            Section("pareto", "Time against error", _pareto(results)),
            Section("cost", "Run time", cost_table(results)),
            how_to_reproduce(about, query),
        ],
        purpose="inim sweep",
        verdict_badge=badge(
            "failed" if not passed else "passed" if judged else "ran clean",
            text(words + "; no criteria set" * (passed and not judged)),
        ),
    )


def _matrices(results: Sequence[Result]) -> str:
    matrices = []
    for display in names_of(results, "display"):
        for settings in names_of(results, "settings"):
            own = [c for c in results if (c.display, c.settings) == (display, settings)]
            matrices += [matrix(display, settings, own)] if own else []
    rest = "".join(matrices[_MOST_MATRICES:])
    if rest:
        count = len(matrices) - _MOST_MATRICES
        rest = folded(text(f"{count} more displays and settings"), rest)
    return lead(_SCORES) + "".join(matrices[:_MOST_MATRICES]) + rest


def _pareto(results: Sequence[Result]) -> str:
    """A panel for each display; empty where no algorithm has a time and a score.

    A point is the mean over scenes, of the algorithms that have them all.
    """
    unit = time_column(results)
    panels = {display: _points(results, display, unit) for display in names_of(results, "display")}
    panels = {display: points for display, points in panels.items() if points}
    if not panels:
        return ""
    words = lead(_PARETO + _TIMES[unit])
    return words + plot(_draw_panels(panels, unit), "Time against error")


def time_column(results: Sequence[Result]) -> str:
    """Yardsticks where every result was timed in them; else seconds, taken once, cold."""
    finished = [c for c in results if not c.failed]
    timed = bool(finished) and all(c.scores["yardsticks"] is not None for c in finished)
    return "yardsticks" if timed else "seconds"


def _points(results: Sequence[Result], display: str, column: str) -> dict[str, tuple[float, float]]:
    """Mean time and mean of 1 − SSIM to the reference, by algorithm."""
    own = [c for c in results if c.display == display]
    points = {}
    for name in names_of(own, "algorithm"):
        runs = [c for c in own if c.algorithm == name and not c.failed]
        time = mean(c.scores[column] for c in runs)
        score = mean(c.scores[HEADLINE] for c in runs)
        if time is not None and score is not None and time > 0:
            points[name] = (time, 1 - score)
    return points


def _draw_panels(panels: Mapping[str, Mapping[str, tuple[float, float]]], unit: str) -> bytes:
    figure, axes = _panels(len(panels), sharex=True, sharey=True)
    panel_points = [
        (axis, display, points, plots.on_front(points))
        for axis, (display, points) in zip(axes, panels.items(), strict=False)
    ]
    for axis, display, points, front in panel_points:
        for name, point in points.items():
            plots.draw_point(axis, name, *point, name in front)
        plots.draw_front(axis, [points[name] for name in front])
        plots.style(axis, display, f"{_UNITS[unit]} per EIA (↙ better)", f"1 − {HEADLINE_WORDS}")
        axis.set_xscale("log")
        axis.margins(0.24, 0.14)
    for axis, *_ in panel_points:
        plots.plain_ticks(axis)
    figure.canvas.draw()  # the layout is final, so names can be placed
    for axis, _, points, front in panel_points:
        plots.set_apart(
            axis, [plots.point_name(name, *at, name in front) for name, at in points.items()]
        )
    return plots.svg(figure)


def matrix(display: str, settings: str, results: Sequence[Result]) -> str:
    """Main scores by scene and algorithm on one display, to the reference and the ground truth."""
    algorithms = names_of(results, "algorithm")
    heads = ["Scene", *algorithms, "Reference", "Noise floor"]
    rows = []
    for scene in names_of(results, "scene"):
        own = {c.algorithm: c for c in results if c.scene == scene}
        scores = (c.scores[HEADLINE] for c in own.values() if not c.failed)
        best = max((value for value in scores if value is not None), default=None)
        cells = [_cell(own.get(name), best) for name in algorithms]
        rows.append([text(scene), *cells, *_reference(list(own.values()))])
    caption = f"Display {display}, {settings}" if settings else f"Display {display}"
    return table(caption, [text(head) for head in heads], rows, "scores")


def _cell(result: Result | None, best: float | None) -> str:
    if result is None:
        return MISSING
    if result.failed:
        return element("a", "failed", href="#failures")
    value = result.scores[HEADLINE]
    is_best = value is not None and value == best
    small = (
        f"{'best · ' if is_best else ''}{number(result.scores[HEADLINE_TO_SCENE], 4)} ground truth"
    )
    whole = f"{number(result.scores[MAIN.to_reference_key], 4)} whole"
    number_text = element("span", text(number(value, 4)), class_="best" if is_best else None)
    return number_text + element("small", text(small)) + element("small", text(whole))


def _reference(results: Sequence[Result]) -> list[str]:
    """Reference against ground truth, and the noise floor; equal for all algorithms."""
    finished = [c for c in results if not c.failed]
    if not finished:
        return [MISSING, MISSING]
    return [text(number(finished[0].scores[k], 4)) for k in REFERENCES]


def best_displays(results: Sequence[Result]) -> str:
    """Displays of each relic, ordered by the best algorithm's SSIM to the ground truth."""
    if all(result.failed for result in results):
        return ""
    others = [metric for metric in all_metrics() if metric.key != MAIN.key]
    columns = [(HEADLINE_TO_SCENE, MAIN.digits), (REFERENCES[0], MAIN.digits)]
    columns += [(DEPTH, 1), (DEPTH_SHARE, 2)]
    columns += [(m.on_relic_key if m.has_relic_score else m.key, m.digits) for m in others]
    rows: list[list[str]] = []
    notices: list[str] = []
    rankings = {
        scene: _rank_results([c for c in results if c.scene == scene and not c.failed])
        for scene in names_of(results, "scene")
    }
    for scene, ranking in rankings.items():
        notices += _depth_notice(scene, ranking)
        front = plots.on_front(_depth_points(ranking))
        for place, result in enumerate(ranking):
            name = text(result.place)
            rows.append(
                [
                    text(scene) if place == 0 else "",
                    element("b", name) if result.place in front else name,
                    text(result.algorithm),
                    *(text(number(result.scores[key], digits)) for key, digits in columns),
                ]
            )
    heads = [
        "Relic",
        "Display",
        "Best algorithm on it",
        f"{MAIN.label} on the relic to ground truth",
        "Its reference",
        "Depth, mm",
        "Share of its own depth",
    ]
    heads += [metric.label for metric in others]
    listed = table(
        "Displays by relic, the highest score first", [text(h) for h in heads], rows, "numbers"
    )
    return bullets(notices, "cautions") + lead(_BEST) + listed + _depth_plot(rankings)


def _depth_notice(scene: str, ranking: Sequence[Result]) -> list[str]:
    """Notice if the displays show a relic with depths that differ by more than a tenth."""
    depths = sorted(depth for depth in (r.scores[DEPTH] for r in ranking) if depth is not None)
    if not depths or depths[-1] <= 1.1 * depths[0]:
        return []
    return [_DEPTHS_DIFFER.format(relic=scene, low=mm(depths[0]), high=mm(depths[-1]))]


def _depth_points(ranking: Sequence[Result]) -> dict[str, tuple[float, float]]:
    """Negative depth and negative score of each display: both are to be minimised."""
    points = {}
    for result in ranking:
        depth, score = result.scores[DEPTH], result.scores[HEADLINE_TO_SCENE]
        if depth is not None and score is not None:
            points[result.place] = (-depth, -score)
    return points


def _depth_plot(rankings: Mapping[str, Sequence[Result]]) -> str:
    """Score against depth, a panel for each relic; empty where no depths differ."""
    panels = {
        scene: _depth_points(ranking)
        for scene, ranking in rankings.items()
        if _depth_notice(scene, ranking)
    }
    if not panels:
        return ""
    figure, axes = _panels(len(panels))
    for axis, (scene, points) in zip(axes, panels.items(), strict=False):
        front = plots.on_front(points)
        for name, (depth, score) in points.items():
            colour = plots.BLUE if name in front else plots.SOFT
            axis.plot(-depth, -score, "o", color=colour, markersize=5, clip_on=False)
        plots.style(
            axis, scene, "depth of the relic on the display, mm", f"{MAIN.label}, ground truth"
        )
        axis.margins(0.24, 0.14)
    figure.canvas.draw()
    for axis, points in zip(axes, panels.values(), strict=False):
        front = plots.on_front(points)
        names = [
            plots.Name(re.sub(r"\w+ = ", "", name), -x, -y, plots.BLUE, 7)
            for name, (x, y) in points.items()
            if name in front
        ]
        plots.set_apart(axis, names)
    return lead(_DEPTH_PLOT) + plot(plots.svg(figure), "Score against depth")


def _panels(count: int, **options: Any) -> tuple[Any, Sequence[Any]]:
    """A figure with some panels; the rest of its last row is empty."""
    across = min(_MOST_ACROSS, count)
    down = -(-count // across)
    figure, axes = plots.new_figure(across, _PANEL_HEIGHT * down, down, **options)
    for axis in axes[count:]:
        axis.set_visible(False)
    return figure, axes


class _HeatMap(NamedTuple):
    """Results over two parameters, by the value of the one down and of the one across."""

    down: str
    across: str
    results: dict[tuple[float, float], Result]


def _heat_maps(results: Sequence[Result]) -> str:
    """Maps of the best score over the first two listed parameters; empty with fewer than two."""
    maps: dict[str, _HeatMap] = {}
    for scene in names_of(results, "scene"):
        for display in names_of(results, "display"):
            own = [c for c in results if (c.scene, c.display) == (scene, display) and not c.failed]
            maps |= _maps_of(f"{scene}, {display}", _rank_results(own))
    if not maps:
        return ""
    first_maps = dict(list(maps.items())[:_MOST_HEAT_PANELS])
    figure, axes = _panels(len(first_maps))
    scores = [
        result.scores[HEADLINE_TO_SCENE] or 0.0
        for heat_map in first_maps.values()
        for result in heat_map.results.values()
    ]
    for axis, (title, heat_map) in zip(axes, first_maps.items(), strict=False):
        _draw_heat_map(axis, title, heat_map, (min(scores), max(scores)))
    words = lead(_HEAT)
    if len(first_maps) < len(maps):
        words += lead(
            f"The first {len(first_maps)} of {len(maps)} panels; the table has all values."
        )
    return words + plot(plots.svg(figure), "Scores by two parameters")


def _maps_of(title: str, ranking: Sequence[Result]) -> dict[str, _HeatMap]:
    """Maps of one scene and display by title, one for each value of the further parameters."""
    varied = [name for name in VARIED_COLUMNS if len({r.values.get(name) for r in ranking}) > 1]
    numeric = [n for n in varied if all(isinstance(r.values[n], int | float) for r in ranking)]
    maps: dict[str, _HeatMap] = {}
    if len(numeric) < 2:
        return maps
    down, across, *_ = numeric
    others = [name for name in varied if name not in (down, across)]
    for result in sorted(ranking, key=lambda result: [_order(result.values[n]) for n in others]):
        values = result.values
        key = ", ".join([title, *(f"{name} = {values[name]}" for name in others)])
        heat_map = maps.setdefault(key, _HeatMap(down, across, {}))
        heat_map.results[values[down], values[across]] = result
    return maps


def _order(value: Any) -> tuple[str, Any]:
    """Sort key of a setting: a number, a word, or None."""
    return ("" if isinstance(value, int | float) else type(value).__name__, value)


def _draw_heat_map(axis: Any, title: str, heat_map: _HeatMap, limits: tuple[float, float]) -> None:
    rows, columns = (sorted(set(values)) for values in zip(*heat_map.results, strict=True))
    grid = [[math.nan] * len(columns) for _ in rows]
    for (down, across), result in heat_map.results.items():
        i, j = rows.index(down), columns.index(across)
        score, depth = result.scores[HEADLINE_TO_SCENE], result.scores[DEPTH]
        grid[i][j] = math.nan if score is None else score
        words = number(score, 3) + ("" if depth is None else f"\n{mm(depth)}")
        dark = score is None or score < (limits[0] + limits[1]) / 2
        axis.text(
            j,
            i,
            words,
            ha="center",
            va="center",
            fontsize=7.5,
            color="white" if dark else plots.INK,
        )
    axis.imshow(grid, origin="lower", aspect="auto", vmin=limits[0], vmax=limits[1])
    plots.style(axis, title, heat_map.across, heat_map.down)
    axis.grid(False)
    axis.set_xticks(range(len(columns)), [f"{value:g}" for value in columns])
    axis.set_yticks(range(len(rows)), [f"{value:g}" for value in rows])


def _rank_results(results: Sequence[Result]) -> list[Result]:
    """Best algorithm's result on each display, in falling order of SSIM to the ground truth."""
    best: dict[tuple[str, str], tuple[float, Result]] = {}
    for result in results:
        value = result.scores[HEADLINE]
        place = (result.display, result.settings)
        if value is not None and (place not in best or value > best[place][0]):
            best[place] = (value, result)
    best_results = [result for _, result in best.values()]
    return sorted(best_results, key=lambda result: -(result.scores[HEADLINE_TO_SCENE] or -math.inf))


def cost_table(results: Sequence[Result]) -> str:
    """Seconds a validation took, by scene and display."""
    displays = names_of(results, "display")
    rows = []
    for scene in names_of(results, "scene"):
        cells = []
        for display in displays:
            own = [c for c in results if (c.scene, c.display) == (scene, display)]
            spent = {c.settings: c.scores["unit_seconds"] for c in own}
            costs = [v for v in spent.values() if v is not None]
            cells.append(number(sum(costs), 1) if costs else MISSING)
        rows.append([scene, *cells])
    caption = "Seconds of the validations, including the effect of other load"
    return text_table(caption, ["Scene", *displays], rows, "numbers")


def failures(rows: Sequence[Mapping[str, Any]]) -> str:
    """Each unit that failed and why, and each check that did not pass; empty where all is well."""
    reasons: dict[tuple[str, str], None] = {}
    varied = varied_settings(rows)
    for row in rows:
        words = [row["scene"], row["display"], settings_of(row, varied)]
        if row["status"] == "ok":
            words.append(row["algorithm"])
        error = row["error"] if row["status"] != "ok" else row.get("failed_checks")
        if error:
            reasons[" · ".join(str(word) for word in words if word), str(error)] = None
    lines = [element("li", element("b", text(label)), " ", text(why)) for label, why in reasons]
    return element("ul", *lines, class_="failures") if lines else ""


Row = Mapping[str, Any]

#: Columns of the main score on the relic of the reference, and of the truth against itself.
REFERENCES = (f"reference_{HEADLINE_TO_SCENE}", f"noise_floor_{HEADLINE_TO_SCENE}")
_COSTS = ("seconds", "yardsticks", "unit_seconds")

#: Columns of the relic's depth on the display, in mm and as a share of its own depth.
DEPTH, DEPTH_SHARE = "relic_depth_mm", "relic_depth_share"
#: Column of the smallest headline score that passes.
CRITERION = "min_ssim_to_reference"

# Settings with columns of their own, or without one.
_OTHER_COLUMNS = (
    "title",
    "display",
    "algorithms",
    "cameras",
    "viewpoints",
    "lens_model",
    CRITERION,
)
#: Parameters and settings that tell rows of one scene, display, algorithm and viewpoint apart.
VARIED_COLUMNS = (
    *DISPLAY_KEYS,
    "lens_model",
    *(f.name for f in fields(Settings) if f.name not in (*DISPLAY_KEYS, *_OTHER_COLUMNS)),
)


@dataclass(frozen=True)
class Result:
    """One algorithm on one scene, display and set of settings: means over its viewpoints.

    * `scores`: by column of the table; None where a viewpoint lacks it.
    * `values`: parameters and settings that vary.
    """

    scene: str
    display: str
    settings: str
    algorithm: str
    failed: bool
    scores: dict[str, float | None]
    values: dict[str, Any] = field(default_factory=dict)

    @property
    def place(self) -> str:
        """The display, with the settings that vary."""
        return f"{self.display} ({self.settings})" if self.settings else self.display


def results_of(rows: Sequence[Row]) -> list[Result]:
    """The rows by result, in the table's order."""
    varied = varied_settings(rows)
    own = [key for m in all_metrics() for key in (m.key, m.on_relic_key)]
    columns = [*own, MAIN.to_reference_key, HEADLINE, *REFERENCES, *_COSTS, DEPTH, DEPTH_SHARE]
    groups: dict[tuple[str, str, str, str], list[Row]] = {}
    for row in rows:
        settings = settings_of(row, varied)
        key = (str(row["scene"]), str(row["display"]), settings, str(row["algorithm"]))
        groups.setdefault(key, []).append(row)
    return [
        Result(
            *key,
            any(row["status"] != "ok" for row in group),
            {name: mean(row.get(name) for row in group) for name in columns},
            {name: group[0].get(name) for name in varied},
        )
        for key, group in groups.items()
    ]


def varied_settings(rows: Sequence[Row]) -> list[str]:
    """Settings that the study varies: of which one scene and display has several values."""
    values: dict[tuple[Any, Any, str], set[Any]] = {}
    for row in rows:
        for name in VARIED_COLUMNS:
            if name in row:
                values.setdefault((row["scene"], row["display"], name), set()).add(row[name])
    return [
        n
        for n in VARIED_COLUMNS
        if any(len(v) > 1 for (_, _, name), v in values.items() if name == n)
    ]


def settings_of(row: Row, varied: Iterable[str]) -> str:
    """Varied settings of a row, as text; empty if none vary."""
    return ", ".join(f"{name} = {row.get(name)}" for name in varied)


def names_of(results: Sequence[Result], field: str) -> list[str]:
    """Values of a field, each once, in order."""
    return list(dict.fromkeys(getattr(result, field) for result in results))


def mean(values: Iterable[Any]) -> float | None:
    """Arithmetic mean; None for an empty list, or if a value is missing or not finite."""
    numbers = list(values)
    if not numbers or not all(is_number(v) and math.isfinite(v) for v in numbers):
        return None
    return math.fsum(numbers) / len(numbers)
