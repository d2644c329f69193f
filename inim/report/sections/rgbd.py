"""What the algorithms were given: colour, depth, and whether the depth suits the display."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from inim.errors import InimError
from inim.files.image import read_rgbd
from inim.report.diagram import label, svg
from inim.report.images import Images
from inim.report.markup import element, figure, text
from inim.report.sections import ReportSection
from inim.report.wording import is_number, mm, part, per_cent, short
from inim.rgbd import RGBD

__all__ = ["SECTIONS", "depth_profile"]

# The renderer works in single precision, and so does the depth picture.
_SLACK = 1e-5

_SIDE = 400.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 12.0, 12.0, 46.0, 44.0
_LABEL_PX = 15.0
_MOST_COLUMNS_DRAWN = 256


def rgbd(data: Mapping[str, Any], images: Images) -> str:
    """The section on the RGB-D input."""
    colour, depth = (images.read(f"rgbd_{kind}.png") for kind in ("color", "depth"))
    shots = [
        figure(images.embed(colour, "RGB-D input, colour"), "Colour"),
        figure(images.embed(depth, "RGB-D input, depth"), "Depth", _depth_words(data)),
        _profile(data, images),
    ]
    return element("p", text(_words(data)), class_="lead") + element("div", *shots, class_="three")


def _words(data: Mapping[str, Any]) -> str:
    given = part(data, "rgbd")
    return (
        f"What the algorithms were given: {short(given.get('columns'))} × "
        f"{short(given.get('rows'))} pixels of {mm(given.get('pixel_mm'))}, "
        f"{per_cent(given.get('covered_fraction'), 1)} of them covered by the relic, depths from "
        f"{mm(given.get('depth_min_mm'))} to {mm(given.get('depth_max_mm'))} towards the viewer."
    )


def _depth_words(data: Mapping[str, Any]) -> str:
    derived = part(data, "display", "derived")
    far, near = mm(derived.get("depth_min_mm")), mm(derived.get("depth_max_mm"))
    return f"lighter is nearer to the viewer, from {far} to {near}; black is background"


def _profile(data: Mapping[str, Any], images: Images) -> str:
    drawing = depth_profile(images.folder, part(data, "display", "derived"))
    return figure(drawing, "Depth along the array", _profile_words(data)) if drawing else ""


def _profile_words(data: Mapping[str, Any]) -> str:
    """Whether the relic is where the display can show it."""
    derived, given = part(data, "display", "derived"), part(data, "rgbd")
    ends = [(part_.get("depth_min_mm"), part_.get("depth_max_mm")) for part_ in (derived, given)]
    (low, high), (first, last) = ends
    if not (is_number(low) and is_number(high) and is_number(first) and is_number(last)):
        return "seen from above"
    slack = _SLACK * max(abs(low), abs(high))
    inside = low - slack <= first and last <= high + slack
    place = "lies inside" if inside else "leaves"
    return f"seen from above, all rows together: the relic {place} the display's depth range"


def depth_profile(folder: Path, derived: Mapping[str, Any]) -> str:
    """The drawing, or an empty string without a readable ``rgbd.exr`` or a depth range.

    Parameters
    ----------
    folder : Path
        The report's folder.
    derived : mapping
        ``Display.derived()``.

    Returns
    -------
    str
        An ``<svg>`` element with its own description: x to the right as in the images, depth
        upwards to the viewer, the band between farthest and nearest surface of each column.
    """
    low, high = derived.get("depth_min_mm"), derived.get("depth_max_mm")
    width = derived.get("width_mm")
    if not all(is_number(v) and math.isfinite(v) for v in (low, high, width)) or not width:
        return ""
    try:
        rgbd = read_rgbd(folder / "rgbd.exr")
    except InimError:
        return ""
    return _drawing(rgbd, derived) if rgbd.covered.any() else ""


class _Frame:
    """Millimetres to drawing units; depths are stretched by a whole factor where they are flat."""

    def __init__(self, width_mm: float, low_mm: float, high_mm: float) -> None:
        room = _SIDE - _TOP - _BOTTOM
        self.low_mm = low_mm
        self.px_per_mm = min((_SIDE - _LEFT - _RIGHT) / width_mm, room / (high_mm - low_mm))
        self.stretch = max(1, int(room / ((high_mm - low_mm) * self.px_per_mm)))

    def x(self, x_mm: float) -> float:
        return _SIDE / 2 + x_mm * self.px_per_mm

    def y(self, z_mm: float) -> float:
        return _SIDE - _BOTTOM - (z_mm - self.low_mm) * self.px_per_mm * self.stretch


def _drawing(rgbd: RGBD, derived: Mapping[str, Any]) -> str:
    low, high, half = derived["depth_min_mm"], derived["depth_max_mm"], derived["width_mm"] / 2
    depths = rgbd.depth_mm[rgbd.covered]
    ends = min(0.0, low, float(depths.min())), max(0.0, high, float(depths.max()))
    frame = _Frame(max(rgbd.shape[1] * rgbd.pixel_mm, 2 * half), *ends)
    drawn = [_range(frame, half, low, high), _surface(frame, rgbd)]
    drawn.append(_level(frame, half, 0.0, "panel"))
    centre = derived.get("central_depth_mm")
    if is_number(centre) and ends[0] <= centre <= ends[1]:
        drawn.append(_level(frame, half, centre, "cdp"))
    drawn += _labels(frame, low, high)
    words = f"Captured surface from {mm(ends[0])} to {mm(ends[1])}, from above"
    return svg(words, "plan profile", (_SIDE, _SIDE), drawn)


def _range(frame: _Frame, half: float, low: float, high: float) -> str:
    top, height = frame.y(high), max(1.5, frame.y(low) - frame.y(high))
    left, width = frame.x(-half), frame.x(half) - frame.x(-half)
    return (
        f'<rect class="range" x="{left:.1f}" y="{top:.1f}" '
        f'width="{width:.1f}" height="{height:.1f}"/>'
    )


def _surface(frame: _Frame, rgbd: RGBD) -> str:
    """A bar from the farthest to the nearest surface in each few columns of the picture."""
    columns = rgbd.shape[1]
    step = math.ceil(columns / _MOST_COLUMNS_DRAWN)
    bars = []
    for first in range(0, columns, step):
        here = np.s_[:, first : first + step]
        depths = rgbd.depth_mm[here][rgbd.covered[here]]
        if depths.size:
            left = frame.x((first - columns / 2) * rgbd.pixel_mm)
            bottom, top = frame.y(float(depths.min())), frame.y(float(depths.max()))
            wide = step * rgbd.pixel_mm * frame.px_per_mm
            bars.append(
                f"M{left:.2f},{bottom + 0.5:.1f}V{top - 0.5:.1f}h{wide:.2f}V{bottom + 0.5:.1f}z"
            )
    return f'<path class="surface" d="{"".join(bars)}"/>'


def _level(frame: _Frame, half: float, z_mm: float, kind: str) -> str:
    y = f"{frame.y(z_mm):.1f}"
    return (
        f'<line class="{kind}" x1="{frame.x(-half):.1f}" y1="{y}" '
        f'x2="{frame.x(half):.1f}" y2="{y}"/>'
    )


def _labels(frame: _Frame, low: float, high: float) -> list[str]:
    """The ends of the depth range and the array, left out where they would run into others."""
    wanted = [
        (frame.y(high) - 6, f"depth range to {mm(high)}"),
        (frame.y(low) + 16, f"from {mm(low)}"),
        (frame.y(0.0) + 16, "lens array"),
    ]
    placed: list[tuple[float, str]] = []
    for y, words in wanted:
        if all(abs(y - other) > _LABEL_PX for other, _ in placed):
            placed.append((y, words))
    scale = "to scale" if frame.stretch == 1 else f"depths drawn × {frame.stretch}"
    return [
        label(_SIDE / 2, 16, "towards the viewer ↑", "middle"),
        *(label(_LEFT, y, words, "start") for y, words in placed),
        label(_SIDE - _RIGHT, _SIDE - 8, scale, "end"),
    ]


SECTIONS = (ReportSection(90, "rgbd", "RGB-D input", rgbd),)
