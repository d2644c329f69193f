"""Families of cases for arrays whose rays share nothing: hexagonal, turned, tilted."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from inim.stress.case import (
    Case,
    Family,
    Made,
    Size,
    case_at,
    decades,
    display_of,
    noise,
    shaped,
    sized,
    windowed,
)

__all__ = ["FREE_FAMILIES", "MOUNTINGS"]

#: One of each kind, and one that is off in every way.
MOUNTINGS: dict[str, dict[str, object]] = {
    "turned": {"rotation_deg": 4.0},
    "tilted": {"tilt_x_deg": 3.0, "tilt_y_deg": -2.0},
    "hexagonal": {"lattice": "hexagonal"},
    "all at once": {
        "lattice": "hexagonal",
        "rotation_deg": -7.0,
        "shift_x_mm": 0.31,
        "shift_y_mm": -0.22,
        "tilt_x_deg": -2.0,
        "tilt_y_deg": 1.5,
        "elemental_pitch_mm": 1.01,
    },
}


def _turned(size: Size) -> list[Case]:
    def make(degrees: float) -> Made:
        return sized(display_of(size, rotation_deg=degrees))

    angles = (1e-12, 1e-6, 1e-3, 0.03, 0.5, 4.0, 10.0, 30.0, 45.0, 60.0, 89.0, 90.0, 180.0, 360.0)
    return [case_at(f"{a:g} degrees", make, a) for a in angles]


def _tilted(size: Size) -> list[Case]:
    def make(degrees: float) -> Made:
        return sized(display_of(size, tilt_x_deg=degrees, tilt_y_deg=-degrees / 2))

    return [case_at(f"{a:g} degrees", make, a) for a in (1e-12, 1e-6, 1e-3, 0.1, 1.0, 5.0, 10.0)]


def _hexagonal(size: Size) -> list[Case]:
    def make(columns: int, rows: int, pixels: float) -> Made:
        display = display_of(
            size, lattice="hexagonal", lens_columns=columns, lens_rows=rows,
            pixel_pitch_mm=1 / pixels,
        )  # fmt: skip
        return sized(display, seed=columns + 7 * rows)

    return [
        Case(f"{n} x {m} lenses of {p:g} pixels", partial(make, n, m, p))
        for n, m in ((1, 1), (1, 2), (2, 1), (2, 3), (3, 4), (4, 5))
        for p in (1, 4, 5, 5.3)
    ]


def _distances(mounting: str) -> Callable[[Size], list[Case]]:
    def cases(size: Size) -> list[Case]:
        def make(z: float) -> Made:
            ends = {"depth_min_mm": z, "depth_max_mm": 1.5 * z}
            return windowed(display_of(size, **(MOUNTINGS[mounting] | ends)))

        return [case_at(f"{z:g} mm", make, z) for z in decades(-3, 6)]

    return cases


def _shapes(size: Size) -> list[Case]:
    def make(mounting: str, kind: str) -> Made:
        display = display_of(size, **MOUNTINGS[mounting])
        return display, shaped(kind, display, display.capture_shape(2), 0.5)

    kinds = ("spikes", "slits", "checkerboard", "ramp", "stairs")
    return [Case(f"{k}, {m}", partial(make, m, k)) for m in MOUNTINGS for k in kinds]


def _focus(size: Size) -> list[Case]:
    """G = f (1 + 2^-k), of an array that is turned."""

    def make(k: float) -> Made:
        return windowed(display_of(size, gap_mm=3.0 * (1 + 2.0 ** -int(k)), rotation_deg=4.0))

    return [case_at(f"|g - f| / f = 2^-{k}", make, float(k)) for k in (*range(3, 52, 6), 52)]


def _fine_focus(size: Size) -> list[Case]:
    """The same with whole picture pixels per pitch: far too many cells at some distance."""

    def make(k: float) -> Made:
        display = display_of(size, gap_mm=3.0 * (1 + 2.0 ** -int(k)), rotation_deg=4.0)
        return display, noise(display, (48, 48), 0.5)

    return [case_at(f"|g - f| / f = 2^-{k}", make, float(k), refused=None) for k in (3, 24, 45)]


def _widths(size: Size) -> list[Case]:
    """Wider and wider arrays: a lens centre and a pixel beside it cancel in a ray's slope."""

    def make(lenses: float) -> Made:
        display = display_of(
            size, rotation_deg=0.5, lens_columns=int(lenses), lens_rows=3,
            depth_min_mm=20.0, depth_max_mm=40.0,
        )  # fmt: skip
        return sized(display)

    most = min(size.many, 1000)
    return [case_at(f"{n} lenses", make, float(n)) for n in (3, 30, 100, 300, 1000) if n <= most]


