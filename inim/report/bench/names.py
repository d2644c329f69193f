"""Names beside points, put where they cover neither one another nor another point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from inim.report.bench.marks import SOFT

__all__ = ["Name", "across", "set_apart"]

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


@dataclass(frozen=True)
class Name:
    """A name and the point it belongs to, in the axis's own values."""

    words: str
    x: float
    y: float
    colour: str
    size: float


def set_apart(axis: Any, names: Sequence[Name]) -> None:
    """Write the names, the largest first, each at the first place that is free."""
    from matplotlib.transforms import Bbox

    renderer = axis.figure.canvas.get_renderer()
    room = axis.get_window_extent(renderer).padded(10)
    marks = [axis.transData.transform((n.x, n.y)) for n in names]
    taken = [
        Bbox.from_bounds(x - _MARK_PX / 2, y - _MARK_PX / 2, _MARK_PX, _MARK_PX) for x, y in marks
    ]
    taken += [text.get_window_extent(renderer) for text in axis.texts]
    for name in sorted(names, key=lambda n: -n.size):
        written = [_write(axis, name, place) for place in _PLACES]
        boxes = [text.get_window_extent(renderer) for text in written]
        best = min(range(len(boxes)), key=lambda i: (_overlap(boxes[i], taken, room), i))
        taken.append(boxes[best])
        for i, text in enumerate(written):
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


def _overlap(box: Any, taken: Sequence[Any], room: Any) -> float:
    """Area covered twice, and what sticks out of the panel, square pixels."""
    covered = sum(_common_area(box, other) for other in taken)
    return float(covered + box.width * box.height - _common_area(box, room))


def _common_area(a: Any, b: Any) -> float:
    wide = min(a.x1, b.x1) - max(a.x0, b.x0)
    high = min(a.y1, b.y1) - max(a.y0, b.y0)
    return float(max(0.0, wide) * max(0.0, high))


def across(axis: Any, words: str, x: float | None = None, y: float | None = None) -> None:
    """Words at the end of a line across the panel, at x or at y."""
    from matplotlib.transforms import blended_transform_factory as blended

    look = {"fontsize": 7.5, "color": SOFT}
    if x is not None:
        where = blended(axis.transData, axis.transAxes)
        axis.text(x, 0.99, f" {words}", transform=where, va="top", **look)
    else:
        where = blended(axis.transAxes, axis.transData)
        axis.text(0.99, y, words, transform=where, ha="right", va="bottom", **look)
