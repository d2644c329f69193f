"""Families of cases, each of which varies one parameter of a display until arithmetic fails.

A case creates a display and a picture; some cases must be refused. Pictures are noise unless their
family defines another. The first families have separable displays, with independent rows and
columns. The others have non-separable ones: hexagonal, turned and tilted arrays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np

from inim.apps.stress.pictures import (
    MOUNTINGS,
    SHAPES,
    PictureCase,
    noise,
    picture_of_depth,
    random_picture,
    shaped_picture,
    small_display,
    tied_picture,
    window,
)
from inim.display import Display


@dataclass(frozen=True)
class Size:
    """Size of a run.

    Attributes
    ----------
    stride : int
        Step from one used case of a family to the next.
    random : int
        Number of random displays.
    max_pixels : int
        Largest number of panel pixels per case that are compared with the oracle.
    max_lenses : int
        Lenses along a side of the largest array.
    """

    stride: int
    random: int
    max_pixels: int
    max_lenses: int


#: Value of a parameter at infinity: JSON has no infinite numbers.
INFINITE = 1e300
QUICK = Size(24, 2, 49, 60)
FULL = Size(2, 10, 225, 1000)


@dataclass(frozen=True)
class Case:
    """A display with a picture, or with rays for lens models.

    Attributes
    ----------
    label : str
    make : callable
        Creates display and picture; may raise an `InimError`.
    value : float, optional
        Value of the family's parameter.
    refused : bool, optional
        True if the case must be refused; None if it may be.
    """

    label: str
    make: Callable[[], Any]
    value: float | None = None
    refused: bool | None = False


@dataclass(frozen=True)
class Family:
    """Cases along one parameter.

    Attributes
    ----------
    name : str
    parameter : str
        Meaning and unit of `Case.value`; empty if the cases have no order.
    cases : callable
        Returns the cases of a `Size`.
    """

    name: str
    parameter: str
    cases: Callable[[Size], list[Case]]


def every(stride: int, cases: Sequence[Case]) -> Iterator[Case]:
    """Cases in steps of `stride`, and the last one."""
    for i, case in enumerate(cases):
        if i % stride == 0 or i == len(cases) - 1:
            yield case


def case_at(
    label: str, make: Callable[..., Any], value: float, refused: bool | None = False
) -> Case:
    """Case that calls `make` with a value of the family's parameter."""
    return Case(label, partial(make, value), value, refused)


def _with_noise(display: Display, seed: int = 0, per_pitch: int = 2) -> PictureCase:
    """Display with a noise picture of everything that its rays reach."""
    shape, pixel = display.capture_shape(per_pitch), display.pitch_mm / per_pitch
    return display, noise(display, shape, pixel, seed)


def _with_window(display: Display, seed: int = 0) -> PictureCase:
    """Display with a noise picture in a window around its axis."""
    return display, noise(display, *window(display), seed)


def _decades(first: int, last: int) -> list[float]:
    """Powers of ten, each rounded to the nearest float."""
    return [float(Fraction(10) ** k) for k in range(first, last + 1)]


# -- depths of surfaces -------------------------------------------------------------------------


def _distances(**changes: object) -> Callable[[Size], list[Case]]:
    def make(z: float) -> PictureCase:
        ends = {"depth_min_mm": z, "depth_max_mm": 1.5 * z}
        return _with_window(small_display(**(changes | ends)))

    return lambda _: [case_at(f"{z:g} mm", make, z, _far(z)) for z in _decades(-3, 6)]


def _far(z: float) -> bool | None:
    """None for distances at which a window's pixels are wider than the lens array, as refused."""
    return None if z > 100 else False


def _distances_behind(_: Size) -> list[Case]:
    def make(z: float) -> PictureCase:
        ends = {"depth_min_mm": -1.5 * z, "depth_max_mm": -z}
        return _with_window(small_display(focal_length_mm=3.3, gap_mm=3.0, **ends))

    return [case_at(f"-{z:g} mm", make, z, _far(z)) for z in _decades(-3, 6)]