def _lengths(size: Size) -> list[Case]:
    """All lengths times a factor."""

    def make(factor: float) -> Made:
        names = ("pitch_mm", "focal_length_mm", "gap_mm", "pixel_pitch_mm")
        base = display_of(size, rotation_deg=4.0, tilt_x_deg=1.0)
        return sized(base.replace(**{name: getattr(base, name) * factor for name in names}))

    powers = (-40, -30, -9, -3, 3, 9, 30)
    return [case_at(f"10^{p}", make, 10.0**p, refused=None if p == -40 else False) for p in powers]


def _impossible(size: Size) -> list[Case]:
    def make(**changes: object) -> Made:
        return sized(display_of(size, **changes))

    said: dict[str, dict[str, object]] = {
        f"{name} = {value}": {name: value}
        for name in ("rotation_deg", "tilt_x_deg", "tilt_y_deg", "pitch_y_mm")
        for value in (math.nan, math.inf, -math.inf)
    }
    said["tilted by 11 degrees"] = {"tilt_x_deg": 11.0}
    said["a panel tilted through its array"] = {"lens_columns": 60, "tilt_x_deg": 10.0}
    found = [Case(name, partial(make, **changes), refused=True) for name, changes in said.items()]
    # Found out when its pixels are asked for their lenses.
    beside = partial(make, rotation_deg=3.0, shift_x_mm=1e3)
    return [*found, Case("an array beside its panel", beside, refused=None)]


def random_free_case(seed: int) -> Made:
    """A random hexagonal, turned or tilted display, and a random picture over it."""
    rng = np.random.default_rng(seed)
    lattice = str(rng.choice(["square", "hexagonal"]))
    turn = float(rng.choice([0.0, 90.0, rng.uniform(-180, 180)]))
    tilts = rng.uniform(-4, 4, 2) * (rng.random() < 0.5)
    if lattice == "square" and not turn and not tilts.any():
        turn = 1.0
    pixels = float(rng.choice([3, 5, rng.uniform(2, 9)]))
    display = display_of(
        Size((int(rng.integers(1, 6)), int(rng.integers(1, 5))), 5, 1, 0, 0, 0),
        gap_mm=float(rng.choice([3.3, 2.7, rng.uniform(3.1, 4)])), pixel_pitch_mm=1 / pixels,
        lattice=lattice, rotation_deg=turn, tilt_x_deg=float(tilts[0]), tilt_y_deg=float(tilts[1]),
        shift_x_mm=float(rng.choice([0.0, rng.uniform(-1, 1)])),
    )  # fmt: skip
    if max(display.capture_shape(2)) > 160:
        return windowed(display, seed)
    return sized(display, seed, per_pitch=int(rng.integers(1, 4)))


def _random(size: Size) -> list[Case]:
    return [Case(f"seed {s}", partial(random_free_case, s)) for s in range(size.random)]


FREE_FAMILIES = [
    Family("turned array", "degrees", _turned),
    Family("tilted panel", "degrees", _tilted),
    Family("hexagonal array", "", _hexagonal),
    Family("turned array, distance", "nearest surface, mm", _distances("turned")),
    Family("hexagonal array, distance", "nearest surface, mm", _distances("hexagonal")),
    Family("array off in every way, distance", "nearest surface, mm", _distances("all at once")),
    Family("free arrays, shapes", "", _shapes),
    Family("turned array, g to f", "-log2 |g - f| / f", _focus),
    Family("turned array, g to f, fine picture", "-log2 |g - f| / f", _fine_focus),
    Family("turned array, width", "lenses across", _widths),
    Family("turned array, all lengths", "factor", _lengths),
    Family("impossible mounting", "", _impossible),
    Family("random free displays", "", _random),
]
