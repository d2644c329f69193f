"""Common parts of plots: colours and markers of algorithms, axes, point labels, and files.

Without a date or random ids equal data give equal files, and text stays text.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import RLock
from typing import Any

from inim.generators import parse_algorithm
from inim.system.errors import UsageError
from inim.system.process.atomic_file import write_atomically

_PNG_DPI = 160
INK = "#1e2022"
#: Colour of labels and other secondary parts.
SOFT = "#5a5f63"
#: Okabe and Ito's colours, distinguishable with any colour vision.
BLUE, VERMILION, GREEN, ORANGE, SKY = "#0072b2", "#d55e00", "#009e73", "#e69f00", "#56b4e9"
LEGEND = {"fontsize": 8, "frameon": False, "labelcolor": INK}
# Of points that another beats in time and error.
_BEATEN = "#b5b5b0"
_LINE = "#dedbd3"
_REFERENCE_KERNEL = "reference kernel"
# Of algorithms that state none.
_OTHERS = (SKY, ORANGE, "#8c6d31")
#: Lines across a panel.
LINES: dict[str, dict[str, Any]] = {
    "front": {"color": INK, "linewidth": 0.8, "alpha": 0.35, "zorder": 1},
    "kernel": {"color": SOFT, "linewidth": 1.0, "linestyle": ":", "zorder": 1},
    "floor": {"color": SOFT, "linewidth": 1.0, "linestyle": "--", "zorder": 1},
}
# Where a name may go, points from its mark and how it is aligned; the first that is free is taken.
_PLACES = (
    (6, 4, "left"),
    (6, -11, "left"),
    (-6, 4, "right"),
    (-6, -11, "right"),
    (0, 9, "center"),
    (0, -17, "center"),
    (6, 14, "left"),
    (6, -21, "left"),
    (-6, 14, "right"),
    (-6, -21, "right"),
    (6, 24, "left"),
    (6, -31, "left"),
)
_MARK_PX = 8.0
_LOCK = RLock()


def colour_of(name: str) -> str:
    """Colour of an algorithm, independent of its options: its own, or one of three."""
    algorithm = name.partition(":")[0]
    if algorithm == _REFERENCE_KERNEL:
        return SOFT
    return (
        _algorithm_property(algorithm, "color") or _OTHERS[sum(algorithm.encode()) % len(_OTHERS)]
    )


def marker_of(name: str) -> str:
    """Marker of an algorithm, independent of its options: its own, or a circle."""
    algorithm = name.partition(":")[0]
    return (
        "x" if algorithm == _REFERENCE_KERNEL else _algorithm_property(algorithm, "marker") or "o"
    )


def _algorithm_property(algorithm: str, key: str) -> str | None:
    """Property of an algorithm; None for a finished EIA or an algorithm of another machine."""
    try:
        value: str | None = getattr(parse_algorithm(algorithm), key)
    except UsageError:
        return None
    return value


def style(axis: Any, title: str, x_label: str, y_label: str, font: float = 9) -> None:
    """Set title and labels; draw a light grid and no box."""
    axis.set_title(title, loc="left", fontsize=10.5, color=INK)
    axis.set_xlabel(x_label, fontsize=font, color=SOFT)
    axis.set_ylabel(y_label, fontsize=font, color=SOFT)
    axis.grid(True, which="major", color=_LINE, linewidth=0.6)
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=font - 1, colors=SOFT, which="both", length=2.5)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axis.spines[side].set_color(_LINE)


def plain_ticks(axis: Any) -> None:
    """Write ticks as 0.3, 1, 100 instead of powers of ten, with minor ticks if there are few."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    formatter = FuncFormatter(lambda value, _: _short(value))
    for side in (axis.xaxis, axis.yaxis):
        if side.get_scale() == "linear":
            continue
        low, high = sorted(side.get_view_interval())
        side.set_major_formatter(formatter)
        within_a_decade = side.get_scale() == "log" and high < 10 * low
        side.set_minor_formatter(formatter if within_a_decade else NullFormatter())


def _short(value: float) -> str:
    for unit, size in (("M", 1e6), ("k", 1e3)):
        if value >= size:
            return f"{value / size:g} {unit}"
    return f"{value:g}"


