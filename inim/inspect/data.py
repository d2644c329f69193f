"""Findings as JSON, schema `inim.inspect/1`: stable keys with units, null for infinity."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from inim.inspect.cautions import cautions, misalignments
from inim.inspect.crosstalk import LightShares
from inim.inspect.findings import Findings
from inim.inspect.geometry import has_whole_pixels, mode, zone_outline_mm
from inim.inspect.spots import Spot
from inim.inspect.voxel import voxel_mm
from inim.version import __version__

__all__ = ["SCHEMA", "as_data"]

SCHEMA = "inim.inspect/1"


def as_data(findings: Findings) -> dict[str, Any]:
    """The findings as plain data, ready for strict JSON.

    Curves and maps are lists; ``crosstalk.share`` has one row per ``eye_y_mm``. Numbers that are
    infinite or unknown are None.
    """
    data: dict[str, Any] = {
        "schema": SCHEMA,
        "inim_version": __version__,
        "source": findings.source,
        "display": findings.design.given(),
        "lens_model": {"name": findings.lens_model, "reason": findings.model_reason},
        "size": _size(findings),
        "depth": _depth(findings),
        "pixels_per_lens": [asdict(choice) for choice in findings.choices],
        "viewing": _viewing(findings),
        "voxel": {k: v.tolist() for k, v in vars(findings.voxels).items()},
        "spots": [_spot(s) for s in findings.spots],
        "light": {name: _light(shares) for name, shares in findings.light.items()},
        "crosstalk": {k: v.tolist() for k, v in vars(findings.crosstalk).items()},
        "misalignment": misalignments(findings.design, findings.mounted),
        "warnings": cautions(findings),
    }
    finite: dict[str, Any] = _finite(data)
    return finite


def _size(findings: Findings) -> dict[str, Any]:
    display = findings.design
    rows, columns = display.eia_shape
    return {
        "width_mm": display.width_mm,
        "height_mm": display.height_mm,
        "lens_columns": display.lens_columns,
        "lens_rows": display.lens_rows,
        "panel_columns": columns,
        "panel_rows": rows,
        "panel_width_mm": columns * display.pixel_pitch_mm,
        "panel_height_mm": rows * display.pixel_pitch_mm,
        "pixels_per_lens": display.pixels_per_lens,
        "has_whole_pixels_per_lens": has_whole_pixels(display),
    }


def _depth(findings: Findings) -> dict[str, Any]:
    display = findings.design
    low, high = display.depth_range_mm
    return {
        "mode": mode(display),
        "central_depth_mm": display.central_depth_mm,
        "scene_pixel_mm": display.scene_pixel_mm,
        "depth_span_mm": display.depth_span_mm,
        "depth_min_mm": low,
        "depth_max_mm": high,
        "depth_range_is_cut": display.depth_range_is_cut,
        "depth_range_is_stated": display.depth_min_mm is not None,
        "voxel_at_depth_min_mm": float(voxel_mm(display, low)),
        "voxel_at_depth_max_mm": float(voxel_mm(display, high)),
    }


def _viewing(findings: Findings) -> dict[str, Any]:
    zone = findings.zone
    return {
        "half_angle_deg": zone.half_angle_deg,
        "nearest_distance_mm": zone.nearest_mm,
        "distance_mm": zone.distance_mm,
        "flip_limit_x_mm": zone.limit_x_mm,
        "flip_limit_y_mm": zone.limit_y_mm,
        "flip_limit_x_deg": zone.limit_x_deg,
        "flip_limit_y_deg": zone.limit_y_deg,
        "zone_is_empty": zone.is_empty,
        "zone_distance_and_limit_x_mm": zone_outline_mm(findings.design, 1.5 * zone.distance_mm),
        "viewpoints": [{"name": v.name, "position_mm": v.position_mm} for v in zone.viewpoints],
    }


def _spot(spot: Spot) -> dict[str, Any]:
    return {
        "field_angle_deg": spot.field_angle_deg,
        "colour": spot.colour,
        "rms_radius_um": spot.rms_radius_um,
        "rms_radius_px": spot.rms_radius_px,
        "centre_x_mm": spot.centre_x_mm,
        "centre_y_mm": spot.centre_y_mm,
        "lost_share": spot.lost_share,
    }


def _light(shares: LightShares) -> dict[str, float]:
    named = {f"{name}_share": value for name, value in asdict(shares).items()}
    return named | {"crosstalk_share": shares.crosstalk, "astray_share": shares.astray}


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value
