"""The plots of a bench, as SVG and PNG: time against error, and time against size."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.files.image import write_atomically
from inim.report.bench.marks import BEATEN, LINES, SOFT, colour_of, marker_of, plain_ticks, style
from inim.report.bench.names import Name, across, set_apart
from inim.report.wording import is_number, part

__all__ = ["draw_plots"]

_PNG_DPI = 160
_TIME = "milliseconds per EIA"
# How far below the noise floor counts as reaching it, and what layers may cost.
_CLOSE_DB = 1.5
_MOST_TIMES = 3.0
# Below this share of wrong pixels the axis is linear, so that zero has a place on it.
_LINEAR_SHARE = 1e-3


def draw_plots(data: Mapping[str, Any], folder: Path) -> list[str]:
    """Write whatever there is to draw; the names of the files written."""
    drawn: list[str] = []
    if data.get("contenders"):
        drawn += _save(_pareto(data), folder, "pareto")
    if data.get("scaling"):
        drawn += _save(_scaling(data["scaling"]), folder, "scaling")
    if data.get("paper"):
        drawn += _save(_paper(data["paper"]), folder, "paper")
    if data.get("layers"):
        drawn += _save(_layers(data["layers"]), folder, "layers")
    if data.get("commands"):
        drawn += _save(_commands(data["commands"]), folder, "commands")
    return drawn


def _figure(columns: int, height: float, **options: Any) -> tuple[Any, Sequence[Any]]:
    """A figure of its own: no global state, no display."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.2 * columns, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(1, columns, squeeze=False, **options)[0]


def _save(figure: Any, folder: Path, name: str) -> list[str]:
    from matplotlib import rc_context

    # Without a date or random ids, equal data give equal files. Text stays text.
    fixed = {"svg.hashsalt": "inim", "svg.fonttype": "none"}
    svg = {"metadata": {"Date": None}}
    with rc_context(fixed):
        write_atomically(folder / f"{name}.svg", lambda p: figure.savefig(p, **svg))
    write_atomically(folder / f"{name}.png", lambda p: figure.savefig(p, dpi=_PNG_DPI))
    return [f"{name}.svg", f"{name}.png"]


# -- time against error -------------------------------------------------------------------------


def _pareto(data: Mapping[str, Any]) -> Any:
    """Small multiples over one time axis: wrong sources, EIA PSNR, views."""
    panels: list[tuple[str, str, str, Callable[[float], float]]] = [
        ("Wrong source", "wrong_source", "panel pixels of a wrong source, %", lambda v: 100 * v),
        ("Elemental images", "eia_psnr_db", "EIA PSNR to ground truth, dB", lambda v: v),
        ("Views", "view_ssim_to_ceiling", "1 − SSIM of the views to the ceiling", lambda v: 1 - v),
    ]
    figure, axes = _figure(3, 4.6, sharex=True)
    names = []
    for axis, (title, key, label, shown) in zip(axes, panels, strict=True):
        axis.set_xscale("log")
        names.append(_panel(axis, data, key, shown))
        style(axis, title, f"{_TIME} (↙ better)", label)
    _share_scale(axes[0])
    if all(1 - c["view_ssim_to_ceiling"] > 0 for c in data["contenders"]):
        axes[2].set_yscale("log")
    axes[1].invert_yaxis()  # as in the others, down is better
    for axis in axes:
        plain_ticks(axis)
    figure.canvas.draw()  # now all has its place, and names can be put beside one another
    for axis, texts in zip(axes, names, strict=True):
        set_apart(axis, texts)
    return figure


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
    for contender in sorted(known, key=lambda c: key in c["fronts"]):
        _point(axis, contender, shown(contender[key]), key in contender["fronts"])
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


def _name(contender: Mapping[str, Any], value: float, on_front: bool) -> Name:
    colour = colour_of(contender["name"]) if on_front else SOFT
    return Name(contender["name"], contender["median_ms"], value, colour, 8 if on_front else 7)


def _point(axis: Any, contender: Mapping[str, Any], value: float, on_front: bool) -> None:
    """One contender, its fastest run as a whisker; grey where another beats it in both."""
    colour = colour_of(contender["name"]) if on_front else BEATEN
    time, fastest = contender["median_ms"], contender["min_ms"]
    axis.plot([fastest, time], [value, value], color=colour, linewidth=1.2, zorder=2)
    mark = marker_of(contender["name"])
    axis.plot(time, value, mark, color=colour, markersize=7, zorder=3, clip_on=False)


# -- time against size --------------------------------------------------------------------------


def _scaling(scaling: Mapping[str, Any]) -> Any:
    """Time over display pixels and over scene pixels, the yardstick beside."""
    figure, axes = _figure(2, 4.2, sharey=True)
    panels = [("display", "display_pixels"), ("scene", "scene_pixels")]
    for axis, (key, size) in zip(axes, panels, strict=True):
        points = scaling[key]
        sizes = [p[size] for p in points]
        _line(axis, sizes, points, scaling["algorithm"])
        _line(axis, sizes, [p["yardstick"] for p in points], "yardstick")
        words = size.replace("_", " ")
        power = scaling["growth"][size]
        grows = f": grows with the power {power:.2f}" if is_number(power) else ""
        _finish_sizes(axis, f"{words.capitalize()}{grows}", words)
    axes[0].set_ylabel(_TIME)
    axes[0].legend(fontsize=8, frameon=False, loc="upper left")
    return figure


