"""Plots in figures for papers, of scores with intervals and of run time, and their legend."""

from __future__ import annotations

import math
import textwrap
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from inim.report import plots
from inim.report.labels import is_number, short_names
from inim.report.score_table import ScoreTable
from inim.report.sections.time_against_error import times_of
from inim.scores.metrics import HEADLINE, HEADLINE_WORDS

if TYPE_CHECKING:
    from inim.report import Report

FONT = 7
#: Inches between lines of this font, and of a wide letter.
LINE, LETTER = 0.13, 0.058
_PLOT_SHARE = 0.42  # height of a plot, of the figure's width
_LEAST_PLOT = 1.75  # inches that the labels of an axis take
_LEFT = 0.8  # inches left of a plot, for labels
_HEADLINE_LINES = HEADLINE_WORDS.replace(", ", ",\n")
# Algorithms that differ in options only have the same colour and marker, filled in turn.
_FILLS = ("full", "none", "left", "right", "top", "bottom")
#: Options of matplotlib by algorithm.
Styles = Mapping[str, Mapping[str, Any]]
#: Height in inches and drawer of a part of a figure.
Part = tuple[float, Callable[[Any], None]]


def wrapped(words: str, width: float) -> str:
    """Words in lines of a width in inches; an algorithm's name breaks at its options."""
    letters = max(int(width / LETTER), 1)
    spaced = words if " " in words else words.replace(":", ": ")
    lines = textwrap.wrap(spaced, letters, break_long_words=False, break_on_hyphens=False)
    return "\n".join(lines if spaced == words else (line.replace(": ", ":") for line in lines))


def size_of(part: Any) -> tuple[float, float]:
    """Width and height of a part in inches."""
    return part.bbox.width / part.figure.dpi, part.bbox.height / part.figure.dpi


def styles_of(algorithms: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Label, colour, marker and fill of each algorithm, as options of matplotlib."""
    families: Counter[str] = Counter()
    styles = {}
    for name, label in short_names(list(dict.fromkeys(algorithms))).items():
        family = name.partition(":")[0]
        styles[name] = {
            "label": label.replace("$", r"\$"),  # a dollar sign would begin a formula
            "color": plots.colour_of(name),
            "marker": plots.marker_of(name),
            "fillstyle": _FILLS[families[family] % len(_FILLS)],
        }
        families[family] += 1
    return styles


def legend(styles: Styles, width: float) -> Part:
    """Height in inches and drawer of the legend of all plots."""
    from matplotlib.lines import Line2D

    longest = max(len(style["label"]) for style in styles.values())
    columns = min(max(int(width / (LETTER * (longest + 5))), 1), len(styles))
    marks = [Line2D([], [], linestyle="", markersize=4, **style) for style in styles.values()]
    options = {"loc": "center", "ncols": columns, "fontsize": FONT, "frameon": False}
    rows = math.ceil(len(styles) / columns)
    return (rows + 1) * LINE, lambda part: part.legend(handles=marks, **options)


def plot_height(width: float) -> float:
    """Height of a plot in inches, in a figure of a width in inches."""
    return max(_PLOT_SHARE * width, _LEAST_PLOT)


def _plot_axis(part: Any, tick_lines: int = 1) -> Any:
    """Axis with margins for its labels."""
    width, height = size_of(part)
    margins = {"left": min(_LEFT / width, 0.9), "right": 0.97, "top": 1 - LINE / height}
    margins["bottom"] = (0.3 + tick_lines * LINE) / height
    return part.subplots(gridspec_kw=margins)


def scores(
    relics: Mapping[str, Report],
    viewpoints: Mapping[str, str],
    styles: Styles,
    width: float,
) -> Part:
    """Height in inches and drawer of the plot of scores.

    It has all viewpoints of a report, or the views shown of several relics.
    """
    table, is_single = ScoreTable.of([*relics.values()], [HEADLINE]), len(relics) == 1
    shown_rows = [
        row
        for row in table.rows
        if is_number(row[HEADLINE]) and (is_single or row["viewpoint"] == viewpoints[row["relic"]])
    ]
    key, label = "viewpoint", _HEADLINE_LINES
    groups = next(iter(relics.values())).data.viewpoint_names
    if not is_single:
        names = ", ".join(dict.fromkeys(viewpoints.values()))
        key, groups, label = "relic", [*relics], f"{label},\n{names} view"
    has_intervals = any(is_number(row[f"{HEADLINE}_low"]) for row in shown_rows)
    ticks = [wrapped(group, 0.95 * (width - _LEFT) / len(groups)) for group in groups]
    tick_lines = max(tick.count("\n") for tick in ticks) + 1

    def draw(part: Any) -> None:
        axis = _plot_axis(part, tick_lines)
        for n, (name, style) in enumerate(styles.items()):
            rows = [row for row in shown_rows if row["algorithm"] == name]
            if not rows:
                continue
            places = [groups.index(row[key]) for row in rows]
            offset = (n - (len(styles) - 1) / 2) * 0.6 / len(styles)
            values = np.array([row[HEADLINE] for row in rows])
            ends = [[row[f"{HEADLINE}_{end}"] for row in rows] for end in ("low", "high")]
            low, high = (np.array([math.nan if e is None else e for e in side]) for side in ends)
            axis.errorbar(
                np.array(places) + offset, values, [values - low, high - values],
                linestyle="", markersize=4, capsize=2, linewidth=0.8, **style,
            )  # fmt: skip
        words = f"{key}, with 95 % intervals" if has_intervals else key
        plots.style(axis, "", words, label, FONT)
        axis.set_xlim(-0.5, len(groups) - 0.5)
        axis.set_xticks(range(len(groups)), ticks)

    return plot_height(width) + (tick_lines - 1) * LINE, draw


def draw_time(report: Report, algorithms: Sequence[str], styles: Styles, part: Any) -> None:
    """Plot run time against the error, by the mean score of all viewpoints."""
    times, unit = times_of(report.data)
    axis = _plot_axis(part)
    points = [
        plots.TimedPoint(name, times[name], 1 - score, 1 - score)
        for name in algorithms
        if name in times and (score := report.data.mean(name, HEADLINE)) is not None
    ]
    for point in points:
        style = styles[point.name]
        axis.plot(point.time, point.value, linestyle="", markersize=4, clip_on=False, **style)
    plots.draw_front(axis, points)
    names = report.data.viewpoint_names
    views = f"mean of {len(names)} views" if len(names) > 1 else f"{names[0]} view"
    plots.style(axis, "", f"{unit} (↙ better)", f"1 − {_HEADLINE_LINES},\n{views}", FONT)
    axis.set_xscale("log")
    axis.minorticks_off()
    axis.margins(0.1)
    if points:  # two or more ticks, none at an end
        low, high = min(p.time for p in points) / 2.5, max(p.time for p in points) * 2.5
        digits = (1, 2, 5) if high < 150 * low else (1,)
        ticks = [digit * 10.0**power for power in range(-9, 10) for digit in digits]
        labelled = [tick for tick in ticks if 1.1 * low <= tick <= high / 1.1]
        axis.set_xticks(labelled, [f"{tick:g}" for tick in labelled])
        axis.set_xlim(low, high)
