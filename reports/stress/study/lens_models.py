"""Every lens model on every case, against its oracle."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from inim.display import Display
from inim.errors import InimError
from inim.inspect.accuracy_limits import accuracy_warnings
from inim.lens import trace_to_panel
from reports.stress.study.cases import Case
from reports.stress.study.lens_cases import LENS_FAMILIES, LensFamily, cases_of
from reports.stress.study.lens_oracle import Landing, LensRays, land

# Roundings a landing point may collect: each in an ulp of the largest coordinate on the way, or in
# an eps of the numbers of its ray, which grazing rays amplify.
_BAND_ULPS = 32.0
_TYPES: tuple[Any, ...] = (np.float64, np.float32)


def run_lens_cases(count: int, thin: int, listener: Any) -> list[dict[str, Any]]:
    """A row for every lens model in both types on every case.

    Parameters
    ----------
    count : int
        Rays of a case.
    thin : int
        Every so manieth case of a family.
    listener : Observer
    """
    rows: list[dict[str, Any]] = []
    for family in LENS_FAMILIES:
        listener.stage(f"lens models: {family.name}")
        for case in cases_of(family, count, thin):
            rows += run_lens_case(family, case)
    return rows


def run_lens_case(family: LensFamily, case: Case) -> list[dict[str, Any]]:
    """Make one case and trace it by all its models."""
    common = {"family": family.name, "case": case.label, "value": case.value}
    try:
        display, rays = case.make()
    except InimError as error:
        return [
            common
            | {"model": "all", "dtype": "", "outcome": "refused", "message": _said(error)}
            | {"passed": case.refused is not False}
        ]
    rows = []
    for model in family.models:
        truths = _truths(display, model, rays)
        for dtype in _TYPES:
            named = {"model": model, "dtype": np.dtype(dtype).name}
            truth = truths[named["dtype"]]
            rows.append(common | named | _run(case, display, model, rays, truth, dtype))
    return rows


def _said(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:300]


def _run(
    case: Case, display: Display, model: str, rays: LensRays, truth: _Truth, dtype: type
) -> dict[str, Any]:
    try:
        traced = trace_to_panel(display, model, rays.x, rays.y, rays.sx, rays.sy, dtype=dtype)
    except InimError as error:
        passed = case.refused is not False
        return {"outcome": "refused", "message": _said(error), "passed": passed}
    except Exception as error:
        return {"outcome": "crashed", "message": _said(error), "passed": False}
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
    """The oracle's landings, and by how much they move (mm) with an eps of their rays' numbers.

    Where the move is not finite, the ray is as near as that to getting lost.
    """

    landing: Landing
    moves: np.ndarray


def _truths(display: Display, model: str, rays: LensRays) -> dict[str, _Truth]:
    """The truth for each type, by its name; all from one call of the oracle."""
    names = ("x", "y", "sx", "sy")
    given = [np.asarray(getattr(rays, name), np.longdouble) for name in names]
    pushed = [given]
    for dtype in _TYPES:
        eps = np.longdouble(np.finfo(dtype).eps)
        pushed += [[v * (1 + eps) if i == k else v for i, v in enumerate(given)] for k in range(4)]
    together = land(display, model, LensRays(*map(np.concatenate, zip(*pushed, strict=True))))
    count = len(given[0])
    whole = {f.name: getattr(together, f.name).reshape(-1, count) for f in fields(Landing)}
    landing = Landing(**{name: value[0] for name, value in whole.items()})
    found = {}
    for place, dtype in enumerate(_TYPES):
        mine = slice(1 + 4 * place, 5 + 4 * place)
        with np.errstate(invalid="ignore"):
            off = np.hypot(whole["x"][mine] - landing.x, whole["y"][mine] - landing.y)
        found[np.dtype(dtype).name] = _Truth(landing, off.sum(axis=0))
    return found


def _compare(
    display: Display,
    rays: LensRays,
    traced: tuple[np.ndarray, np.ndarray, np.ndarray],
    known: _Truth,
    dtype: type,
) -> dict[str, Any]:
    """Traced landing points against the oracle's.

    A ray is lit in both, dark in both, or changed; lit ones are changed too where they land on
    another panel pixel. Uncertain are those near a border between lenses, panel pixels or passing
    and total reflection.
    """
    x, y, weight = (np.asarray(a, np.longdouble) for a in traced)
    truth = known.landing
    eps = float(np.finfo(dtype).eps)
    with np.errstate(invalid="ignore", over="ignore"):
        both = (weight > 0) & (truth.weight > 0)
        off = np.where(both, np.hypot(x - truth.x, y - truth.y), 0)
        scale = _largest(display, rays, truth)
        ulp = eps * scale
        pixel = display.pixel_pitch_mm
        landed = np.stack([_pixel_of(x, pixel), _pixel_of(y, pixel)])
        expected = np.stack([_pixel_of(truth.x, pixel), _pixel_of(truth.y, pixel)])
        other = both & (landed != expected).any(axis=0)
        relit = (weight > 0) != (truth.weight > 0)
        lost = both & ~np.isfinite(known.moves)
        band = _BAND_ULPS * (ulp + np.where(lost, 0, known.moves))
        near_edge = np.minimum(_clear(truth.x, pixel), _clear(truth.y, pixel)) <= band
        lens = truth.edge * display.pitch_mm <= band
        reflecting = (truth.reflection <= _BAND_ULPS * eps) | lost
        uncertain = lens | reflecting | (both & near_edge)
        far_off = both & (off > band) & ~lens & ~reflecting
        broken = both & ~np.isfinite(off)
    sure = both & ~lens & ~reflecting & ~broken
    errors = np.asarray((off / ulp)[sure], float)
    return {
        "rays": len(x),
        "lit": int(both.sum()),
        "changed": int((other | relit).sum()),
        "uncertain": int(uncertain.sum()),
        "outside": int((far_off | broken | ((other | relit) & ~uncertain)).sum()),
        "worst_ulp": float(errors.max(initial=0.0)),
        "mean_ulp": float(errors.mean()) if len(errors) else 0.0,
        "worst_pixels": float((off / pixel)[sure].max(initial=0.0)),
        "worst_weight": float(np.abs(weight - truth.weight)[sure].max(initial=0.0)),
    }


def _largest(display: Display, rays: LensRays, truth: Landing) -> np.ndarray:
    """The largest coordinate on each ray's way: its error cannot be less than an ulp of that."""
    sideways = np.hypot(rays.sx.astype(float), rays.sy.astype(float)) * display.gap_mm
    start = np.hypot(rays.x.astype(float), rays.y.astype(float))
    end = np.nan_to_num(np.hypot(truth.x, truth.y).astype(float))
    found: np.ndarray = np.maximum.reduce([start, end, sideways, start * 0 + display.pitch_mm])
    return found


def _pixel_of(place: np.ndarray, pixel_mm: float) -> np.ndarray:
    pixel: np.ndarray = np.floor(place / np.longdouble(pixel_mm))
    return pixel


def _clear(place: np.ndarray, pixel_mm: float) -> np.ndarray:
    """Distance from the nearest border between panel pixels, mm."""
    at = place / np.longdouble(pixel_mm)
    found: np.ndarray = np.abs(at - np.rint(at)) * pixel_mm
    return found
