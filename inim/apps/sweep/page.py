"""The page of a sweep: displays by relic, scores by scene, display and algorithm, and failures.

Scores of different scenes are never averaged into one rank.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from inim.apps.sweep.document import SweepDocument
from inim.apps.sweep.table import CRITERION, DEPTH, DEPTH_SHARE, TABLE, VARIED_COLUMNS
from inim.report import plots
from inim.report.labels import is_number, mm, number
from inim.report.study import PagePart, StudyPage, Table
from inim.scores.metrics import HEADLINE, HEADLINE_TO_SCENE, MAIN, all_metrics

PAGE, MARKER = "sweep.html", "sweep.json"
_PLOT = "depth"
#: Files in the folder of a sweep; the first marks a whole one.
FILES = (MARKER, TABLE, PAGE, "sweep.md", f"{_PLOT}.svg", f"{_PLOT}.png")

_MOST_ACROSS = 3
_PANEL_HEIGHT = 4.0  # inches
_SCORES = (
    "Each number is a mean over the viewpoints. The SSIM on the relic to the reference view "
    "measures the algorithm alone. The SSIM on the relic to the ground truth includes the loss of "
    "the display; the reference's is the best possible. Do not compare scores of different scenes."
)
_DISPLAYS = (
    "The best algorithm on each display, by the mean SSIM on the relic to the reference. The "
    "resolution of views follows the number of lenses, so each display is compared at its own "
    "resolution. The depth is that of the relic on the display, and its share of the relic's own "
    "depth at the same width. The ground truth is the relic compressed into the display's depth "
    "range, so a display with less depth has an easier task. In the plot, a display is coloured "
    "if no other has both a higher score and more depth."
)
_DEPTHS_DIFFER = (
    "The displays show {relic} with different depths, {low} to {high}. Compare scores at equal "
    "depth, or see the plot of score against depth."
)

Row = Mapping[str, Any]

#: Columns of the main score on the relic of the reference, and of the truth against itself.
REFERENCES = (f"reference_{HEADLINE_TO_SCENE}", f"noise_floor_{HEADLINE_TO_SCENE}")


@dataclass(frozen=True)
class Result:
    """One algorithm on one scene, display and set of settings: means over its viewpoints.

    `scores` are by column of the table; None where a viewpoint lacks it.
    """

    scene: str
    display: str
    settings: str
    algorithm: str
    failed: bool
    scores: dict[str, float | None]

    @property
    def place(self) -> str:
        """The display, with the settings that vary."""
        return f"{self.display} ({self.settings})" if self.settings else self.display


def write_page(data: SweepDocument, rows: Sequence[Row], folder: Path) -> SweepDocument:
    """Write the page in all forms into a folder, `sweep.json` last."""
    sweep_page(data, rows).write(data, folder, "sweep")
    return data


def sweep_page(data: SweepDocument, rows: Sequence[Row]) -> StudyPage:
    """The page of the rows of a table."""
    results = results_of(rows)
    rankings = rank_displays(results)
    judged = any(row.get(CRITERION) is not None for row in rows)
    verdict = "failed" if not data.passed else "passed" if judged else "ran clean; no criteria set"
    facts = [
        f"{count} {word}{'s' * (count != 1)}"
        for word in ("scene", "display", "algorithm")
        for count in [len({getattr(result, word) for result in results})]
    ]
    finished = sum(not result.failed for result in results)
    remarks = [
        f"Verdict: {verdict}. {finished} of {len(results)} results, {data.rows} rows.",
        f"All rows are in {TABLE}, in this page's folder.",
    ]
    figure = _depth_plot(rankings)
    return StudyPage(
        "Summary",
        [*facts, f"inim {data.inim_version}"],
        remarks,
        [
            PagePart(
                "displays",
                "Best display for a relic",
                _DISPLAYS,
                [_display_table(rankings)],
                _PLOT if figure is not None else "",
                figure,
            ),
            PagePart("scores", "Scores", _SCORES, [_score_table(results)]),
        ],
        [*failures(rows), *filter(None, map(_depth_notice, rankings.values()))],
    )


def results_of(rows: Sequence[Row]) -> list[Result]:
    """The rows by result, in the table's order."""
    varied = varied_settings(rows)
    own = [key for m in all_metrics() for key in (m.key, m.on_relic_key)]
    own += [MAIN.to_reference_key, HEADLINE, *REFERENCES, "seconds", "yardsticks"]
    groups: dict[tuple[str, str, str, str], list[Row]] = {}
    for row in rows:
        settings = settings_of(row, varied)
        key = (str(row["scene"]), str(row["display"]), settings, str(row["algorithm"]))
        groups.setdefault(key, []).append(row)
    return [
        Result(
            *key,
            any(row["status"] != "ok" for row in group),
            {name: mean(row.get(name) for row in group) for name in (*own, DEPTH, DEPTH_SHARE)},
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
    varied = {name for (_, _, name), different in values.items() if len(different) > 1}
    return [name for name in VARIED_COLUMNS if name in varied]


def settings_of(row: Row, varied: Iterable[str]) -> str:
    """Varied settings of a row, as text; empty if none vary."""
    return ", ".join(f"{name} = {row.get(name)}" for name in varied)


def mean(values: Iterable[Any]) -> float | None:
    """Arithmetic mean; None for an empty list, or if a value is missing or not finite."""
    numbers = list(values)
    if not numbers or not all(is_number(v) and math.isfinite(v) for v in numbers):
        return None
    return math.fsum(numbers) / len(numbers)


def failures(rows: Sequence[Row]) -> list[str]:
    """Each failed unit and its error, and each algorithm's failed checks."""
    varied = varied_settings(rows)
    reasons: dict[str, None] = {}
    for row in rows:
        is_ok = row["status"] == "ok"
        words = [row["scene"], row["display"], settings_of(row, varied)]
        error = row.get("failed_checks") if is_ok else row["error"]
        if error:
            label = " · ".join(filter(None, [*words, row["algorithm"] if is_ok else ""]))
            reasons[f"{label}: {error}"] = None
    return list(reasons)


def rank_displays(results: Sequence[Result]) -> dict[str, list[Result]]:
    """The best algorithm's result on each display, by scene, in falling order of its score.

    The best algorithm has the highest SSIM to the reference; displays are ordered by the SSIM to
    the ground truth.
    """
    best: dict[tuple[str, str], Result] = {}
    for result in results:
        key, score = (result.scene, result.place), result.scores[HEADLINE]
        if score is None or result.failed:
            continue
        if key not in best or score > (best[key].scores[HEADLINE] or -math.inf):
            best[key] = result
    rankings: dict[str, list[Result]] = {}
    for result in sorted(best.values(), key=lambda r: -(r.scores[HEADLINE_TO_SCENE] or -math.inf)):
        rankings.setdefault(result.scene, []).append(result)
    return {scene: rankings[scene] for scene, _ in best if scene in rankings}


def _display_table(rankings: Mapping[str, Sequence[Result]]) -> Table:
    others = [metric for metric in all_metrics() if metric.key != MAIN.key]
    columns = [(HEADLINE_TO_SCENE, MAIN.digits), (REFERENCES[0], MAIN.digits)]
    columns += [(DEPTH, 1), (DEPTH_SHARE, 2)]
    columns += [(m.on_relic_key if m.has_relic_score else m.key, m.digits) for m in others]
    heads = [
        "Relic",
        "Display",
        "Best algorithm on it",
        f"{MAIN.label} on the relic to ground truth",
        "Its reference",
        "Depth, mm",
        "Share of its own depth",
        *(metric.label for metric in others),
    ]
    rows = [
        [r.scene, r.place, r.algorithm, *(number(r.scores[key], n) for key, n in columns)]
        for ranking in rankings.values()
        for r in ranking
    ]
    return Table("Displays by relic, the highest score first", heads, rows)


def _score_table(results: Sequence[Result]) -> Table:
    timed = all(r.failed or r.scores["yardsticks"] is not None for r in results)
    columns = {
        f"{MAIN.label} on the relic to reference": HEADLINE,
        f"{MAIN.label} on the relic to ground truth": HEADLINE_TO_SCENE,
        "Its reference": REFERENCES[0],
        "Noise floor": REFERENCES[1],
        f"{MAIN.label} to reference": MAIN.to_reference_key,
    }
    heads = ["Scene", "Display", "Algorithm", *columns, "Kernel times" if timed else "Seconds"]
    rows = [
        [
            r.scene,
            r.place,
            r.algorithm,
            *(number(r.scores[key], MAIN.digits) for key in columns.values()),
            number(r.scores["yardsticks" if timed else "seconds"], 3),
        ]
        for r in results
        if not r.failed
    ]
    return Table("Scores by scene, display and algorithm", heads, rows)


def _depth_notice(ranking: Sequence[Result]) -> str:
    """Notice if the displays show a relic with depths that differ by more than a tenth."""
    depths = sorted(depth for depth in (r.scores[DEPTH] for r in ranking) if depth is not None)
    if not depths or depths[-1] <= 1.1 * depths[0]:
        return ""
    return _DEPTHS_DIFFER.format(relic=ranking[0].scene, low=mm(depths[0]), high=mm(depths[-1]))


def depth_front(ranking: Sequence[Result]) -> tuple[dict[str, tuple[float, float]], set[str]]:
    """Depth and score of each display of a relic, and the displays that no other surpasses."""
    points = {}
    for result in ranking:
        depth, score = result.scores[DEPTH], result.scores[HEADLINE_TO_SCENE]
        if depth is not None and score is not None:
            points[result.place] = (depth, score)
    return points, plots.on_front({name: (-x, -y) for name, (x, y) in points.items()})


def _depth_plot(rankings: Mapping[str, Sequence[Result]]) -> Any:
    """Score against depth, a panel for each relic whose depths differ; None without any."""
    panels = {scene: depth_front(r) for scene, r in rankings.items() if _depth_notice(r)}
    if not panels:
        return None
    columns = min(_MOST_ACROSS, len(panels))
    rows = -(-len(panels) // columns)
    figure, axes = plots.new_figure(columns, _PANEL_HEIGHT * rows, rows)
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    for axis, (scene, (points, front)) in zip(axes, panels.items(), strict=False):
        for name, point in points.items():
            colour = plots.BLUE if name in front else plots.SOFT
            axis.plot(*point, "o", color=colour, markersize=5, clip_on=False)
        plots.style(
            axis, scene, "depth of the relic on the display, mm", f"{MAIN.label}, ground truth"
        )
        axis.margins(0.24, 0.14)
    figure.canvas.draw()  # the layout is final, so names can be placed
    for axis, (points, front) in zip(axes, panels.values(), strict=False):
        names = [plots.Name(n, *points[n], plots.BLUE, 7) for n in points if n in front]
        plots.set_apart(axis, names)
    return figure
