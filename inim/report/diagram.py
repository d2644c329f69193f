"""A display seen from above: its plan view, and the depths of its RGB-D input."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from inim.display import Display
from inim.image.rgbd import RGBD
from inim.report import plots
from inim.report.labels import mm, plain, short
from inim.scores.document_parts import EyePosition
from inim.system.errors import DisplayError

_PLAN_INCHES = (9.2, 3.4)
_PROFILE_INCHES = (4.2, 4.2)
_MOST_EYES_DRAWN = 25
_MOST_COLUMNS_DRAWN = 256
_OUTLINE_POINTS = 201
# How far the plan view and its zone reach behind the eyes.
_BEHIND_EYES = 1.25


def zone_outline_mm(display: Display, farthest_mm: float) -> list[tuple[float, float]]:
    """Half widths of the viewing zone seen from above: (distance, farthest offset in x) in mm.

    From where the zone begins to `farthest_mm` or to its end, if the elemental images' pitch makes
    it close again; empty where it does not reach that far.
    """
    steps = [farthest_mm * (n + 1) / _OUTLINE_POINTS for n in range(_OUTLINE_POINTS)]
    limits = [(z, display.flip_limit_mm(z)[0]) for z in steps]
    return [(z, limit) for z, limit in limits if limit >= 0]


def draw_plan(axis: Any, display: Display, viewpoints: Sequence[EyePosition]) -> None:
    """Draw the plan view: the hardware at the left, the viewer at the right."""
    low, high = display.depth_range_mm
    half = display.width_mm / 2
    distances = [eye.position_mm[2] for eye in viewpoints if eye.position_mm[2] > 0]
    far = _BEHIND_EYES * max([*distances, high, half])
    outline = zone_outline_mm(display, far)
    if outline:
        z, limit = (np.array(values) for values in zip(*outline, strict=True))
        axis.fill_between(
            z, -limit, limit, color=plots.SKY, alpha=0.35, linewidth=0, label="no flips"
        )
    axis.fill_betweenx(
        [-half, half], low, high, color=plots.ORANGE, alpha=0.45, linewidth=0, label="depth range"
    )
    if low <= display.central_depth_mm <= high:
        dashed = {"color": plots.VERMILION, "linewidth": 1.2, "linestyle": "--"}
        at = [display.central_depth_mm] * 2
        axis.plot(at, [-half, half], **dashed, label="central depth plane")
    axis.plot([0, 0], [-half, half], color=plots.INK, linewidth=2.2, label="lens array")
    wide = display.eia_shape[1] * display.pixel_pitch_mm / 2
    axis.plot([-display.gap_mm] * 2, [-wide, wide], color=plots.GREEN, linewidth=1.6, label="panel")
    nearest = _nearest_distance_mm(display)
    if nearest <= far:
        dotted = {"color": plots.SOFT, "linewidth": 0.9, "linestyle": ":"}
        axis.axvline(nearest, **dotted, label="nearest, no flips")
    for distance in dict.fromkeys(distances[:1]):
        limit_mm = display.flip_limit_mm(distance)[0]
        if limit_mm >= 0:
            ends = [-limit_mm, limit_mm]
            axis.plot([distance] * 2, ends, "_-", color=plots.BLUE, linewidth=1, label="flip limit")
    eyes = [[eye.position_mm[n] for eye in viewpoints] for n in (2, 0)]
    ring = {"color": plots.BLUE, "markersize": 6, "markerfacecolor": "white", "linestyle": "none"}
    if viewpoints:
        axis.plot(*eyes, "o", **ring, label="eyes")
    axis.set_xlim(min(-display.gap_mm, low, -0.03 * far) * 1.2, far)
    plots.style(
        axis,
        "Plan view, from above (scales differ)",
        "distance from the lens array z, mm",
        "to the viewer's right x, mm",
    )
    axis.legend(loc="upper left", bbox_to_anchor=(0, -0.2), ncols=4, **plots.LEGEND)


def _nearest_distance_mm(display: Display) -> float:
    try:
        return display.nearest_viewing_distance_mm
    except DisplayError:
        return math.inf


@plots.reproducible()
def plan_view(display: Display, viewpoints: Sequence[EyePosition]) -> bytes:
    """The plan view with the eyes' names, as SVG."""
    first_eyes = viewpoints[:_MOST_EYES_DRAWN]
    names: dict[tuple[float, float], list[str]] = {}  # seen from above, up and down are one place
    for eye in first_eyes:
        x, _, z = eye.position_mm
        names.setdefault((round(z, 6), round(x, 6)), []).append(plain(eye.name).replace("$", r"\$"))
    figure = plots.blank_figure(_PLAN_INCHES)
    figure.subplots_adjust(left=0.08, right=0.985, bottom=0.27, top=0.91)
    axis = figure.subplots()
    draw_plan(axis, display, first_eyes)
    plots.set_apart(
        axis, [plots.Name(", ".join(n), z, x, plots.SOFT, 8) for (z, x), n in names.items()]
    )
    return plots.svg(figure)


