"""The findings in one figure: plan view, voxel size, spot diagrams, crosstalk map."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from inim.files.image import write_atomically
from inim.inspect.findings import Findings
from inim.inspect.geometry import zone_outline_mm
from inim.inspect.spots import Spot

_PNG_DPI = 130
_SIZE_INCHES = (13.0, 8.6)
_INK, _SOFT, _LINE = "#1e2022", "#5a5f63", "#dedbd3"
_LEGEND = {"fontsize": 8, "frameon": False, "labelcolor": _INK}
# Okabe and Ito's colours, distinguishable with any colour vision.
_BLUE, _VERMILION, _GREEN, _ORANGE, _SKY = "#0072b2", "#d55e00", "#009e73", "#e69f00", "#56b4e9"
_SPOT_MARKS = {"all": (_BLUE, "o"), "red": (_VERMILION, "s"), "green": (_GREEN, "^")} | {
    "blue": (_BLUE, "o")
}
# Smaller spots are points, but for rounding.
_ROUNDING_UM = 1e-6
# The map's colours reach this far at least: noise must not pass for crosstalk.
_LEAST_SCALE_PERCENT = 1.0
# How far the plan view and its zone reach behind the eyes.
_BEHIND_EYES = 1.25


def draw_figure(findings: Findings, folder: Path, name: str = "inspect") -> list[str]:
    """Write ``NAME.svg`` and ``NAME.png`` into `folder`; the names of the files."""
    from matplotlib import rc_context

    # Without a date or random ids, equal findings give equal files. Text stays text.
    fixed = {"svg.hashsalt": "inim", "svg.fonttype": "none"}
    with rc_context(fixed):
        figure = _figure(findings)
        svg = {"metadata": {"Date": None}}
        write_atomically(folder / f"{name}.svg", lambda p: figure.savefig(p, **svg))
        write_atomically(folder / f"{name}.png", lambda p: figure.savefig(p, dpi=_PNG_DPI))
    return [f"{name}.svg", f"{name}.png"]


def _figure(findings: Findings) -> Any:
    """Figure without global state or display."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_INCHES, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 12, height_ratios=(1, 0.82), hspace=0.06)
    _plan_view(figure.add_subplot(grid[0, :7]), findings)
    _voxels(figure.add_subplot(grid[0, 7:]), findings)
    _all_spots([figure.add_subplot(grid[1, n : n + 3]) for n in (0, 3, 6)], findings)
    _crosstalk(figure, figure.add_subplot(grid[1, 9:]), findings)
    title = f"Display {findings.design.name}, {findings.lens_model} lenses"
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, color=_INK)
    return figure


def _style(axis: Any, title: str, x_label: str, y_label: str) -> None:
    axis.set_title(title, loc="left", fontsize=10, color=_INK)
    axis.set_xlabel(x_label, fontsize=9, color=_SOFT)
    axis.set_ylabel(y_label, fontsize=9, color=_SOFT)
    axis.tick_params(labelsize=8, colors=_SOFT, length=2.5)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axis.spines[side].set_color(_LINE)


def _grid_and_legend(axis: Any, columns: int) -> None:
    axis.grid(True, color=_LINE, linewidth=0.6)
    axis.set_axisbelow(True)
    axis.legend(loc="upper left", bbox_to_anchor=(0, -0.14), ncols=columns, **_LEGEND)


def _plan_view(axis: Any, findings: Findings) -> None:
    """Seen from above: the hardware at the left, the viewer at the right."""
    display, zone = findings.design, findings.zone
    far = _BEHIND_EYES * max(zone.distance_mm, display.depth_range_mm[1])
    outline = zone_outline_mm(display, far)
    if outline:
        z, limit = (np.array(values) for values in zip(*outline, strict=True))
        axis.fill_between(z, -limit, limit, color=_SKY, alpha=0.35, linewidth=0, label="no flips")
    low, high = display.depth_range_mm
    half = display.width_mm / 2
    axis.fill_betweenx(
        [-half, half], low, high, color=_ORANGE, alpha=0.45, linewidth=0, label="depth range"
    )
    if low <= display.central_depth_mm <= high:
        dashed = {"color": _VERMILION, "linewidth": 1.2, "linestyle": "--"}
        at = [display.central_depth_mm] * 2
        axis.plot(at, [-half, half], **dashed, label="central depth plane")
    axis.plot([0, 0], [-half, half], color=_INK, linewidth=2.2, label="lens array")
    wide = display.eia_shape[1] * display.pixel_pitch_mm / 2
    axis.plot([-display.gap_mm] * 2, [-wide, wide], color=_GREEN, linewidth=1.6, label="panel")
    if zone.nearest_distance_mm is not None and zone.nearest_distance_mm <= far:
        axis.axvline(
            zone.nearest_distance_mm,
            color=_SOFT,
            linewidth=0.9,
            linestyle=":",
            label="nearest, no flips",
        )
    if not zone.zone_is_empty:
        at, limit_mm = [zone.distance_mm] * 2, zone.flip_limit_x_mm
        axis.plot(at, [-limit_mm, limit_mm], "_-", color=_BLUE, linewidth=1, label="flip limit")
    eyes = [[v.position_mm[n] for v in zone.viewpoints] for n in (2, 0)]
    ring = {"color": _BLUE, "markersize": 6, "markerfacecolor": "white", "linestyle": "none"}
    axis.plot(*eyes, "o", **ring, label="default eyes")
    axis.set_xlim(min(-display.gap_mm, low, -0.03 * far) * 1.2, far)
    _style(
        axis,
        "Plan view, from above (scales differ)",
        "distance from the lens array z, mm",
        "to the viewer's right x, mm",
    )
    _grid_and_legend(axis, 4)


