"""Cases of the lens models, up to the limits of the optics and of the arithmetic."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from inim.display import Display
from reports.stress.study.cases import Case, case_at
from reports.stress.study.lens_oracle import LensRays

_LENSES = 9


@dataclass(frozen=True)
class LensFamily:
    """Cases along one parameter, with the names of the lens models to which it applies."""

    name: str
    parameter: str
    models: tuple[str, ...]
    cases: Callable[[int], list[Case]]


_ALL = ("pinhole", "thin", "thick")


def display_of(**changes: object) -> Display:
    """Display with nine by nine lenses like those of the nominal display."""
    values: dict[str, object] = {
        "pitch_mm": 1.0,
        "focal_length_mm": 3.0,
        "gap_mm": 3.3,
        "pixel_pitch_mm": 1 / 17,
        "lens_columns": _LENSES,
        "lens_rows": _LENSES,
    }
    return Display(**(values | changes))  # type: ignore[arg-type]


def rays_over(display: Display, count: int, slope: float = 0.15, seed: int = 0) -> LensRays:
    """Random rays over the inner lenses, with sideways travel `slope` in random directions.

    Their numbers are exact in float32. All errors are therefore errors of the computation.
    """
    rng = np.random.default_rng(seed)
    inner = (max(display.lens_columns - 4, 1), max(display.lens_rows - 4, 1))
    x, y = ((rng.random(count) - 0.5) * n * display.pitch_mm for n in inner)
    turn = rng.uniform(0, 2 * math.pi, count)
    sx, sy = slope * np.cos(turn), slope * np.sin(turn)
    return _float32(x, y, sx, sy)


def _float32(*values: Any) -> LensRays:
    x, y, sx, sy = (np.asarray(v, np.float32) for v in np.broadcast_arrays(*values))
    return LensRays(x, y, sx, sy)


def _slopes(count: int) -> list[Case]:
    def make(slope: float, side: str) -> tuple[Display, LensRays]:
        display = display_of(curved_side=side)
        return display, rays_over(display, count, slope)

    slopes = (0.0, 1e-6, 1e-3, 0.01, 0.1, 0.3, 0.6, 1.0, 1.5, 2.0, 3.0, 10.0, 100.0, 1e3, 1e4, 1e6)
    return [
        Case(f"{s:g}, bulge to the {side}", partial(make, s, side), s)
        for side in ("viewer", "panel")
        for s in slopes
    ]


def _eyes(count: int) -> list[Case]:
    """Rays from an eye above the middle, at different distances."""

    def make(distance: float) -> tuple[Display, LensRays]:
        display = display_of()
        aim = rays_over(display, count)
        return display, _float32(aim.x, aim.y, -aim.x / distance, -aim.y / distance)

    return [case_at(f"{10.0**k:g} mm", make, 10.0**k) for k in range(-3, 7)]


def _lengths(count: int) -> list[Case]:
    def make(factor: float) -> tuple[Display, LensRays]:
        names = ("pitch_mm", "focal_length_mm", "gap_mm", "pixel_pitch_mm")
        base = display_of()
        display = base.replace(**{name: getattr(base, name) * factor for name in names})
        return display, rays_over(display, count)

    powers = (-18, -12, -6, -3, -1, 0, 1, 3, 6, 12, 18)
    # Pitches below 1e-9 mm are refused.
    return [case_at(f"10^{p}", make, 10.0**p, refused=p < -9) for p in powers]


def _widths(count: int) -> list[Case]:
    """Increasingly wide arrays: large coordinates leave fewer digits for the panel pixel."""

    def make(lenses: float) -> tuple[Display, LensRays]:
        display = display_of(lens_columns=int(lenses), lens_rows=_LENSES)
        return display, rays_over(display, count)

    return [case_at(f"{n} lenses", make, float(n)) for n in (9, 64, 256, 1000, 10_000, 100_000)]


def _focus(count: int) -> list[Case]:
    def make(k: float, side: int) -> tuple[Display, LensRays]:
        gap = 3.0 * (1 + side * 2.0 ** -int(k))
        display = display_of(gap_mm=gap, depth_min_mm=5.0, depth_max_mm=20.0)
        return display, rays_over(display, count)

    return [
        Case(
            f"g = f (1 {'+' if side > 0 else '-'} 2^-{k})",
            partial(make, k, side),
            float(k),
        )
        for side in (1, -1)
        for k in (3, 6, 10, 16, 23, 24, 30, 40, 52)
    ]


def _focal_lengths(count: int) -> list[Case]:
    """Lenses from the steepest possible curvature to flat ones."""

    def make(ratio: float) -> tuple[Display, LensRays]:
        display = display_of(focal_length_mm=ratio, gap_mm=1.1 * ratio)
        return display, rays_over(display, count, 0.1)

    ratios = (0.5, 1.2, 1.5, 2.0, 3.0, 10.0, 100.0, 1e3, 1e4, 1e6)
    return [case_at(f"f / P = {r:g}", make, r, refused=None if r < 1.5 else False) for r in ratios]


def _indices(count: int) -> list[Case]:
    def make(index: float) -> tuple[Display, LensRays]:
        display = display_of(refractive_index=index)
        return display, rays_over(display, count)

    indices: list[tuple[float, bool | None]] = [(1.0, True)]
    indices += [(n, None) for n in (1 + 2.0**-52, 1 + 1e-6, 1.01, 1.1)]
    indices += [(n, False) for n in (1.3, 1.4917, 1.9, 4.0)]
    return [case_at(f"n = {n:.10g}", make, n, refused) for n, refused in indices]


def _total_reflection(count: int) -> list[Case]:
    """Flat side towards the viewer: parallel light beyond R / n from the axis is reflected."""

    def make(offset: float) -> tuple[Display, LensRays]:
        radius = 3.0 * 0.4917
        display = display_of(
            curved_side="panel", pitch_mm=1.405 * radius, lens_thickness_mm=1.5, pixel_pitch_mm=0.08
        )
        height = np.float32(radius / 1.4917)
        for _ in range(abs(int(offset))):
            height = np.nextafter(height, np.float32(math.copysign(9.0, offset)))
        turn = np.linspace(0, 2 * math.pi, 4, endpoint=False)
        x, y = np.round(np.cos(turn)) * height, np.round(np.sin(turn)) * height
        return display, _float32(x, y, np.zeros(4), np.zeros(4))

    def spread(low: float, high: float) -> tuple[Display, LensRays]:
        display = make(0)[0]
        radius = 3.0 * 0.4917
        h = np.random.default_rng(1).uniform(low, high, count) * radius / 1.4917
        return display, _float32(h, 0 * h, 0 * h, 0 * h)

    ulps = (-1000, -10, -1, 0, 1, 10, 1000)
    return [
        *(case_at(f"R / n {ulp:+d} ulp", make, float(ulp)) for ulp in ulps),
        Case("0.9 to 1 R / n", lambda: spread(0.9, 1.0)),
        Case("1 to 1.04 R / n", lambda: spread(1.0, 1.04)),
    ]


def _positions(count: int) -> list[Case]:
    """Rays at lens centres, at borders between lenses, and one ulp next to them."""
    del count

    def make(kind: str, slope: float) -> tuple[Display, LensRays]:
        display = display_of(lens_columns=9)
        n = np.arange(-2.0, 3.0)
        shift = {"centre": 0.0, "border": 0.5}[kind.partition(" ")[0]]
        x = np.float32(n + shift)
        if kind.endswith("ulp"):
            towards = np.inf if "+" in kind else -np.inf
            x = np.nextafter(x, np.float32(towards))
        y = np.full(5, np.float32(0.25))
        return display, _float32(x, y, np.full(5, slope), np.zeros(5))

    kinds = ("centre", "centre +1 ulp", "border", "border +1 ulp", "border -1 ulp")
    return [
        Case(f"{kind}, slope {s:g}", partial(make, kind, s)) for kind in kinds for s in (0.0, 0.1)
    ]


def _shifts(count: int) -> list[Case]:
    def make(shift: float) -> tuple[Display, LensRays]:
        display = display_of(shift_x_mm=shift)
        return display, rays_over(display, count, seed=3)

    pixel = 1 / 17
    shifts = {
        "no shift": 0.0,
        "half a pixel": pixel / 2,
        "a pixel": pixel,
        "half a pitch": 0.5,
        "a pitch": 1.0,
        "an ulp": 2.0**-52,
    }
    return [case_at(name, make, value) for name, value in shifts.items()]


def _misalignments(count: int) -> list[Case]:
    def make(**changes: object) -> tuple[Display, LensRays]:
        display = display_of(**changes)
        return display, rays_over(display, count, seed=4)

    misalignments: dict[str, dict[str, object]] = {
        "turned by 1e-6 degrees": {"rotation_deg": 1e-6},
        "turned by 1 degree": {"rotation_deg": 1.0},
        "turned by 45 degrees": {"rotation_deg": 45.0},
        "tilted by 2 degrees": {"tilt_x_deg": 2.0, "tilt_y_deg": -1.0},
        "all at once": {"rotation_deg": 3.0, "tilt_x_deg": 1.0, "shift_y_mm": 0.31},
    }
    return [Case(name, partial(make, **changes)) for name, changes in misalignments.items()]


def _faces(count: int) -> list[Case]:
    def make(side: str, **changes: float) -> tuple[Display, LensRays]:
        display = display_of(curved_side=side, **changes)
        return display, rays_over(display, count, seed=5)

    faces = {
        "sphere": {},
        "conic -1 (paraboloid)": {"conic": -1.0},
        "conic -1 + 1e-9": {"conic": -1.0 + 1e-9},
        "conic -2.2": {"conic": -2.2},
        "conic 0.5": {"conic": 0.5},
        "conic 1e-12": {"conic": 1e-12},
        "a4": {"asphere_a4": 0.01},
        "conic, a4, a6": {"conic": -0.6, "asphere_a4": 0.004, "asphere_a6": -0.002},
    }
    return [
        Case(f"{name}, bulge to the {side}", partial(make, side, **changes))
        for name, changes in faces.items()
        for side in ("viewer", "panel")
    ]


LENS_FAMILIES = [
    LensFamily("incidence", "sideways travel per mm", _ALL, _slopes),
    LensFamily("eye distance", "distance of the eye, mm", _ALL, _eyes),
    LensFamily("all lengths", "factor", _ALL, _lengths),
    LensFamily("array width", "lenses across", _ALL, _widths),
    LensFamily("g to f", "-log2 |g - f| / f", _ALL, _focus),
    LensFamily("focal length", "f / P", ("thin", "thick"), _focal_lengths),
    LensFamily("index", "n", ("thin", "thick"), _indices),
    LensFamily("total reflection", "ulps from R / n", ("thick",), _total_reflection),
    LensFamily("positions", "", _ALL, _positions),
    LensFamily("shifted array", "shift to the right, mm", _ALL, _shifts),
    LensFamily("misalignment", "", _ALL, _misalignments),
    LensFamily("faces", "", ("thick",), _faces),
]