def _paper(paper: Mapping[str, Any]) -> Any:
    """The three experiments side by side, on common times."""
    experiments = paper["experiments"]
    figure, axes = _figure(len(experiments), 4.6, sharey=True)
    for axis, experiment in zip(axes, experiments, strict=True):
        points = experiment["points"]
        sizes = [p[experiment["size"]] for p in points]
        for place, contender in enumerate(points[0]["contenders"]):
            _line(axis, sizes, [p["contenders"][place] for p in points], contender["name"])
        _line(axis, sizes, [p["yardstick"] for p in points], "yardstick")
        _finish_sizes(axis, f"As {experiment['figure']}", experiment["name"])
    axes[0].set_ylabel(_TIME)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure


def _finish_sizes(axis: Any, title: str, label: str) -> None:
    style(axis, title, label, "")
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.margins(0.08, 0.08)
    plain_ticks(axis)


def _line(axis: Any, sizes: Sequence[float], points: Sequence[Any], name: str) -> None:
    """One series of medians with whiskers to the fastest runs; dashed in plain Python."""
    interpreted = "implementation=python" in name
    algorithm, colour = name.partition(":")[0], colour_of(name)
    medians, fastest = ([p[key] for p in points] for key in ("median_ms", "min_ms"))
    axis.vlines(sizes, fastest, medians, color=colour, linewidth=1, alpha=0.5)
    axis.plot(
        sizes,
        medians,
        marker_of(algorithm),
        color=colour,
        label=f"{algorithm}, plain Python" if interpreted else name,
        markersize=4.5,
        markerfacecolor="white" if interpreted else colour,
        linestyle="--" if interpreted else ":" if name == "yardstick" else "-",
        linewidth=1.4,
    )


# -- layers -------------------------------------------------------------------------------------


def _layers(scenes: Sequence[Mapping[str, Any]]) -> Any:
    """A row for each scene: PSNR beside the noise floor, time beside what layers may cost."""
    figure, (quality, cost) = _figure(2, 1.8 + 0.55 * len(scenes), sharey=True)
    for row, found in enumerate(scenes):
        floor = part(found, "noise_floor").get("eia_psnr_db")
        if is_number(floor):
            height = [row - 0.3, row + 0.3]
            quality.plot([floor, floor], height, **LINES["floor"])
            close = {"color": SOFT, "alpha": 0.15, "linewidth": 0}
            quality.fill_betweenx(height, floor - _CLOSE_DB, floor, **close)
        contenders = found["contenders"]
        for contender in contenders:
            name = contender["name"]
            if is_number(contender["eia_psnr_db"]):
                _mark(quality, contender["eia_psnr_db"], row, name)
            _mark(cost, contender["ratio"], row, name)
        for template, layered in zip(contenders[::2], contenders[1::2], strict=True):
            both = [template["ratio"], layered["ratio"]]
            cost.plot(both, [row, row], **LINES["front"])
            cost.plot(_MOST_TIMES * both[0], row, "|", color=SOFT, markersize=14)
    cost.set_xscale("log")
    style(quality, f"Dashed: noise floor; shaded: {_CLOSE_DB:g} dB below it", "EIA PSNR, dB", "")
    style(cost, f"Ticks: {_MOST_TIMES:g} times template", "yardsticks per EIA", "")
    quality.set_yticks(range(len(scenes)), [found["title"] for found in scenes])
    quality.invert_yaxis()
    plain_ticks(cost)
    handles = dict(zip(*reversed(quality.get_legend_handles_labels()), strict=True))
    figure.legend(
        handles.values(), handles.keys(), loc="outside lower center", ncols=4, fontsize=8,
        frameon=False,
    )  # fmt: skip
    return figure


def _mark(axis: Any, value: float, row: int, name: str) -> None:
    """An algorithm's mark on a scene's row; hollow with one sample a pixel."""
    colour = colour_of(name)
    fill = colour if name.endswith("samples=4") else "white"
    mark = marker_of(name)
    axis.plot(value, row, mark, color=colour, markerfacecolor=fill, label=name, zorder=3)


# -- whole commands -----------------------------------------------------------------------------


def _commands(found: Mapping[str, Any]) -> Any:
    """A row for each command: its runs, over seconds, and the share of what it is compared with."""
    cases = found["cases"]
    figure, (axis,) = _figure(1, 1.2 + 0.32 * len(cases))
    figure.set_figwidth(8.4)
    compared = {case["beside"] for case in cases}
    for row, case in enumerate(cases):
        is_measure = case["name"] in compared
        colour = SOFT if is_measure else colour_of("template")
        taken = case["times_s"]
        axis.plot(taken, [row] * len(taken), "o", color=colour, alpha=0.6, markersize=5, zorder=3)
        if is_measure:
            reach = [r for r, other in enumerate(cases) if other["beside"] == case["name"]]
            ends = [min(reach) - 0.3, max(reach) + 0.3]
            axis.plot([case["median_s"]] * 2, ends, **LINES["floor"])
        else:
            _beside(axis, f"{case['share']:.1%} of {case['beside']}", max(taken), row)
    axis.set_xscale("log")
    axis.margins(x=0.2)
    style(axis, "Whole commands", "seconds, start to end", "")
    axis.set_yticks(range(len(cases)), [case["name"] for case in cases])
    axis.invert_yaxis()
    plain_ticks(axis)
    return figure


def _beside(axis: Any, words: str, x: float, y: float) -> None:
    """Words on the right of a mark, readable where a line is behind them."""
    behind = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
    look = {"fontsize": 8, "color": SOFT, "va": "center", "bbox": behind, "zorder": 2}
    axis.annotate(words, (x, y), (7, 0), textcoords="offset points", **look)