def _depth_spans(_: Size) -> list[Case]:
    def make(k: float) -> PictureCase:
        top = 20.0 * (1 + 2.0 ** -int(k))
        return _with_noise(small_display(depth_min_mm=20.0, depth_max_mm=top))

    cases = [case_at(f"20 mm x 2^-{k}", make, float(k)) for k in (*range(0, 52, 3), 52)]
    return [*cases, Case("empty depth range", lambda: make(2000), INFINITE, refused=True)]


def _flat(_: Size) -> list[Case]:
    def make(z: float, **changes: object) -> PictureCase:
        display = small_display(**changes)
        return display, picture_of_depth(np.full(display.capture_shape(2), z, np.float32), 0.5)

    display = small_display()
    low, high = display.depth_range_mm
    depths = {
        "at z_min": low,
        "at z_max": high,
        "at D": display.central_depth_mm,
        "an ulp below z_min": np.nextafter(np.float32(low), np.float32(-np.inf)),
        "an ulp above z_max": np.nextafter(np.float32(high), np.float32(np.inf)),
    }
    cases = [Case(name, partial(make, z)) for name, z in depths.items()]
    for name, z in {"on the array": 0.0, "just in front": 1e-30, "just behind": -1e-30}.items():
        cases.append(Case(name, partial(make, z, depth_min_mm=-4.0, depth_max_mm=6.0)))
    return cases


def _subnormal_depths(_: Size) -> list[Case]:
    def make(half: float) -> PictureCase:
        display = small_display(depth_min_mm=-half, depth_max_mm=half)
        return display, noise(display, (12, 12), 0.5)

    return [case_at(f"+-{z:g} mm", make, z) for z in (1e-45, 1e-42, 1e-38, 1e-30, 1e-10)]


# -- focus --------------------------------------------------------------------------------------


def _focus(
    powers: tuple[int, ...], side: int = +1, has_range: bool = False, **changes: object
) -> Callable[[Size], list[Case]]:
    """Gaps g = f (1 +- 2^-k), down to one ulp; D and the default depth range grow to infinity."""

    def make(k: float) -> PictureCase:
        focus = {"gap_mm": 3.0 * (1 + side * 2.0 ** -int(k))}
        if has_range:
            focus |= {"depth_min_mm": 5.0, "depth_max_mm": 20.0}
        return _with_window(small_display(**(changes | focus)))

    def cases(_: Size) -> list[Case]:
        # The last may be equal lengths in decimal digits, and then need a range.
        last = False if has_range else None
        focused = [
            case_at(f"|g - f| / f = 2^-{k}", make, float(k), last if k > 50 else False)
            for k in powers
        ]
        if changes:
            return focused
        return [*focused, Case("g = f", lambda: make(2000), INFINITE, refused=not has_range)]

    return cases


def _fine_focus(powers: tuple[int, ...], **changes: object) -> Callable[[Size], list[Case]]:
    """Pictures with whole pixels per pitch, as captured; rays cross too many cells far away."""

    def make(k: float) -> PictureCase:
        display = small_display(gap_mm=3.0 * (1 + 2.0 ** -int(k)), **changes)
        return display, noise(display, (48, 48), 0.5)

    return lambda _: [
        case_at(f"|g - f| / f = 2^-{k}", make, float(k), refused=None) for k in powers
    ]


# -- pixels, lenses, lengths --------------------------------------------------------------------


def _pixels_per_lens(_: Size) -> list[Case]:
    def make(ratio: float) -> PictureCase:
        # A strip of the panel about the axis: the whole panel has millions of pixels.
        panel = {"panel_rows": 3, "panel_columns": max(1, min(3000, round(3 * ratio)))}
        display = small_display(
            pixel_pitch_mm=1 / ratio, depth_min_mm=20.0, depth_max_mm=40.0, **panel
        )
        return _with_noise(display)

    below_one = [case_at(f"{r:g}", make, r, refused=True) for r in (1e-3, 1e-2, 0.1, 0.999)]
    ratios = (1.0, 1.5, 2.0, 3.3, 10.0, 15.7, 17.0, 33.3, 100.0, 333.3, 1000.0)
    return below_one + [case_at(f"{r:g}", make, r) for r in ratios]


