"""Relations of the lens models that need no oracle: mirror, transpose, shift, scale."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from inim.apps.stress.document import RelationResult
from inim.display import Display
from inim.display.lens import trace_to_panel
from reports.stress.study.lens_cases import display_of, rays_over
from reports.stress.study.lens_oracle import LensRays

#: Function with the signature of `inim.display.lens.trace_to_panel`.
Trace = Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray]]
#: Traced and expected x, y and weight of rays, and their display.
Pair = tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...], Display]

_MODELS = ("pinhole", "thin", "thick")
# Largest difference of two computations of a point, in float64 ulps of the array's width.
_MAX_ULPS = 64.0
_RAYS = 500


def run_lens_relations(trace: Trace = trace_to_panel) -> list[RelationResult]:
    """Check each relation for each lens model.

    Parameters
    ----------
    trace : callable
        The tested function.
    """
    return [
        _row(name, check, bitwise, model, trace)
        for name, (check, bitwise) in LENS_RELATIONS.items()
        for model in _MODELS
    ]


def _row(name: str, check: Any, bitwise: bool, model: str, trace: Trace) -> RelationResult:
    compared = broken = 0
    worst = 0.0
    for traced, expected, display in check(trace, model):
        limit = 0.0 if bitwise else _MAX_ULPS
        lit = (traced[2] > 0) & (expected[2] > 0)
        ulp = np.finfo(np.float64).eps * display.width_mm / 2
        error = np.max([np.abs(a - b) for a, b in zip(traced, expected, strict=True)], axis=0) / ulp
        compared += len(error)
        broken += int(((traced[2] > 0) != (expected[2] > 0)).sum() + (error[lit] > limit).sum())
        worst = max(worst, float(error[lit].max(initial=0.0)))
    return RelationResult(
        relation=name,
        algorithm=model,
        explained="",
        compared=compared,
        broken=broken,
        uncertain=0,
        message="",
        worst_ulp=worst,
        passed=compared > 0 and not broken,
    )


def _displays() -> Iterator[Display]:
    yield display_of()
    yield display_of(curved_side="panel", gap_mm=2.7)
    yield display_of(conic=-0.7, asphere_a4=0.003)


def _rays(display: Display, seed: int = 9) -> LensRays:
    """Random rays whose distance to borders between lenses exceeds any rounding error."""
    rays = rays_over(display, _RAYS, 0.2, seed)
    inside_cell = np.ones(_RAYS, bool)
    for coordinate in (rays.x, rays.y):
        cell = coordinate.astype(float) / display.pitch_mm + 0.5
        inside_cell &= np.abs(cell - np.rint(cell)) > 0.02
    return LensRays(*(getattr(rays, n)[inside_cell].astype(float) for n in ("x", "y", "sx", "sy")))


def _mirror(trace: Trace, model: str) -> Iterator[Pair]:
    """The mirrored ray lands at the mirrored point."""
    for display in _displays():
        r = _rays(display)
        x, y, w = trace(display, model, r.x, r.y, r.sx, r.sy)
        yield trace(display, model, -r.x, r.y, -r.sx, r.sy), (-x, y, w), display


def _transpose(trace: Trace, model: str) -> Iterator[Pair]:
    """Exchanging x and y of a ray exchanges x and y of its landing point."""
    for display in _displays():
        r = _rays(display)
        x, y, w = trace(display, model, r.x, r.y, r.sx, r.sy)
        yield trace(display, model, r.y, r.x, r.sy, r.sx), (y, x, w), display


def _pitch(trace: Trace, model: str) -> Iterator[Pair]:
    """Moving a ray by one lens moves its landing point by one pitch."""
    for display in _displays():
        r = _rays(display)
        x, y, w = trace(display, model, r.x, r.y, r.sx, r.sy)
        p = display.pitch_mm
        yield trace(display, model, r.x + p, r.y, r.sx, r.sy), (x + p, y, w), display


def _shifted(trace: Trace, model: str) -> Iterator[Pair]:
    """Moving array and rays by whole and half pixels moves landing points by the same distance."""
    for display in _displays():
        r = _rays(display)
        x, y, w = trace(display, model, r.x, r.y, r.sx, r.sy)
        for pixels in (0.5, 1.0, 3.5):
            by = pixels * display.pixel_pitch_mm
            moved = display.replace(shift_x_mm=by)
            yield trace(moved, model, r.x + by, r.y, r.sx, r.sy), (x + by, y, w), display


def _scaled(factor: float) -> Callable[[Trace, str], Iterator[Pair]]:
    """Check that scaling all lengths by a factor scales the landing points by this factor."""
    names = ("pitch_mm", "focal_length_mm", "gap_mm", "pixel_pitch_mm")

    def check(trace: Trace, model: str) -> Iterator[Pair]:
        for display in _displays():
            if display.asphere_a4:
                continue  # aspheric coefficients have other units
            r = _rays(display)
            x, y, w = trace(display, model, r.x, r.y, r.sx, r.sy)
            scaled = display.replace(**{n: getattr(display, n) * factor for n in names})
            u, v, weight = trace(scaled, model, r.x * factor, r.y * factor, r.sx, r.sy)
            yield (u / factor, v / factor, weight), (x, y, w), display

    return check


def _pieces(trace: Trace, model: str) -> Iterator[Pair]:
    """Single rays have the same landing points as all rays together."""
    for display in _displays():
        r = _rays(display)
        together = trace(display, model, r.x, r.y, r.sx, r.sy)
        points = [
            trace(display, model, r.x[i], r.y[i], r.sx[i], r.sy[i]) for i in range(0, len(r.x), 7)
        ]
        separate = tuple(np.array([float(p[k]) for p in points]) for k in range(3))
        yield separate, tuple(np.asarray(a)[::7] for a in together), display


LENS_RELATIONS: dict[str, tuple[Callable[[Trace, str], Iterator[Pair]], bool]] = {
    "mirror left and right": (_mirror, False),
    "transpose": (_transpose, False),
    "shift by one pitch": (_pitch, False),
    "array and rays shifted by half and whole pixels": (_shifted, False),
    "all lengths x 2^10": (_scaled(1024.0), True),
    "all lengths x 1000": (_scaled(1000.0), False),
    "one ray or many": (_pieces, True),
}
