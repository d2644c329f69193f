"""Parallax: the viewpoints in the order of their positions, so that it shows as a shift."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from inim.report.images import Images, is_wide
from inim.report.markup import element, text
from inim.report.sections import ReportSection
from inim.report.wording import best_algorithm, is_number, items, part

__all__ = ["SECTIONS", "parallax"]

_THUMBNAIL_PX = 320
_WORDS = (
    "Ground truth above, the best algorithm below. The frame is the lens array: the farther a "
    "point is from it, the more it moves against the centre line. Both rows should move alike."
)


def parallax(data: Mapping[str, Any], images: Images) -> str:
    """The section on parallax; empty with fewer than two viewpoints in a line."""
    points = [v for v in items(data, "viewpoints") if _position(v) is not None]
    best = best_algorithm(data)
    sources = [("Ground truth", ("truth",))] + ([(best, ("views", best))] if best else [])
    strips = [
        _strip(images, direction, [str(v["name"]) for v in line], sources)
        for direction, line in _lines_of_sight(points)
        if len(line) > 1
    ]
    if not strips:
        return ""
    wide = is_wide(images.read("truth", f"{points[0]['name']}.png")) or len(strips) == 1
    kind = "strips wide" if wide else "strips"
    return element("p", text(_WORDS), class_="lead") + element("div", *strips, class_=kind)


def _position(viewpoint: Any) -> tuple[float, float] | None:
    position = items(viewpoint, "position_mm")
    if "name" not in part(viewpoint) or len(position) < 2 or not all(map(is_number, position)):
        return None
    return float(position[0]), float(position[1])


def _lines_of_sight(points: Sequence[Any]) -> list[tuple[str, list[Any]]]:
    """Viewpoints left to right and top to bottom through the one nearest to the axis."""
    if not points:
        return []
    places = {id(v): _position(v) or (0.0, 0.0) for v in points}
    x0, y0 = min(places.values(), key=lambda p: math.hypot(*p))
    row = [v for v in points if math.isclose(places[id(v)][1], y0, abs_tol=1e-6)]
    column = [v for v in points if math.isclose(places[id(v)][0], x0, abs_tol=1e-6)]
    return [
        ("left to right", sorted(row, key=lambda v: places[id(v)][0])),
        ("top to bottom", sorted(column, key=lambda v: -places[id(v)][1])),
    ]


def _strip(
    images: Images,
    direction: str,
    views: Sequence[str],
    sources: Sequence[tuple[str, tuple[str, ...]]],
) -> str:
    rows = []
    for label, place in sources:
        shots = [_strip_shot(images, direction, view, label, place) for view in views]
        title = element("h3", text(f"{label}, {direction}"))
        rows.append(title + element("div", *shots, class_="strip"))
    return element("div", *rows)


def _strip_shot(
    images: Images, direction: str, view: str, label: str, place: tuple[str, ...]
) -> str:
    """One small picture with a line through its centre, across the direction of movement."""
    pixels = images.read(*place, f"{view}.png")
    picture = images.embed(pixels, f"{label} from {view}", _THUMBNAIL_PX)
    kind = "upright" if direction == "left to right" else "level"
    line = element("i", class_=kind, aria_hidden="true")
    return element(
        "figure",
        element("div", picture, line, class_="marked"),
        element("figcaption", text(view)),
    )


SECTIONS = (ReportSection(50, "parallax", "Parallax", parallax),)
