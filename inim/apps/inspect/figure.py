"""The findings in one figure: plan view, voxel size, spot diagrams, crosstalk map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from inim.apps.inspect.document import InspectDocument
from inim.apps.inspect.spots import Spot
from inim.report.diagram import draw_plan
from inim.report.plots import (
    BLUE,
    GREEN,
    INK,
    LEGEND,
    ORANGE,
    SOFT,
    VERMILION,
    blank_figure,
    save,
    style,
)

if TYPE_CHECKING:
    from inim.apps.inspect.findings import Inspection

_SIZE_INCHES = (13.0, 8.6)
_SPOT_MARKS = {"all": (BLUE, "o"), "red": (VERMILION, "s"), "green": (GREEN, "^")} | {
    "blue": (BLUE, "o")
}
# Smaller spots are points, but for rounding.
_ROUNDING_UM = 1e-6
# The map's colours reach this far at least: noise must not pass for crosstalk.
_LEAST_SCALE_PERCENT = 1.0


def draw_figure(inspection: Inspection, folder: Path, name: str = "inspect") -> list[str]:
    """Write ``NAME.svg`` and ``NAME.png`` into `folder`; the names of the files."""
    data = inspection.document
    figure = blank_figure(_SIZE_INCHES, "constrained")
    grid = figure.add_gridspec(2, 12, height_ratios=(1, 0.82), hspace=0.06)
    draw_plan(figure.add_subplot(grid[0, :7]), data.display, data.viewing.viewpoints)
    _draw_voxels(figure.add_subplot(grid[0, 7:]), data)
    pixel_um = 1e3 * data.display.pixel_pitch_mm
    axes = [figure.add_subplot(grid[1, n : n + 3]) for n in (0, 3, 6)]
    _draw_spots(axes, inspection.spots, pixel_um)
    _draw_crosstalk(figure.add_subplot(grid[1, 9:]), data)
    title = f"Display {data.display.name}, {data.lens_model.name} lenses"
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, color=INK)
    save(figure, folder, name)
    return [f"{name}.svg", f"{name}.png"]


def _draw_voxels(axis: Any, data: InspectDocument) -> None:
    """Voxel size against depth, with its two parts."""
    display, curve = data.display, data.voxel
    low, high = display.depth_range_mm
    axis.axvspan(low, high, color=ORANGE, alpha=0.25, linewidth=0, label="depth range")
    z, dotted = curve.depth_mm, {"color": VERMILION, "linestyle": ":", "linewidth": 1.8}
    axis.plot(z, curve.width_mm, color=BLUE, linewidth=2, label="voxel: both together")
    axis.plot(z, curve.footprint_mm, color=GREEN, linestyle="--", label="pixel footprint")
    axis.plot(z, curve.blur_mm, **dotted, label="blur of the lens aperture")
    if z[0] <= display.central_depth_mm <= z[-1]:
        point = display.central_depth_mm, display.scene_pixel_mm
        diamond = {"color": INK, "markersize": 5, "linestyle": "none"}
        axis.plot(*point, "D", **diamond, label="P_I at the central depth plane")
    axis.set_ylim(bottom=0)
    axis.set_xlim(z[0], z[-1])
    style(axis, "Voxel size", "depth z, mm", "width, mm")
    axis.legend(loc="upper left", bbox_to_anchor=(0, -0.14), ncols=2, **LEGEND)


def _draw_spots(axes: Sequence[Any], spots: Sequence[Spot], pixel_um: float) -> None:
    """A diagram for each field angle, on one scale, with a panel pixel's outline."""
    from matplotlib.patches import Rectangle

    largest = [float(np.abs(v).max()) for s in spots for v in (s.x_um, s.y_um) if v.size]
    reach = 1.12 * max([pixel_um / 2, *largest])
    angles = sorted({s.field_angle_deg for s in spots})
    for n, (axis, angle) in enumerate(zip(axes, angles, strict=True)):
        at_angle = [s for s in spots if s.field_angle_deg == angle]
        frame = {"fill": False, "edgecolor": INK, "linestyle": "--", "zorder": 4}
        axis.add_patch(Rectangle((-pixel_um / 2, -pixel_um / 2), pixel_um, pixel_um, **frame))
        dots = {"markersize": 2, "markeredgewidth": 0, "alpha": 0.7, "linestyle": "none"}
        for spot in at_angle:
            colour, mark = _SPOT_MARKS[spot.colour]
            axis.plot(spot.x_um, spot.y_um, mark, color=colour, **dots, label=spot.colour)
        radius = ", ".join(map(_radius, at_angle))
        axis.set_xlim(-reach, reach)
        axis.set_ylim(-reach, reach)
        axis.set_aspect("equal")
        style(
            axis,
            f"Spot at {angle:.3g}°\nRMS radius {radius} µm",
            "x on the panel, µm\ndashed: one panel pixel" if n == 0 else "x on the panel, µm\n",
            "y on the panel, µm" if n == 0 else "",
        )
    if len(spots) > len(angles):
        below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.14), "ncols": 3}
        axes[1].legend(**below, markerscale=3, handletextpad=0.1, **LEGEND)


def _radius(spot: Spot) -> str:
    """The radius, after the colour's initial where there are several."""
    colour = "" if spot.colour == "all" else f"{spot.colour[0].upper()} "
    radius = spot.rms_radius_um
    if math.isnan(radius):
        return f"{colour}–"
    return f"{colour}{radius:.3g}" if radius > _ROUNDING_UM else f"{colour}0"


def _draw_crosstalk(axis: Any, data: InspectDocument) -> None:
    """Crosstalk over eye positions, the formula's flip limit drawn on it."""
    from matplotlib.patches import Rectangle

    crosstalk, zone = data.crosstalk, data.viewing
    percent = 100 * np.array(crosstalk.share, float)
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
    bar = axis.figure.colorbar(mesh, ax=axis, shrink=0.75, pad=0.02)
    bar.set_label("crosstalk, %", fontsize=9, color=SOFT)
    bar.ax.tick_params(labelsize=8, colors=SOFT, length=2.5)
    bar.outline.set_visible(False)
    if not zone.zone_is_empty:
        limit_x, limit_y = zone.flip_limit_x_mm, zone.flip_limit_y_mm
        if limit_y is None:
            limit_y = max(crosstalk.eye_y_mm)
        axis.add_patch(
            Rectangle((-limit_x, -limit_y), 2 * limit_x, 2 * limit_y, fill=False, edgecolor="white")
        )
    x, y = ([v.position_mm[n] for v in zone.viewpoints] for n in (0, 1))
    axis.plot(x, y, "o", color="white", markersize=4, markerfacecolor="none", linestyle="none")
    frame = "no eye is free of flips" if zone.zone_is_empty else "frame: flip limit"
    style(
        axis,
        f"Crosstalk, eyes at {zone.distance_mm:.4g} mm\n{frame}, rings: default eyes",
        "eye x, mm\n",
        "eye y, mm",
    )
    axis.grid(False)
