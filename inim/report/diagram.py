"""The display and the depths of its RGB-D input, seen from above, as inline SVGs.

The plan view: panel and lens array on the left, the viewer on the right; in between the depth
range, the central depth plane and the zone in which an eye sees no flipped view. Distances from the
array are to scale. Those across it are stretched by a whole factor where the drawing would
otherwise be a thin strip, which the drawing states.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inim.display import Display
from inim.documents.parts import DerivedDisplay, DisplayRecord, EyePosition
from inim.errors import InimError
from inim.files.image import read_rgbd
from inim.image.rgbd import RGBD
from inim.report.labels import mm, plain, short
from inim.report.page import element, text

_WIDTH, _HEIGHT = 900.0, 250.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 24.0, 128.0, 34.0, 46.0
_MOST_LENSES_DRAWN = 40
_MOST_EYES_DRAWN = 25
_SMALLEST_GAP_PX = 5.0
_LABEL_PX = 130.0, 14.0  # room a label takes, across and down

_PROFILE_SIDE = 400.0
_MARGIN, _PROFILE_TOP, _PROFILE_BOTTOM = 12.0, 46.0, 44.0
_PROFILE_LABEL_PX = 15.0
_MOST_COLUMNS_DRAWN = 256


@dataclass(frozen=True)
class _Frame:
    """Millimetres to drawing units: z runs to the right, x (the viewer's right) downwards."""

    low_z_mm: float
    px_per_mm: float
    stretch: int

    def z(self, z_mm: float) -> float:
        return _LEFT + (z_mm - self.low_z_mm) * self.px_per_mm

    def x(self, x_mm: float) -> float:
        middle = (_TOP + _HEIGHT - _BOTTOM) / 2
        return middle + x_mm * self.px_per_mm * self.stretch


def plan_view(display: DisplayRecord, viewpoints: Sequence[EyePosition] = ()) -> str:
    """The plan view."""
    parameters, derived = display.parameters, display.derived
    eyes = _eyes(viewpoints)
    frame = _frame(parameters, derived, eyes)
    elements = [
        _zone(frame, derived),
        _depth_range(frame, derived),
        _hardware(frame, parameters, derived),
        *_eye_marks(frame, eyes),
        _scale_bar(frame),
    ]
    return _svg(_description(parameters, derived, eyes), "plan", (_WIDTH, _HEIGHT), elements)


def _svg(description: str, class_: str, size: tuple[float, float], elements: Iterable[str]) -> str:
    """A drawing coloured by the style sheet's classes, with its own description."""
    whole = {"role": "img", "aria_label": description, "viewBox": f"0 0 {size[0]:g} {size[1]:g}"}
    return element("svg", *elements, class_=class_, **whole)


def _band(x: float, y: float, width: float, height: float) -> str:
    """The depth range."""
    place = f'x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}"'
    return f'<rect class="range" {place}/>'


def _label(x: float, y: float, words: str, anchor: str) -> str:
    """Words in a drawing; `anchor` is start, middle or end."""
    return element("text", text(words), x=f"{x:.1f}", y=f"{y:.1f}", text_anchor=anchor)


def _eyes(viewpoints: Sequence[EyePosition]) -> dict[tuple[float, float], str]:
    """Names of the eyes at each (x, z): seen from above, up and down are one place."""
    eyes: dict[tuple[float, float], str] = {}
    for viewpoint in viewpoints[:_MOST_EYES_DRAWN]:
        x, _, z = viewpoint.position_mm
        position, name = (round(x, 6), round(z, 6)), plain(viewpoint.name)
        eyes[position] = f"{eyes[position]}, {name}" if position in eyes else name
    return eyes


def _frame(
    parameters: Display, derived: DerivedDisplay, eyes: Mapping[tuple[float, float], str]
) -> _Frame:
    far = [derived.depth_max_mm, derived.width_mm / 4, *(z for _, z in eyes)]
    nearest = derived.nearest_viewing_distance_mm
    if nearest is not None:
        far.append(nearest)
    low = min(-parameters.gap_mm, derived.depth_min_mm)
    px_per_mm = (_WIDTH - _LEFT - _RIGHT) / (max(far) - low)
    half = max([derived.width_mm / 2, *(abs(x) for x, _ in eyes)])
    room = (_HEIGHT - _TOP - _BOTTOM) / 2
    if half * px_per_mm > room:  # a display wider than its viewing distance is drawn smaller
        px_per_mm = room / half
    return _Frame(low, px_per_mm, max(1, int(room / (half * px_per_mm))))


def _zone(frame: _Frame, derived: DerivedDisplay) -> str:
    """Region of allowed eye positions: inside the viewing cones of both outermost lenses."""
    slope = math.tan(math.radians(derived.viewing_half_angle_deg))
    half = derived.width_mm / 2
    end = frame.low_z_mm + (_WIDTH - _LEFT - _RIGHT + 24) / frame.px_per_mm
    apex, reach = half / slope, slope * end - half
    lines = [_line(frame, (side * half, 0), (-side * reach, end), "ray") for side in (-1, 1)]
    if apex >= end:
        return "".join(lines)
    corners = [(0.0, apex), (reach, end), (-reach, end)]
    points = " ".join(f"{frame.z(z):.1f},{frame.x(x):.1f}" for x, z in corners)
    return f'<polygon class="zone" points="{points}"/>' + "".join(lines)


def _depth_range(frame: _Frame, derived: DerivedDisplay) -> str:
    half = derived.width_mm / 2
    low, high = derived.depth_min_mm, derived.depth_max_mm
    x, width = frame.z(low), max(1.5, (high - low) * frame.px_per_mm)
    top, height = frame.x(-half), frame.x(half) - frame.x(-half)
    centre = derived.central_depth_mm
    plane = ""
    if centre is not None and low <= centre <= high:
        plane = _line(frame, (-half, centre), (half, centre), "cdp")
    words = f"depth range {short(low)} to {short(high)} mm"
    return _band(x, top, width, height) + plane + _label(x, _HEIGHT - 26, words, "start")


def _hardware(frame: _Frame, parameters: Display, derived: DerivedDisplay) -> str:
    """The panel and the lens array; the gap is widened where it would not be visible."""
    half = derived.width_mm / 2
    array = frame.z(0)
    panel = min(frame.z(-parameters.gap_mm), array - _SMALLEST_GAP_PX)
    top, bottom = frame.x(-half), frame.x(half)
    # A bulge per lens, fewer where they would run together.
    count = min(parameters.lens_columns, _MOST_LENSES_DRAWN)
    step = (bottom - top) / count
    bulges = "".join(f"q4,{step / 2:.2f} 0,{step:.2f}" for _ in range(count))
    return (
        f'<line class="panel" x1="{panel:.1f}" x2="{panel:.1f}" y1="{top:.1f}" y2="{bottom:.1f}"/>'
        f'<path class="lenses" d="M{array:.1f},{top:.1f}{bulges}Z"/>'
        + _label(panel - 4, 20, "panel and lens array", "start")
    )


def _eye_marks(frame: _Frame, eyes: Mapping[tuple[float, float], str]) -> Iterable[str]:
    """A ring for each eye, and its names where they do not run into others."""
    labelled: list[tuple[float, float]] = []
    for (x, z), names in eyes.items():
        right, down = frame.z(z), frame.x(x)
        yield f'<circle class="eye" cx="{right:.1f}" cy="{down:.1f}" r="4.5"/>'
        if all(abs(right - r) > _LABEL_PX[0] or abs(down - d) > _LABEL_PX[1] for r, d in labelled):
            labelled.append((right, down))
            words = names if len(names) <= 22 else names[:21] + "…"
            yield _label(right + 11, down + 4, words, "start")


def _scale_bar(frame: _Frame) -> str:
    """Bar of a round length along z, with a note on scales."""
    longest = 160 / frame.px_per_mm
    power = 10.0 ** math.floor(math.log10(longest))
    length = max(n * power for n in (1, 2, 5) if n * power <= longest)
    end = _WIDTH - _RIGHT
    start, y = end - length * frame.px_per_mm, _HEIGHT - 30
    across = "to scale" if frame.stretch == 1 else f"widths drawn × {frame.stretch}"
    return f'<path class="scale" d="M{start:.1f},{y - 4}v8m0,-4H{end:.1f}m0,-4v8"/>' + _label(
        end, _HEIGHT - 10, f"{short(length)} mm, {across}", "end"
    )


def _description(
    parameters: Display, derived: DerivedDisplay, eyes: Mapping[tuple[float, float], str]
) -> str:
    eye_positions = "; ".join(f"{name} at {short(z)} mm" for (_, z), name in eyes.items())
    low, high = short(derived.depth_min_mm), short(derived.depth_max_mm)
    gap, width = short(parameters.gap_mm), short(derived.width_mm)
    return (
        f"Plan view: panel {gap} mm behind a lens array {width} mm wide; "
        f"depth range from {low} to {high} mm; eyes: {eye_positions or 'none'}."
    )


def _line(frame: _Frame, start: tuple[float, float], end: tuple[float, float], kind: str) -> str:
    (x1, z1), (x2, z2) = start, end
    return (
        f'<line class="{kind}" x1="{frame.z(z1):.1f}" y1="{frame.x(x1):.1f}" '
        f'x2="{frame.z(z2):.1f}" y2="{frame.x(x2):.1f}"/>'
    )


def depth_profile(folder: Path, display: Display) -> str:
    """The drawing, or an empty string without a readable ``rgbd.exr``.

    Parameters
    ----------
    folder : Path
        The report's folder.
    display : Display

    Returns
    -------
    str
        An ``<svg>`` element with its own description: x to the right as in the images, depth
        upwards to the viewer, the band between farthest and nearest surface of each column.
    """
    try:
        rgbd = read_rgbd(folder / "rgbd.exr")
    except InimError:
        return ""
    return _profile(rgbd, display) if rgbd.covered.any() else ""


class _Profile:
    """Millimetres to drawing units; depths are stretched by a whole factor where they are flat."""

    def __init__(self, width_mm: float, low_mm: float, high_mm: float) -> None:
        room = _PROFILE_SIDE - _PROFILE_TOP - _PROFILE_BOTTOM
        self.low_mm = low_mm
        self.px_per_mm = min(
            (_PROFILE_SIDE - _MARGIN - _MARGIN) / width_mm, room / (high_mm - low_mm)
        )
        self.stretch = max(1, int(room / ((high_mm - low_mm) * self.px_per_mm)))

    def x(self, x_mm: float) -> float:
        return _PROFILE_SIDE / 2 + x_mm * self.px_per_mm

    def y(self, z_mm: float) -> float:
        return (
            _PROFILE_SIDE - _PROFILE_BOTTOM - (z_mm - self.low_mm) * self.px_per_mm * self.stretch
        )


def _profile(rgbd: RGBD, display: Display) -> str:
    (low, high), half = display.depth_range_mm, display.width_mm / 2
    depths = rgbd.depth_mm[rgbd.covered]
    ends = min(0.0, low, float(depths.min())), max(0.0, high, float(depths.max()))
    frame = _Profile(max(rgbd.shape[1] * rgbd.pixel_mm, 2 * half), *ends)
    left, width = frame.x(-half), frame.x(half) - frame.x(-half)
    height = max(1.5, frame.y(low) - frame.y(high))
    elements = [_band(left, frame.y(high), width, height), _surface(frame, rgbd)]
    elements.append(_level(frame, half, 0.0, "panel"))
    centre = display.central_depth_mm
    if ends[0] <= centre <= ends[1]:
        elements.append(_level(frame, half, centre, "cdp"))
    elements += _profile_labels(frame, low, high)
    words = f"Captured surface from {mm(ends[0])} to {mm(ends[1])}, from above"
    return _svg(words, "plan profile", (_PROFILE_SIDE, _PROFILE_SIDE), elements)


def _surface(frame: _Profile, rgbd: RGBD) -> str:
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


def _level(frame: _Profile, half: float, z_mm: float, kind: str) -> str:
    y = f"{frame.y(z_mm):.1f}"
    return (
        f'<line class="{kind}" x1="{frame.x(-half):.1f}" y1="{y}" '
        f'x2="{frame.x(half):.1f}" y2="{y}"/>'
    )


def _profile_labels(frame: _Profile, low: float, high: float) -> list[str]:
    """The ends of the depth range and the array, left out where they would run into others."""
    labels = [
        (frame.y(high) - 6, f"depth range to {mm(high)}"),
        (frame.y(low) + 16, f"from {mm(low)}"),
        (frame.y(0.0) + 16, "lens array"),
    ]
    placed: list[tuple[float, str]] = []
    for y, words in labels:
        if all(abs(y - other) > _PROFILE_LABEL_PX for other, _ in placed):
            placed.append((y, words))
    scale = "to scale" if frame.stretch == 1 else f"depths drawn × {frame.stretch}"
    return [
        _label(_PROFILE_SIDE / 2, 16, "towards the viewer ↑", "middle"),
        *(_label(_MARGIN, y, words, "start") for y, words in placed),
        _label(_PROFILE_SIDE - _MARGIN, _PROFILE_SIDE - 8, scale, "end"),
    ]
