"""Colours, marks and lines of the plots: an algorithm looks alike in all of them."""

from __future__ import annotations

from typing import Any

from inim.errors import UsageError
from inim.generators import properties

__all__ = ["BEATEN", "LINES", "SOFT", "colour_of", "marker_of", "plain_ticks", "style"]

_INK = "#1e2022"
#: Of labels and whatever else stands back.
SOFT = "#5a5f63"
#: Of points that another beats in time and error.
BEATEN = "#b5b5b0"
_LINE = "#dedbd3"
_YARDSTICK = "yardstick"
# Of algorithms that state none. With our own algorithms' they are Okabe and Ito's colours, told
# apart with any colour vision.
_OTHERS = ("#56b4e9", "#e69f00", "#8c6d31")
#: Lines across a panel.
LINES: dict[str, dict[str, Any]] = {
    "front": {"color": _INK, "linewidth": 0.8, "alpha": 0.35, "zorder": 1},
    "yardstick": {"color": SOFT, "linewidth": 1.0, "linestyle": ":", "zorder": 1},
    "floor": {"color": SOFT, "linewidth": 1.0, "linestyle": "--", "zorder": 1},
}


def colour_of(name: str) -> str:
    """The colour of an algorithm, whatever its options: what it states itself, or one of three."""
    algorithm = name.partition(":")[0]
    if algorithm == _YARDSTICK:
        return SOFT
    return _stated(algorithm, "color") or _OTHERS[sum(algorithm.encode()) % len(_OTHERS)]


def marker_of(name: str) -> str:
    """The mark of an algorithm, whatever its options: what it states itself, or a circle."""
    algorithm = name.partition(":")[0]
    return "x" if algorithm == _YARDSTICK else _stated(algorithm, "marker") or "o"


def _stated(algorithm: str, what: str) -> str | None:
    """A property of an algorithm; None of what is none here: a finished EIA, another machine's."""
    try:
        found: str | None = getattr(properties(algorithm), what)
    except UsageError:
        return None
    return found


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