def describe_plan(display: Display, viewpoints: Sequence[EyePosition]) -> str:
    """The plan view in words."""
    eyes = "; ".join(f"{eye.name} at {short(eye.position_mm[2])} mm" for eye in viewpoints)
    low, high = map(short, display.depth_range_mm)
    return (
        f"Plan view: panel {short(display.gap_mm)} mm behind a lens array "
        f"{short(display.width_mm)} mm wide; depth range from {low} to {high} mm; "
        f"eyes: {eyes or 'none'}."
    )


def column_depths(rgbd: RGBD) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position x, farthest and nearest depth of some columns of a picture, mm, (n,) each.

    NaN where nothing is covered. Wide pictures have several columns in one.
    """
    depth = np.where(rgbd.covered, rgbd.depth_mm, np.nan)
    columns = depth.shape[1]
    step = math.ceil(columns / _MOST_COLUMNS_DRAWN)
    starts = np.arange(0, columns, step)
    x = (starts + step / 2 - columns / 2) * rgbd.pixel_mm
    far, near = (f.reduceat(f.reduce(depth, axis=0), starts) for f in (np.fmin, np.fmax))
    return x, far, near


@plots.reproducible()
def depth_profile(rgbd: RGBD, display: Display) -> bytes:
    """Depths of a picture along the array, from above, all rows together, as SVG."""
    (low, high), half = display.depth_range_mm, display.width_mm / 2
    x, far, near = column_depths(rgbd)
    figure = plots.blank_figure(_PROFILE_INCHES)
    figure.subplots_adjust(left=0.15, right=0.97, bottom=0.25, top=0.92)
    axis = figure.subplots()
    band = {"color": plots.ORANGE, "alpha": 0.45, "linewidth": 0}
    axis.fill_between([-half, half], low, high, **band, label="depth range")
    axis.fill_between(x, far, near, step="mid", color=plots.INK, linewidth=0.8, label="relic")
    axis.plot([-half, half], [0, 0], color=plots.GREEN, linewidth=2.2, label="lens array")
    if min(0.0, low) <= display.central_depth_mm <= max(0.0, high):
        dashed = {"color": plots.VERMILION, "linewidth": 1.2, "linestyle": "--"}
        axis.plot([-half, half], [display.central_depth_mm] * 2, **dashed, label="CDP")
    plots.style(axis, "From above (scales differ)", "x, mm", "depth z, towards the viewer, mm")
    axis.legend(loc="upper left", bbox_to_anchor=(0, -0.14), ncols=2, **plots.LEGEND)
    return plots.svg(figure)


def describe_profile(rgbd: RGBD) -> str:
    """The depth profile in words."""
    depths = rgbd.depth_mm[rgbd.covered]
    return f"Captured surface from {mm(float(depths.min()))} to {mm(float(depths.max()))}"
