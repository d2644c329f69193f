"""Time against error as a plot, and what the plots of a bench have in common."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.files.image import write_atomically
from inim.report.bench.marks import BEATEN, LINES, SOFT, colour_of, marker_of, plain_ticks, style
from inim.report.bench.names import Name, across, set_apart
from inim.report.wording import is_number, items, part

__all__ = ["TIME", "draw_scene", "new_figure", "save"]

_PNG_DPI = 160
#: The label of a time axis.
TIME = "milliseconds per EIA"
# Below this share of wrong pixels the axis is linear, so that zero has a place on it.
_LINEAR_SHARE = 1e-3


def new_figure(columns: int, height: float, **options: Any) -> tuple[Any, Sequence[Any]]:
    """A figure of its own: no global state, no display."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.2 * columns, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(1, columns, squeeze=False, **options)[0]


def save(figure: Any, folder: Path, name: str) -> list[str]:
    """Write a figure as SVG and PNG; the names of the files."""
    from matplotlib import rc_context

    # Without a date or random ids, equal data give equal files. Text stays text.
    fixed = {"svg.hashsalt": "inim", "svg.fonttype": "none"}
    svg = {"metadata": {"Date": None}}
    with rc_context(fixed):
        write_atomically(folder / f"{name}.svg", lambda p: figure.savefig(p, **svg))
    write_atomically(folder / f"{name}.png", lambda p: figure.savefig(p, dpi=_PNG_DPI))
    return [f"{name}.svg", f"{name}.png"]


def draw_scene(data: Mapping[str, Any]) -> Any:
    """Small multiples over one time axis: wrong sources, then the scores that are plotted."""
    plotted = [score for score in items(data, "scores") if score["plotted"]]
    figure, axes = new_figure(1 + len(plotted), 4.6, sharex=True)
    axes[0].set_xscale("log")  # of all of them
    title, label = "Wrong source", "panel pixels of a wrong source, %"
    names = [_panel(axes[0], data, "wrong_source", lambda share: 100 * share)]
    style(axes[0], title, f"{TIME} (↙ better)", label)
    for axis, score in zip(axes[1:], plotted, strict=True):
        names.append(_score_panel(axis, data, score))
    _share_scale(axes[0])
    for axis in axes:
        plain_ticks(axis)
    figure.canvas.draw()  # now all has its place, and names can be put beside one another
    for axis, texts in zip(axes, names, strict=True):
        set_apart(axis, texts)
    return figure


def _score_panel(axis: Any, data: Mapping[str, Any], score: Mapping[str, Any]) -> list[Name]:
    """A panel whose better end is below, whatever a score's better end is; the names for it."""
    key, label, best = score["key"], score["label"], score["best"]
    is_distance = score["better"] == "higher" and best is not None
    if is_distance:
        names = _panel(axis, data, key, lambda value: best - value)
        label = f"{best:g} − {label}"
    else:
        names = _panel(axis, data, key, lambda value: value)
    style(axis, score["title"], f"{TIME} (↙ better)", label)
    values = [m[key] for m in data["contenders"] if is_number(m.get(key))]
    if is_distance and all(value < best for value in values):
        axis.set_yscale("log")
    if score["better"] == "higher" and not is_distance:
        axis.invert_yaxis()
    return names


def _share_scale(axis: Any) -> None:
    """Logarithmic with a place for zero."""
    linear = 100 * _LINEAR_SHARE
    axis.set_yscale("symlog", linthresh=linear, linscale=0.5)
    axis.set_ylim(-0.3 * linear, max(10 * linear, 2.5 * axis.get_ylim()[1]))


def _panel(
    axis: Any, data: Mapping[str, Any], key: str, shown: Callable[[float], float]
) -> list[Name]:
    """Draw one panel; the names that go into it."""
    known = [c for c in data["contenders"] if is_number(c.get(key))]
    for method in sorted(known, key=lambda c: key in c["fronts"]):
        _point(axis, method, shown(method[key]), key in method["fronts"])
    front = sorted((c["median_ms"], shown(c[key])) for c in known if key in c["fronts"])
    if front:
        axis.step(*zip(*front, strict=True), where="post", **LINES["front"])
    yardstick = part(data, "yardstick").get("median_ms")
    if is_number(yardstick):
        axis.axvline(yardstick, **LINES["yardstick"])
        across(axis, "yardstick", x=yardstick)
    floor = part(data, "noise_floor").get(key)
    if is_number(floor):
        axis.axhline(shown(floor), **LINES["floor"])
        across(axis, "noise floor", y=shown(floor))
    axis.margins(0.12, 0.12)
    return [_name(c, shown(c[key]), key in c["fronts"]) for c in known]


def _name(method: Mapping[str, Any], value: float, on_front: bool) -> Name:
    colour = colour_of(method["name"]) if on_front else SOFT
    return Name(method["name"], method["median_ms"], value, colour, 8 if on_front else 7)


def _point(axis: Any, method: Mapping[str, Any], value: float, on_front: bool) -> None:
    """One method, its fastest run as a whisker; grey where another beats it in both."""
    colour = colour_of(method["name"]) if on_front else BEATEN
    time, fastest = method["median_ms"], method["min_ms"]
    axis.plot([fastest, time], [value, value], color=colour, linewidth=1.2, zorder=2)
    mark = marker_of(method["name"])
    axis.plot(time, value, mark, color=colour, markersize=7, zorder=3, clip_on=False)
