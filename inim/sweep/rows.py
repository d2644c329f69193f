"""Rows of the table: one for each viewpoint of each algorithm of each unit."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from inim.metrics import Metric, all_metrics
from inim.report.wording import check_finding, check_passed, checks, part
from inim.scene.file import parse_definitions
from inim.settings import PREFIX, Settings
from inim.sweep.unit import Unit

__all__ = [
    "DISPLAY_COLUMNS",
    "REFERENCES",
    "SETTING_COLUMNS",
    "ceiling_columns",
    "eia_columns",
    "failed_rows",
    "finished_rows",
    "reference_columns",
    "result_of",
    "view_columns",
]

#: Of the display: what papers state of it.
DISPLAY_COLUMNS = (
    "pitch_mm",
    "focal_length_mm",
    "gap_mm",
    "pixel_pitch_mm",
    "lens_columns",
    "lens_rows",
)
#: Of the settings: what a study varies besides its display.
SETTING_COLUMNS = (
    "lens_model",
    "misalign",
    "fit_share",
    "viewing_distance_mm",
    "pupil_mm",
    "focus_mm",
    "view_pixels_per_lens",
    "capture_pixels_per_pitch",
    "capture_spp",
    "eia_spp",
    "view_spp",
    "reconstruction_spp",
    "score_error",
    "seed",
)
#: Of which a row has the reference's scores, too, under these prefixes.
REFERENCES = ("ceiling", "noise_floor")


def view_columns() -> dict[str, Metric]:
    """Columns of a view's scores against the scene, with their metrics, in the table's order."""
    metrics = all_metrics()
    on_relic = {metric.on_relic_key: metric for metric in metrics if metric.on_relic}
    return {metric.key: metric for metric in metrics} | on_relic


def ceiling_columns() -> dict[str, Metric]:
    """Columns of a view's scores against the ceiling's view, likewise."""
    return {metric.to_ceiling_key: metric for metric in all_metrics()}


def reference_columns(reference: str) -> dict[str, Metric]:
    """Columns of the scores of one of `REFERENCES`, likewise."""
    return {f"{reference}_{metric.key}": metric for metric in all_metrics()}


def eia_columns(start: str = "eia") -> dict[str, Metric]:
    """Columns of an EIA's scores, likewise."""
    return {f"{start}_{metric.key}": metric for metric in all_metrics() if metric.of_eia}


def result_of(
    data: Mapping[str, Any], times: Mapping[str, Sequence[float]], algorithm: str
) -> dict[str, Any]:
    """What a finished validation says of one algorithm.

    Parameters
    ----------
    data : mapping
        Schema `inim.report/1`.
    times : mapping of str to sequence of float
        `inim.regression.log_ratios` by algorithm; empty where nothing was timed.
    algorithm : str

    Returns
    -------
    dict
        `made`, what it was made with, and `rows`, one for each viewpoint.
    """
    found, timings = part(data, "algorithms", algorithm), part(data, "timings")
    floor = data["noise_floor"]
    failed = _failed_checks(data, algorithm)
    ratios = times.get(algorithm, ())
    common = {
        **{name: found["eia"].get(m.key) for name, m in eia_columns().items()},
        "hole_fraction": found["eia"]["hole_fraction"],
        **{name: floor["eia"].get(m.key) for name, m in eia_columns("noise_floor_eia").items()},
        "seconds": found["seconds"],
        "yardsticks": math.exp(statistics.median(ratios)) if ratios else None,
        "unit_seconds": timings["total"],
        "render_seconds": timings["mitsuba_render"],
        "passed": not failed,
        "failed_checks": "; ".join(failed) or None,
    }
    rows = []
    for viewpoint in data["viewpoints"]:
        name = viewpoint["name"]
        x_mm, y_mm, z_mm = viewpoint["position_mm"]
        row = {"viewpoint": name, "x_mm": x_mm, "y_mm": y_mm, "z_mm": z_mm}
        row |= {key: found["views"][name].get(key) for key in (*view_columns(), *ceiling_columns())}
        for reference in REFERENCES:
            scores = data[reference]["views"][name]
            row |= {key: scores.get(m.key) for key, m in reference_columns(reference).items()}
        rows.append(row | common)
    made = {key: data[key] for key in ("created", "inim_version", "versions", "backend")}
    return {"made": made, "rows": rows}


def _failed_checks(data: Mapping[str, Any], algorithm: str) -> list[str]:
    """Failed checks of the ground truth and of this algorithm, not those of the others."""
    others = [name for name in part(data, "algorithms") if name != algorithm]
    return [
        f"{check['name']}: {check_finding(check)}"
        for check in checks(data)
        if not check_passed(check) and not any(_is_of(check["name"], other) for other in others)
    ]


def _is_of(check: str, algorithm: str) -> bool:
    """Whether a check is an algorithm's: ``NAME: …``, ``NAME/VIEW: …``, ``eia/NAME: …``."""
    own = check.removeprefix("eia/").removeprefix("views/")
    return own.startswith((f"{algorithm}: ", f"{algorithm}/"))


def finished_rows(unit: Unit, algorithm: str, result: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A result's rows as the table has them."""
    made = {
        "variant": result["made"]["backend"]["variant"],
        "device": result["made"]["backend"]["device"],
        "inim_version": result["made"]["inim_version"],
        "mitsuba_version": result["made"]["versions"]["mitsuba"],
        "created": result["made"]["created"],
    }
    start = _identity(unit, algorithm) | {"status": "ok", "error": None}
    return [start | _infinite(row) | made for row in result["rows"]]


def failed_rows(unit: Unit, algorithm: str, error: str) -> list[dict[str, Any]]:
    """Rows of what could not be had: one for each viewpoint, as far as those are known."""
    start = _identity(unit, algorithm) | {"status": "failed", "error": error}
    viewpoints = unit.plan.viewpoints if unit.plan is not None else ()
    places = [
        {"viewpoint": v.name, "x_mm": v.x_mm, "y_mm": v.y_mm, "z_mm": v.z_mm} for v in viewpoints
    ]
    return [start | place for place in places or [{}]]


def _identity(unit: Unit, algorithm: str) -> dict[str, Any]:
    row: dict[str, Any] = {"scene": unit.scene, "display": unit.display, "algorithm": algorithm}
    row["unit"] = unit.hash or None
    if unit.plan is None:
        return row | _given(unit)
    settings, display = asdict(unit.plan.settings), unit.plan.display.given()
    row["scene_sha256"] = unit.plan.file.sha256
    row |= {key: display[key] for key in DISPLAY_COLUMNS}
    row["pixels_per_lens"] = unit.plan.display.pixels_per_lens
    return row | {key: settings[key] for key in SETTING_COLUMNS}


def _given(unit: Unit) -> dict[str, Any]:
    """Settings that the study itself names, where the scene's could not be had."""
    given = parse_definitions(list(unit.request.definitions))
    settings = asdict(Settings.parse(given, unit.label))
    return {key: settings[key] for key in SETTING_COLUMNS if f"{PREFIX}{key}" in given}


def _infinite(row: Mapping[str, Any]) -> dict[str, Any]:
    """With scores of identical pictures infinite, which JSON has as null: PSNR."""
    scores = view_columns() | ceiling_columns() | eia_columns() | eia_columns("noise_floor_eia")
    for reference in REFERENCES:
        scores |= reference_columns(reference)
    ends = {name: max(metric.range) for name, metric in scores.items()}
    return {
        key: math.inf if value is None and ends.get(key) == math.inf else value
        for key, value in row.items()
    }