def _picture_pixels_per_pitch(_: Size) -> list[Case]:
    def make(ratio: float) -> PictureCase:
        # Depths through the array: rays then cross a few cells of the finest picture, too.
        half = min(4.0, 40 / ratio)
        display = small_display(depth_min_mm=-half, depth_max_mm=half)
        cells = min(48, math.ceil((display.width_mm + 2) * ratio))
        return display, noise(display, (cells, cells), 1 / ratio)

    ratios = (1e-3, 1e-2, 0.1, 0.5, 1.0, 1.7, 2.0, 3.0, 3.7, 10.0, 33.0, 100.0, 333.3, 1000.0)
    # Pixels wider than the lens array are refused.
    return [case_at(f"{r:g}", make, r, refused=None if r < 0.3 else False) for r in ratios]


def _odd_and_even(_: Size) -> list[Case]:
    def make(columns: int, rows: int, pixels: int, per_pitch: int) -> PictureCase:
        display = small_display(lens_columns=columns, lens_rows=rows, pixel_pitch_mm=1 / pixels)
        return _with_noise(display, columns + 7 * rows, per_pitch)

    return [
        Case(f"{n} x {m} lenses of {p} pixels, {k} per pitch", partial(make, n, m, p, k))
        for n, m in ((1, 1), (1, 2), (2, 2), (3, 2), (4, 4))
        for p, k in ((1, 1), (2, 1), (3, 2), (4, 3), (5, 2))
    ]


def _lengths(powers: dict[int, bool | None], **changes: object) -> Callable[[Size], list[Case]]:
    """Lengths times powers of ten, to the limits of floats; `powers` map to `Case.refused`."""
    names = ("pitch_mm", "focal_length_mm", "gap_mm", "pixel_pitch_mm")

    def make(factor: float) -> PictureCase:
        base = small_display(**changes)
        return _with_noise(base.replace(**{name: getattr(base, name) * factor for name in names}))

    return lambda _: [
        case_at(f"10^{p}", make, 10.0**p, refused=refused) for p, refused in powers.items()
    ]


def _many_lenses(size: Size) -> list[Case]:
    side = size.max_lenses

    def make(pixels: int) -> PictureCase:
        display = small_display(
            lens_columns=side, lens_rows=side, pixel_pitch_mm=1 / pixels,
            depth_min_mm=2.0, depth_max_mm=6.0,
        )  # fmt: skip
        return _with_noise(display, per_pitch=1)

    return [
        Case(f"{side} x {side} lenses of {p} pixels", partial(make, p), side**2)
        for p in ((2,) if side < FULL.max_lenses else (1, 2))
    ]


def _shifted(_: Size) -> list[Case]:
    """Arrays shifted from the panel's middle, by whole and half pixels and pitches."""

    def make(shift: float, up: float, pixel: float) -> PictureCase:
        display = small_display(shift_x_mm=shift, shift_y_mm=up)
        return display, noise(display, display.capture_shape(2), pixel, seed=11)

    pixel_mm = small_display().pixel_pitch_mm
    shifts = {
        "half a pixel": (pixel_mm / 2, 0.0),
        "a pixel": (pixel_mm, 0.0),
        "half a pixel each way": (pixel_mm / 2, -pixel_mm / 2),
        "half a pitch": (0.5, 0.0),
        "a pitch": (1.0, 0.0),
        "an ulp": (2.0**-52, 0.0),
        "a third of a micrometre": (1e-3 / 3, 0.0),
    }
    return [
        Case(f"{name}, picture pixels of {p:g} mm", partial(make, *s, p), s[0])
        for p in (0.5, 0.3)
        for name, s in shifts.items()
    ]


# -- ties and shapes ----------------------------------------------------------------------------