def _voxels(axis: Any, findings: Findings) -> None:
    """Voxel size against depth, with its two parts."""
    display, curve = findings.design, findings.voxels
    low, high = display.depth_range_mm
    axis.axvspan(low, high, color=_ORANGE, alpha=0.25, linewidth=0, label="depth range")
    z, dotted = curve.depth_mm, {"color": _VERMILION, "linestyle": ":", "linewidth": 1.8}
    axis.plot(z, curve.width_mm, color=_BLUE, linewidth=2, label="voxel: both together")
    axis.plot(z, curve.footprint_mm, color=_GREEN, linestyle="--", label="pixel footprint")
    axis.plot(z, curve.blur_mm, **dotted, label="blur of the lens aperture")
    if z[0] <= display.central_depth_mm <= z[-1]:
        point = display.central_depth_mm, display.scene_pixel_mm
        diamond = {"color": _INK, "markersize": 5, "linestyle": "none"}
        axis.plot(*point, "D", **diamond, label="P_I at the central depth plane")
    axis.set_ylim(bottom=0)
    axis.set_xlim(z[0], z[-1])
    _style(axis, "Voxel size", "depth z, mm", "width, mm")
    _grid_and_legend(axis, 2)


def _all_spots(axes: list[Any], findings: Findings) -> None:
    """A diagram for each field angle, on one scale, with a panel pixel's outline."""
    from matplotlib.patches import Rectangle

    pixel = 1e3 * findings.design.pixel_pitch_mm
    largest = [float(np.abs(v).max()) for s in findings.spots for v in (s.x_um, s.y_um) if v.size]
    reach = 1.12 * max([pixel / 2, *largest])
    angles = sorted({s.field_angle_deg for s in findings.spots})
    for n, (axis, angle) in enumerate(zip(axes, angles, strict=True)):
        spots = [s for s in findings.spots if s.field_angle_deg == angle]
        frame = {"fill": False, "edgecolor": _INK, "linestyle": "--", "zorder": 4}
        axis.add_patch(Rectangle((-pixel / 2, -pixel / 2), pixel, pixel, **frame))
        dots = {"markersize": 2, "markeredgewidth": 0, "alpha": 0.7, "linestyle": "none"}
        for spot in spots:
            colour, mark = _SPOT_MARKS[spot.colour]
            axis.plot(spot.x_um, spot.y_um, mark, color=colour, **dots, label=spot.colour)
        radius = ", ".join(map(_radius, spots))
        axis.set_xlim(-reach, reach)
        axis.set_ylim(-reach, reach)
        axis.set_aspect("equal")
        _style(
            axis,
            f"Spot at {angle:.3g}°\nRMS radius {radius} µm",
            "x on the panel, µm\ndashed: one panel pixel" if n == 0 else "x on the panel, µm\n",
            "y on the panel, µm" if n == 0 else "",
        )
    if len(findings.spots) > len(angles):
        below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.14), "ncols": 3}
        axes[1].legend(**below, markerscale=3, handletextpad=0.1, **_LEGEND)


def _radius(spot: Spot) -> str:
    """The radius, after the colour's initial where there are several."""
    colour = "" if spot.colour == "all" else f"{spot.colour[0].upper()} "
    radius = spot.rms_radius_um
    if math.isnan(radius):
        return f"{colour}–"
    return f"{colour}{radius:.3g}" if radius > _ROUNDING_UM else f"{colour}0"


def _crosstalk(figure: Any, axis: Any, findings: Findings) -> None:
    """Crosstalk over eye positions, the formula's flip limit drawn on it."""
    from matplotlib.patches import Rectangle

    crosstalk, zone = findings.crosstalk, findings.zone
    percent = 100 * crosstalk.share
    finite = percent[np.isfinite(percent)]
    mesh = axis.pcolormesh(
        crosstalk.eye_x_mm,
        crosstalk.eye_y_mm,
        percent,
        cmap="cividis",
        shading="nearest",
        vmin=0,
        vmax=max(_LEAST_SCALE_PERCENT, finite.max(initial=0.0)),
        rasterized=True,
    )
    bar = figure.colorbar(mesh, ax=axis, shrink=0.75, pad=0.02)
    bar.set_label("crosstalk, %", fontsize=9, color=_SOFT)
    bar.ax.tick_params(labelsize=8, colors=_SOFT, length=2.5)
    bar.outline.set_visible(False)
    if not zone.zone_is_empty:
        limit_x, limit_y = zone.flip_limit_x_mm, zone.flip_limit_y_mm
        axis.add_patch(
            Rectangle((-limit_x, -limit_y), 2 * limit_x, 2 * limit_y, fill=False, edgecolor="white")
        )
    x, y = ([v.position_mm[n] for v in zone.viewpoints] for n in (0, 1))
    axis.plot(x, y, "o", color="white", markersize=4, markerfacecolor="none", linestyle="none")
    frame = "no eye is free of flips" if zone.zone_is_empty else "frame: flip limit"
    _style(
        axis,
        f"Crosstalk, eyes at {zone.distance_mm:.4g} mm\n{frame}, rings: default eyes",
        "eye x, mm\n",
        "eye y, mm",
    )
