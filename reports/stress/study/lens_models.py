"""Comparison of every lens model with its oracle."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from inim.display import Display
from inim.display.lens import trace_to_panel
from inim.generators.accuracy_limits import accuracy_warnings
from inim.system.errors import InimError
from reports.stress.study.cases import Case, every
from reports.stress.study.lens_cases import LensFamily
from reports.stress.study.lens_oracle import Landing, LensRays, land

# Largest rounding error of a landing point, in ulps of the largest coordinate on the ray's path and
# in eps of the ray's numbers, which grazing rays amplify.
_BAND_ULPS = 32.0
_TYPES: tuple[Any, ...] = (np.float64, np.float32)


def run_family(family: LensFamily, count: int, stride: int) -> list[dict[str, Any]]:
    """Results of every lens model in both types, for each case with `count` rays."""
    cases = every(stride, family.cases(count))
    return [row for case in cases for row in run_lens_case(family, case)]


def run_lens_case(family: LensFamily, case: Case) -> list[dict[str, Any]]:
    """Results of all lens models of a family for one case."""
    common = {"family": family.name, "case": case.label, "value": case.value}
    try:
        display, rays = case.make()
    except InimError as error:
        return [
            common
            | {"model": "all", "dtype": "", "outcome": "refused", "message": _message(error)}
            | {"passed": case.refused is not False}
        ]
    rows = []
    for model in family.models:
        truths = _truths(display, model, rays)
        for dtype in _TYPES:
            names = {"model": model, "dtype": np.dtype(dtype).name}
            truth = truths[names["dtype"]]
            rows.append(common | names | _run(case, display, model, rays, truth, dtype))
    return rows


def _message(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:300]


def _run(
    case: Case, display: Display, model: str, rays: LensRays, truth: _Truth, dtype: type
) -> dict[str, Any]:
    try:
        traced = trace_to_panel(display, model, rays.x, rays.y, rays.sx, rays.sy, dtype=dtype)
    except InimError as error:
        passed = case.refused is not False
        return {"outcome": "refused", "message": _message(error), "passed": passed}
    except Exception as error:
        return {"outcome": "crashed", "message": _message(error), "passed": False}
    if case.refused:
        return {"outcome": "accepted", "message": "should have been refused", "passed": False}
    row = _compare(display, rays, traced, truth, dtype)
    safe = not row["outside"]
    slope = float(np.hypot(rays.sx.astype(float), rays.sy.astype(float)).max(initial=0.0))
    guards = accuracy_warnings(display, model, slope=slope)
    return row | {
        "slope": slope,
        "outcome": "ran",
        "message": "",
        "safe": safe,
        "guards": guards,
        "passed": safe or bool(guards),
    }


@dataclass(frozen=True)
class _Truth:
    """The oracle's landing points and their sensitivity to the ray's numbers.

    Attributes
    ----------
    landing : Landing
    sensitivity : (n,) array
        Change of each landing point for an eps of the ray's numbers, mm. It is not finite if this
        change loses the ray.
    """

    landing: Landing
    sensitivity: np.ndarray


def _truths(display: Display, model: str, rays: LensRays) -> dict[str, _Truth]:
    """Truth for each type, by its name, from one call of the oracle."""
    names = ("x", "y", "sx", "sy")
    numbers = [np.asarray(getattr(rays, name), np.longdouble) for name in names]
    variations = [numbers]
    for dtype in _TYPES:
        eps = np.longdouble(np.finfo(dtype).eps)
        variations += [
            [v * (1 + eps) if i == k else v for i, v in enumerate(numbers)] for k in range(4)
        ]
    landings = land(display, model, LensRays(*map(np.concatenate, zip(*variations, strict=True))))
    count = len(numbers[0])
    values = {f.name: getattr(landings, f.name).reshape(-1, count) for f in fields(Landing)}
    landing = Landing(**{name: value[0] for name, value in values.items()})
    truths = {}
    for index, dtype in enumerate(_TYPES):
        varied = slice(1 + 4 * index, 5 + 4 * index)
        with np.errstate(invalid="ignore"):
            change = np.hypot(values["x"][varied] - landing.x, values["y"][varied] - landing.y)
        truths[np.dtype(dtype).name] = _Truth(landing, change.sum(axis=0))
    return truths


def _compare(
    display: Display,
    rays: LensRays,
    traced: tuple[np.ndarray, np.ndarray, np.ndarray],
    expected: _Truth,
    dtype: type,
) -> dict[str, Any]:
    """Compare traced landing points with the oracle.

    A ray is changed if it is lit in only one of the two, or if it lands on another panel pixel. A
    ray is uncertain near a border between lenses or panel pixels and near total reflection.
    """
    x, y, weight = (np.asarray(a, np.longdouble) for a in traced)
    truth = expected.landing
    eps = float(np.finfo(dtype).eps)
    with np.errstate(invalid="ignore", over="ignore"):
        lit = (weight > 0) & (truth.weight > 0)
        error = np.where(lit, np.hypot(x - truth.x, y - truth.y), 0)
        scale = _largest(display, rays, truth)
        ulp = eps * scale
        pixel = display.pixel_pitch_mm
        pixels = np.stack([_pixel_of(x, pixel), _pixel_of(y, pixel)])
        true_pixels = np.stack([_pixel_of(truth.x, pixel), _pixel_of(truth.y, pixel)])
        on_other_pixel = lit & (pixels != true_pixels).any(axis=0)
        changed = on_other_pixel | ((weight > 0) != (truth.weight > 0))
        lost = lit & ~np.isfinite(expected.sensitivity)
        band = _BAND_ULPS * (ulp + np.where(lost, 0, expected.sensitivity))
        near_pixel_edge = (
            np.minimum(_edge_distance(truth.x, pixel), _edge_distance(truth.y, pixel)) <= band
        )
        near_lens_edge = truth.edge * display.pitch_mm <= band
        near_reflection = (truth.reflection <= _BAND_ULPS * eps) | lost
        uncertain = near_lens_edge | near_reflection | (lit & near_pixel_edge)
        too_far = lit & (error > band) & ~near_lens_edge & ~near_reflection
        broken = lit & ~np.isfinite(error)
    certain = lit & ~near_lens_edge & ~near_reflection & ~broken
    errors = np.asarray((error / ulp)[certain], float)
    return {
        "rays": len(x),
        "lit": int(lit.sum()),
        "changed": int(changed.sum()),
        "uncertain": int(uncertain.sum()),
        "outside": int((too_far | broken | (changed & ~uncertain)).sum()),
        "worst_ulp": float(errors.max(initial=0.0)),
        "mean_ulp": float(errors.mean()) if len(errors) else 0.0,
        "worst_pixels": float((error / pixel)[certain].max(initial=0.0)),
        "worst_weight": float(np.abs(weight - truth.weight)[certain].max(initial=0.0)),
    }


def _largest(display: Display, rays: LensRays, truth: Landing) -> np.ndarray:
    """Largest coordinate on each ray's path; its ulp is the smallest possible error."""
    sideways = np.hypot(rays.sx.astype(float), rays.sy.astype(float)) * display.gap_mm
    start = np.hypot(rays.x.astype(float), rays.y.astype(float))
    end = np.nan_to_num(np.hypot(truth.x, truth.y).astype(float))
    largest: np.ndarray = np.maximum.reduce([start, end, sideways, start * 0 + display.pitch_mm])
    return largest


def _pixel_of(coordinate: np.ndarray, pixel_mm: float) -> np.ndarray:
    pixel: np.ndarray = np.floor(coordinate / np.longdouble(pixel_mm))
    return pixel


def _edge_distance(coordinate: np.ndarray, pixel_mm: float) -> np.ndarray:
    """Distance to the nearest border between panel pixels, mm."""
    pixels = coordinate / np.longdouble(pixel_mm)
    distance: np.ndarray = np.abs(pixels - np.rint(pixels)) * pixel_mm
    return distance