# Implementations of first hits, each with changes of a display and a picture pixel that use it.
_FORMS: dict[str, tuple[dict[str, object], float]] = {
    "lists": ({}, 0.5),
    "lists, binary lengths": ({"gap_mm": 4.0, "pixel_pitch_mm": 0.125}, 0.5),
    "converging": ({"elemental_pitch_mm": 1.001}, 0.5),
    "broken pixels, virtual": (
        {"focal_length_mm": 3.3, "gap_mm": 3.0, "pixel_pitch_mm": 0.19},
        0.5,
    ),
    "ray by ray": ({}, 0.3),
}


def _form(form: str) -> tuple[Display, tuple[int, int], float]:
    changes, pixel = _FORMS[form]
    display = small_display(**changes)
    shape = display.capture_shape(2)
    return display, (round(shape[0] * 0.5 / pixel), round(shape[1] * 0.5 / pixel)), pixel


def ties(_: Size = FULL) -> list[Case]:
    """Depths at which rays leave picture pixels, and the float32 numbers next to them."""

    def make(form: str, ulps: int) -> PictureCase:
        display, shape, pixel = _form(form)
        return display, tied_picture(display, shape, pixel, ulps)

    return [
        Case(f"{form}, {ulps:+d} ulp", partial(make, form, ulps))
        for form in _FORMS
        for ulps in (-1, 0, 1)
    ]


def _shapes(_: Size) -> list[Case]:
    def make(form: str, kind: str) -> PictureCase:
        display, shape, pixel = _form(form)
        return display, shaped_picture(display, shape, pixel, kind)

    return [
        Case(f"{kind}, {form}", partial(make, form, kind)) for form in _FORMS for kind in SHAPES
    ]


# -- invalid and extreme inputs -------------------------------------------------------------------


def _not_finite(_: Size) -> list[Case]:
    def uncovered(value: float) -> PictureCase:
        display, rgbd = _with_noise(small_display())
        depth = np.where(rgbd.covered, rgbd.depth_mm, np.float32(value))
        return display, picture_of_depth(depth, rgbd.pixel_mm, rgbd.covered)

    def covered(value: float) -> PictureCase:
        display, rgbd = _with_noise(small_display())
        depth = np.array(rgbd.depth_mm)
        depth[3, 3] = value
        return display, picture_of_depth(depth, rgbd.pixel_mm)

    def changed(changes: dict[str, float]) -> PictureCase:
        return _with_noise(small_display(**changes))

    cases = []
    for value in (math.nan, math.inf, -math.inf):
        cases.append(Case(f"uncovered {value}", partial(uncovered, value)))
        cases.append(Case(f"covered {value}", partial(covered, value), refused=True))
        for name in ("pitch_mm", "gap_mm", "focal_length_mm", "pixel_pitch_mm", "depth_min_mm"):
            other_end = {"depth_max_mm": 40.0} if name == "depth_min_mm" else {}
            changes = {name: value, **other_end}
            cases.append(Case(f"{name} = {value}", partial(changed, changes), refused=True))
    return cases


def _small(_: Size) -> list[Case]:
    def one_cell() -> PictureCase:
        display = small_display()
        return display, noise(display, (1, 1), 3.0, covered=1.1)

    def uncovered() -> PictureCase:
        display, rgbd = _with_noise(small_display())
        return display, picture_of_depth(np.array(rgbd.depth_mm), 0.5, np.zeros(rgbd.shape, bool))

    single = {"lens_columns": 1, "lens_rows": 1}
    empty = np.zeros((0, 0), np.float32)
    return [
        Case("a picture of one pixel", one_cell),
        Case(
            "a picture without pixels",
            lambda: (small_display(), picture_of_depth(empty, 0.5)),
            refused=True,
        ),
        Case(
            "one lens over one pixel",
            lambda: _with_noise(small_display(pixel_pitch_mm=1.0, **single)),
        ),
        Case("no covered pixel", uncovered),
        Case("one lens", lambda: _with_noise(small_display(**single))),
    ]


def _random(size: Size) -> list[Case]:
    return [Case(f"seed {s}", partial(random_picture, s)) for s in range(size.random)]


# -- non-separable displays ---------------------------------------------------------------------


