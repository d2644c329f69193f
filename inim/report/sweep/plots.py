"""Time against error, display by display, as one SVG picture."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

from inim.report.bench.marks import BEATEN, LINES, SOFT, colour_of, marker_of, plain_ticks, style
from inim.report.bench.names import Name, set_apart
from inim.report.sweep.results import Result, mean, names_of, on_front
from inim.report.wording import MAIN

__all__ = ["draw_pareto", "time_column"]

_MOST_ACROSS = 3
_WIDTH, _HEIGHT = 4.2, 4.0


def time_column(results: Sequence[Result]) -> str:
    """Yardsticks where every result was timed in them; else seconds, taken once, cold."""
    done = [c for c in results if not c.failed]
    timed = bool(done) and all(c.scores["yardsticks"] is not None for c in done)
    return "yardsticks" if timed else "seconds"


def draw_pareto(results: Sequence[Result]) -> str | None:
    """The plot as SVG; None where no algorithm has a time and a score.

    A point is the mean over scenes, of the algorithms that have them all.
    """
    panels = {display: _points(results, display) for display in names_of(results, "display")}
    panels = {display: points for display, points in panels.items() if points}
    if not panels:
        return None
    return _svg(_figure(panels, time_column(results)))


def _points(results: Sequence[Result], display: str) -> dict[str, tuple[float, float]]:
    """By algorithm, mean time and mean of 1 − SSIM to the ceiling."""
    column = time_column(results)
    own = [c for c in results if c.display == display]
    points = {}
    for name in names_of(own, "algorithm"):
        runs = [c for c in own if c.algorithm == name and not c.failed]
        time = mean(c.scores[column] for c in runs)
        score = mean(c.scores[MAIN.to_ceiling_key] for c in runs)
        if time is not None and score is not None and time > 0:
            points[name] = (time, 1 - score)
    return points


def _figure(panels: dict[str, dict[str, tuple[float, float]]], unit: str) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    across = min(_MOST_ACROSS, len(panels))
    down = -(-len(panels) // across)
    figure = Figure(figsize=(_WIDTH * across, _HEIGHT * down), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True).ravel()
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    drawn = list(zip(axes, panels.items(), strict=False))
    for axis, (display, points) in drawn:
        _panel(axis, points)
        style(axis, display, f"{unit} per EIA (↙ better)", f"1 − {MAIN.label} to the ceiling")
        axis.set_xscale("log")
        axis.margins(0.24, 0.14)
    for axis, _ in drawn:
        plain_ticks(axis)
    figure.canvas.draw()  # the layout is final, so names can be placed
    for axis, (_, points) in drawn:
        front = on_front(points)
        set_apart(axis, [_name(name, *place, name in front) for name, place in points.items()])
    return figure


def _panel(axis: Any, points: dict[str, tuple[float, float]]) -> None:
    front = on_front(points)
    for name, (time, error) in points.items():
        colour = colour_of(name) if name in front else BEATEN
        mark = marker_of(name)
        axis.plot(time, error, mark, color=colour, markersize=7, zorder=3, clip_on=False)
    line = sorted(points[name] for name in front)
    axis.step(*zip(*line, strict=True), where="post", **LINES["front"])


def _name(name: str, time: float, error: float, on_the_front: bool) -> Name:
    colour = colour_of(name) if on_the_front else SOFT
    return Name(name, time, error, colour, 8 if on_the_front else 7)


def _svg(figure: Any) -> str:
    from matplotlib import rc_context

    stream = io.StringIO()
    # Without a date or random ids, equal data give an equal page. Text stays text.
    with rc_context({"svg.hashsalt": "inim", "svg.fonttype": "none"}):
        figure.savefig(stream, format="svg", metadata={"Date": None})
    return stream.getvalue()