def blank_figure(size_inches: tuple[float, float], layout: str | None = None) -> Any:
    """An empty figure without global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_inches, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def new_figure(
    columns: int, height: float, rows: int = 1, **options: Any
) -> tuple[Any, Sequence[Any]]:
    """A figure of a `height` in inches and its axes, row by row."""
    figure = blank_figure((4.2 * columns, height), "constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options).ravel()


def save(figure: Any, folder: Path, name: str) -> None:
    """Write a figure as ``NAME.svg`` and ``NAME.png``."""
    write_atomically(folder / f"{name}.svg", lambda path: path.write_bytes(svg(figure)))
    write_atomically(folder / f"{name}.png", lambda path: figure.savefig(path, dpi=_PNG_DPI))


@contextmanager
def reproducible() -> Iterator[None]:
    """Draw equal files from equal data, in one thread at a time: matplotlib's settings are global.

    Text stays text: PDF and EPS embed TrueType fonts, because publishers refuse Type 3. A font here
    without some letter of a name is no reason for a warning: the reader's fonts count.
    """
    from matplotlib import rc_context

    options: dict[str, Any] = {"svg.hashsalt": "inim", "svg.fonttype": "none"}
    options |= {"pdf.fonttype": 42, "ps.fonttype": 42}
    with _LOCK, rc_context(options), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        yield


def svg(figure: Any) -> bytes:
    """A figure as SVG."""
    stream = io.BytesIO()
    with reproducible():
        figure.savefig(stream, format="svg", metadata={"Date": None})
    return stream.getvalue()


def on_front(points: Mapping[str, tuple[float, float]]) -> set[str]:
    """Names of the Pareto-optimal points, with both values to be minimised."""
    return {
        name
        for name, (x, y) in points.items()
        if not any((a <= x and b <= y and (a, b) != (x, y)) for a, b in points.values())
    }


@dataclass(frozen=True)
class TimedPoint:
    """An algorithm in a plot of time against error.

    * `error`: smaller is better. `value`: its value on the axis.
    """

    name: str
    time: float
    error: float
    value: float


def draw_time_against_error(axis: Any, points: Sequence[TimedPoint]) -> list[Name]:
    """Draw points and their Pareto front, and return the names to place by `set_apart`.

    A point is grey, and its name smaller, where another beats it in both.
    """
    front = draw_front(axis, points)
    names = []
    for p in points:
        is_best = p.name in front
        colour = colour_of(p.name) if is_best else _BEATEN
        axis.plot(
            p.time, p.value, marker_of(p.name), color=colour, markersize=7,
            zorder=2 + is_best, clip_on=False,
        )  # fmt: skip
        words = p.name.replace("$", r"\$")  # a dollar sign would begin a formula
        colour, size = (colour, 8) if is_best else (SOFT, 7)
        names.append(Name(words, p.time, p.value, colour, size))
    return names


def draw_front(axis: Any, points: Sequence[TimedPoint]) -> set[str]:
    """Draw the Pareto front of points, and return the names on it."""
    front = on_front({point.name: (point.time, point.error) for point in points})
    steps = sorted((p.time, p.value) for p in points if p.name in front)
    if steps:
        axis.step(*zip(*steps, strict=True), where="post", **LINES["front"])
    return front


@dataclass(frozen=True)
class Name:
    """A name and the point it belongs to, in the axis's own values."""

    words: str
    x: float
    y: float
    colour: str
    size: float


def set_apart(axis: Any, names: Sequence[Name]) -> None:
    """Write the names, the largest first, each at the first free place."""
    from matplotlib.transforms import Bbox

    renderer = axis.figure.canvas.get_renderer()
    room = axis.get_window_extent(renderer).padded(10)
    marks = [axis.transData.transform((n.x, n.y)) for n in names]
    occupied = [
        Bbox.from_bounds(x - _MARK_PX / 2, y - _MARK_PX / 2, _MARK_PX, _MARK_PX) for x, y in marks
    ]
    occupied += [text.get_window_extent(renderer) for text in axis.texts]
    for name in sorted(names, key=lambda n: -n.size):
        label_options = [_write(axis, name, place) for place in _PLACES]
        boxes = [text.get_window_extent(renderer) for text in label_options]
        best = min(range(len(boxes)), key=lambda i: (_overlap(boxes[i], occupied, room), i))
        occupied.append(boxes[best])
        for i, text in enumerate(label_options):
            if i != best:
                text.remove()


def _write(axis: Any, name: Name, place: tuple[float, float, str]) -> Any:
    return axis.annotate(
        name.words,
        (name.x, name.y),
        place[:2],
        textcoords="offset points",
        ha=place[2],
        fontsize=name.size,
        color=name.colour,
        zorder=4,
    )


def _overlap(box: Any, occupied: Sequence[Any], room: Any) -> float:
    """Area of overlaps and of parts outside the panel, in square pixels."""
    covered = sum(_common_area(box, other) for other in occupied)
    return float(covered + box.width * box.height - _common_area(box, room))


def _common_area(a: Any, b: Any) -> float:
    common = a.intersection(a, b)
    return 0.0 if common is None else float(common.width * common.height)


def across(axis: Any, words: str, y: float) -> None:
    """Write a label at the end of a horizontal line across the panel."""
    from matplotlib.transforms import blended_transform_factory as blended

    transform = blended(axis.transAxes, axis.transData)
    font = {"fontsize": 7.5, "color": SOFT}
    axis.text(0.99, y, words, transform=transform, ha="right", va="bottom", **font)