def _turned(angles: tuple[float, ...], **factors: float) -> Callable[[Size], list[Case]]:
    """Displays with each of the angles, times a factor for each parameter."""

    def make(degrees: float) -> PictureCase:
        return _with_noise(small_display(**{name: f * degrees for name, f in factors.items()}))

    return lambda _: [case_at(f"{a:g} degrees", make, a) for a in angles]


def _hexagonal(_: Size) -> list[Case]:
    def make(columns: int, rows: int, pixels: float) -> PictureCase:
        display = small_display(
            lattice="hexagonal", lens_columns=columns, lens_rows=rows, pixel_pitch_mm=1 / pixels
        )
        return _with_noise(display, columns + 7 * rows)

    return [
        Case(f"{n} x {m} lenses of {p:g} pixels", partial(make, n, m, p))
        for n, m in ((1, 1), (1, 2), (2, 1), (2, 3), (3, 4), (4, 5))
        for p in (1, 4, 5, 5.3)
    ]


def _nonseparable_shapes(_: Size) -> list[Case]:
    def make(misalignment: str, kind: str) -> PictureCase:
        display = small_display(**MOUNTINGS[misalignment])
        return display, shaped_picture(display, display.capture_shape(2), 0.5, kind)

    return [Case(f"{k}, {m}", partial(make, m, k)) for m in MOUNTINGS for k in SHAPES]


def _widths(size: Size) -> list[Case]:
    """Increasingly wide arrays: a lens centre and a pixel near it cancel in a ray's slope."""

    def make(lenses: float) -> PictureCase:
        return _with_noise(
            small_display(
                rotation_deg=0.5, lens_columns=int(lenses), depth_min_mm=20.0, depth_max_mm=40.0
            )
        )

    widths = (3, 30, 100, 300, 1000)
    return [case_at(f"{n} lenses", make, float(n)) for n in widths if n <= size.max_lenses]


def _invalid_misalignments(_: Size) -> list[Case]:
    def make(**changes: object) -> PictureCase:
        return _with_noise(small_display(**changes))

    invalid: dict[str, dict[str, object]] = {
        f"{name} = {value}": {name: value}
        for name in ("rotation_deg", "tilt_x_deg", "tilt_y_deg", "pitch_y_mm")
        for value in (math.nan, math.inf, -math.inf)
    }
    invalid["tilted by 11 degrees"] = {"tilt_x_deg": 11.0}
    invalid["a panel tilted through its array"] = {"lens_columns": 60, "tilt_x_deg": 10.0}
    cases = [
        Case(name, partial(make, **changes), refused=True) for name, changes in invalid.items()
    ]
    # The generator detects this one when it assigns pixels to lenses.
    without_lenses = partial(make, rotation_deg=3.0, shift_x_mm=1e3)
    return [*cases, Case("an array outside its panel", without_lenses, refused=None)]


def _random_nonseparable(size: Size) -> list[Case]:
    return [Case(f"seed {s}", partial(_random_nonseparable_case, s)) for s in range(size.random)]


def _random_nonseparable_case(seed: int) -> PictureCase:
    """Random hexagonal, turned or tilted display with a noise picture."""
    rng = np.random.default_rng(seed)
    lattice = str(rng.choice(["square", "hexagonal"]))
    turn = float(rng.choice([0.0, 90.0, rng.uniform(-180, 180)]))
    tilts = rng.uniform(-4, 4, 2) * (rng.random() < 0.5)
    if lattice == "square" and not turn and not tilts.any():
        turn = 1.0
    pixels = float(rng.choice([3, 5, rng.uniform(2, 9)]))
    columns, rows = int(rng.integers(1, 6)), int(rng.integers(1, 5))
    display = small_display(
        lens_columns=columns, lens_rows=rows, pixel_pitch_mm=1 / pixels,
        gap_mm=float(rng.choice([3.3, 2.7, rng.uniform(3.1, 4)])),
        lattice=lattice, rotation_deg=turn, tilt_x_deg=float(tilts[0]), tilt_y_deg=float(tilts[1]),
        shift_x_mm=float(rng.choice([0.0, rng.uniform(-1, 1)])),
    )  # fmt: skip
    if max(display.capture_shape(2)) > 160:
        return _with_window(display, seed)
    return _with_noise(display, seed, per_pitch=int(rng.integers(1, 4)))


