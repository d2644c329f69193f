"""Colours, marks and lines of the plots: an algorithm looks alike in all of them."""

from __future__ import annotations

from typing import Any

__all__ = ["BEATEN", "LINES", "MARKS", "SOFT", "colour_of", "plain_ticks", "style"]

_INK = "#1e2022"
#: Of labels and whatever else stands back.
SOFT = "#5a5f63"
#: Of points that another beats in time and error.
BEATEN = "#b5b5b0"
_LINE = "#dedbd3"
# Okabe and Ito's colours, told apart with any colour vision.
_COLOURS = {
    "template": "#0072b2",
    "wang2024": "#d55e00",
    "gu2020": "#009e73",
    "li2012": "#cc79a7",
    "layered": "#6a51a3",
    "yardstick": "#5a5f63",
}
_OTHERS = ("#56b4e9", "#e69f00", "#8c6d31")
#: Mark of each algorithm.
MARKS = {
    "template": "o",
    "wang2024": "s",
    "gu2020": "^",
    "li2012": "D",
    "layered": "P",
    "yardstick": "x",
}
#: Lines across a panel.
LINES: dict[str, dict[str, Any]] = {
    "front": {"color": _INK, "linewidth": 0.8, "alpha": 0.35, "zorder": 1},
    "yardstick": {"color": SOFT, "linewidth": 1.0, "linestyle": ":", "zorder": 1},
    "floor": {"color": SOFT, "linewidth": 1.0, "linestyle": "--", "zorder": 1},
}


def colour_of(name: str) -> str:
    """The colour of an algorithm, whatever its options."""
    algorithm = name.partition(":")[0]
    return _COLOURS.get(algorithm, _OTHERS[sum(algorithm.encode()) % len(_OTHERS)])


def style(axis: Any, title: str, x_label: str, y_label: str) -> None:
    """Title, labels, a light grid, no box."""
    axis.set_title(title, loc="left", fontsize=10.5, color=_INK)
    axis.set_xlabel(x_label, fontsize=9, color=SOFT)
    axis.set_ylabel(y_label, fontsize=9, color=SOFT)
    axis.grid(True, which="major", color=_LINE, linewidth=0.6)
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=8, colors=SOFT, which="both", length=2.5)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axis.spines[side].set_color(_LINE)


def plain_ticks(axis: Any) -> None:
    """0.3, 1, 100 rather than powers of ten; between them only where there is just one or none."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    shown = FuncFormatter(lambda value, _: _short(value))
    for side in (axis.xaxis, axis.yaxis):
        if side.get_scale() == "linear":
            continue
        low, high = sorted(side.get_view_interval())
        side.set_major_formatter(shown)
        within_a_decade = side.get_scale() == "log" and high < 10 * low
        side.set_minor_formatter(shown if within_a_decade else NullFormatter())


def _short(value: float) -> str:
    for unit, size in (("M", 1e6), ("k", 1e3)):
        if value >= size:
            return f"{value / size:g} {unit}"
    return f"{value:g}"