# -- all families -------------------------------------------------------------------------------

_EVERY_THIRD = (*range(3, 52, 3), 52)
_EVERY_SIXTH = (*range(3, 52, 6), 52)
_TURNS = (1e-12, 1e-6, 1e-3, 0.03, 0.5, 4.0, 10.0, 30.0, 45.0, 60.0, 89.0, 90.0, 180.0, 360.0)
_TILTS = (1e-12, 1e-6, 1e-3, 0.1, 1.0, 5.0, 10.0)
_MAY, _MUST_NOT = None, False
_POWERS = {
    -60: _MAY, -42: _MAY, -40: _MAY, -30: _MUST_NOT, -9: _MUST_NOT, 9: _MUST_NOT, 18: _MUST_NOT,
    30: _MAY, 36: _MAY, 40: _MAY,
}  # fmt: skip
_FEWER_POWERS = {-40: _MAY, **dict.fromkeys((-30, -9, -3, 3, 9), _MUST_NOT), 30: _MAY}
_BY_POWER = "-log2 |g - f| / f"

_SEPARABLE_FAMILIES = [
    Family("distance in front", "nearest surface, mm", _distances()),
    Family("distance behind", "nearest surface, mm", _distances_behind),
    Family("pixels per lens", "P / P_D", _pixels_per_lens),
    Family("picture pixels per pitch", "P / picture pixel", _picture_pixels_per_pitch),
    Family("g to f from above, default range", _BY_POWER, _focus(_EVERY_THIRD, +1)),
    Family("g to f from below, default range", _BY_POWER, _focus(_EVERY_THIRD, -1)),
    Family("g to f from above, given range", _BY_POWER, _focus(_EVERY_THIRD, +1, has_range=True)),
    Family("g to f from below, given range", _BY_POWER, _focus(_EVERY_THIRD, -1, has_range=True)),
    Family("g to f, fine picture", _BY_POWER, _fine_focus(tuple(range(3, 53, 7)))),
    Family("depth span", "-log2 of span / distance", _depth_spans),
    Family("flat depth", "", _flat),
    Family("ties", "", ties),
    Family("shapes", "", _shapes),
    Family("odd and even", "", _odd_and_even),
    Family("all lengths", "factor", _lengths(_POWERS)),
    Family("subnormal depths", "half the depth range, mm", _subnormal_depths),
    Family("not finite", "", _not_finite),
    Family("small", "", _small),
    Family("many lenses", "lenses", _many_lenses),
    Family("shifted array", "shift to the right, mm", _shifted),
    Family("random displays", "", _random),
]
NONSEPARABLE_FAMILIES = [
    Family("turned array", "degrees", _turned(_TURNS, rotation_deg=1)),
    Family("tilted panel", "degrees", _turned(_TILTS, tilt_x_deg=1, tilt_y_deg=-0.5)),
    Family("hexagonal array", "", _hexagonal),
    *(
        Family(f"{name}, distance", "nearest surface, mm", _distances(**MOUNTINGS[misalignment]))
        for name, misalignment in (
            ("turned array", "turned"),
            ("hexagonal array", "hexagonal"),
            ("misaligned hexagonal array", "all at once"),
        )
    ),
    Family("non-separable displays, shapes", "", _nonseparable_shapes),
    Family("turned array, g to f", _BY_POWER, _focus(_EVERY_SIXTH, rotation_deg=4.0)),
    Family(
        "turned array, g to f, fine picture", _BY_POWER, _fine_focus((3, 24, 45), rotation_deg=4.0)
    ),
    Family("turned array, width", "lenses across", _widths),
    Family(
        "turned array, all lengths",
        "factor",
        _lengths(_FEWER_POWERS, rotation_deg=4.0, tilt_x_deg=1.0),
    ),
    Family("invalid misalignment", "", _invalid_misalignments),
    Family("random non-separable displays", "", _random_nonseparable),
]
FAMILIES = [*_SEPARABLE_FAMILIES, *NONSEPARABLE_FAMILIES]
