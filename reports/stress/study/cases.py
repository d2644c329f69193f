"""Families of cases that push one parameter of a display at a time to where arithmetic fails.

A case is a display and a picture, made when it is run: some are there to be refused. Pictures are
noise unless their family says otherwise: random depths over the whole depth range, a few pixels
uncovered, random colours.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from functools import partial

import numpy as np

from inim.display import Display
from inim.rgbd import RGBD
from inim.stress.case import (
    Case,
    Family,
    Made,
    Size,
    case_at,
    decades,
    display_of,
    noise,
    over,
    shaped,
    sized,
    windowed,
    with_depth,
)
from inim.stress.rays import rays_of

__all__ = ["SEPARABLE_FAMILIES", "random_case", "ties"]


def _distances(size: Size) -> list[Case]:
    def make(z: float) -> Made:
        return windowed(display_of(size, depth_min_mm=z, depth_max_mm=1.5 * z))

    return [case_at(f"{z:g} mm", make, z) for z in decades(-3, 6)]


def _distances_behind(size: Size) -> list[Case]:
    def make(z: float) -> Made:
        range_mm = {"depth_min_mm": -1.5 * z, "depth_max_mm": -z}
        return windowed(display_of(size, focal_length_mm=3.3, gap_mm=3.0, **range_mm))

    return [case_at(f"-{z:g} mm", make, z) for z in decades(-3, 6)]


def _pixels_per_lens(size: Size) -> list[Case]:
    def make(ratio: float) -> Made:
        # A strip of the panel about the axis: all of it would be millions of pixels.
        panel = {"panel_rows": 3, "panel_columns": max(1, min(3000, round(3 * ratio)))}
        display = display_of(
            size, lens_columns=3, lens_rows=3, pixel_pitch_mm=1 / ratio,
            depth_min_mm=20.0, depth_max_mm=40.0, **panel,
        )  # fmt: skip
        return sized(display)

    below = [case_at(f"{r:g}", make, r, refused=True) for r in (1e-3, 1e-2, 0.1, 0.999)]
    ratios = (1.0, 1.5, 2.0, 3.3, 10.0, 15.7, 17.0, 33.3, 100.0, 333.3, 1000.0)
    return below + [case_at(f"{r:g}", make, r) for r in ratios]


def _picture_pixels_per_pitch(size: Size) -> list[Case]:
    def make(ratio: float) -> Made:
        # Through the array, so that rays cross a few cells of the finest picture too.
        half = min(4.0, 40 / ratio)
        display = display_of(size, depth_min_mm=-half, depth_max_mm=half)
        cells = min(48, math.ceil((display.width_mm + 2) * ratio))
        return display, noise(display, (cells, cells), 1 / ratio)

    ratios = (1e-3, 1e-2, 0.1, 0.5, 1.0, 1.7, 2.0, 3.0, 3.7, 10.0, 33.0, 100.0, 333.3, 1000.0)
    return [case_at(f"{r:g}", make, r) for r in ratios]


def _focus(side: int, stated: bool) -> Callable[[Size], list[Case]]:
    """G = f (1 +- 2^-k), down to one ulp; D and its own depth range grow without bound."""

    def cases(size: Size) -> list[Case]:
        def make(k: float) -> Made:
            gap = 3.0 * (1 + side * 2.0 ** -int(k))
            own = {"gap_mm": gap}
            if stated:
                own |= {"depth_min_mm": 5.0, "depth_max_mm": 20.0}
            return windowed(display_of(size, **own))

        found = [case_at(f"|g - f| / f = 2^-{k}", make, float(k)) for k in (*range(3, 52, 3), 52)]
        exact = math.inf
        return [*found, Case("g = f", lambda: make(2000), exact, refused=not stated)]

    return cases


def _fine_focus(size: Size) -> list[Case]:
    """As a capture would be made, whole pixels per pitch: far too many cells at some distance."""

    def make(k: float) -> Made:
        display = display_of(size, gap_mm=3.0 * (1 + 2.0 ** -int(k)))
        return display, noise(display, (48, 48), 0.5)

    return [case_at(f"|g - f| / f = 2^-{k}", make, float(k), refused=None) for k in range(3, 53, 7)]


def _depth_spans(size: Size) -> list[Case]:
    def make(k: float) -> Made:
        top = 20.0 * (1 + 2.0 ** -int(k))
        return sized(display_of(size, depth_min_mm=20.0, depth_max_mm=top))

    found = [case_at(f"20 mm x 2^-{k}", make, float(k)) for k in (*range(0, 52, 3), 52)]
    return [*found, Case("no depth at all", lambda: make(2000), math.inf, refused=True)]


def _flat(size: Size) -> list[Case]:
    def make(z: float, **changes: object) -> Made:
        display = display_of(size, **changes)
        shape, pixel = over(display)
        return display, with_depth(np.full(shape, z, np.float32), pixel)

    display = display_of(size)
    low, high = display.depth_range_mm
    through = {"depth_min_mm": -4.0, "depth_max_mm": 6.0}
    places = {
        "at z_min": low,
        "at z_max": high,
        "at D": display.central_depth_mm,
        "an ulp beyond z_min": np.nextafter(np.float32(low), np.float32(-np.inf)),
        "an ulp above z_max": np.nextafter(np.float32(high), np.float32(np.inf)),
    }
    found = [case_at(name, make, z) for name, z in places.items()]
    for name, z in {"on the array": 0.0, "just in front": 1e-30, "just behind": -1e-30}.items():
        found.append(Case(name, partial(make, z, **through)))
    return [Case(c.label, c.make) for c in found]


_FORMS: dict[str, tuple[dict[str, object], float]] = {
    "lists": ({}, 0.5),
    "lists, binary lengths": ({"gap_mm": 4.0, "pixel_pitch_mm": 0.125}, 0.5),
    "strips": ({"elemental_pitch_mm": 1.001}, 0.5),
    "strips, virtual": ({"focal_length_mm": 3.3, "gap_mm": 3.0, "pixel_pitch_mm": 0.19}, 0.5),
    "ray by ray": ({}, 0.3),
}


def _form(size: Size, form: str) -> tuple[Display, tuple[int, int], float]:
    changes, pixel = _FORMS[form]
    display = display_of(size, **changes)
    shape = display.capture_shape(2)
    return display, (round(shape[0] * 0.5 / pixel), round(shape[1] * 0.5 / pixel)), pixel


def ties(size: Size) -> list[Case]:
    """Depths that are template boundaries, or the float32 next to one on either side."""

    def make(form: str, ulps: int) -> Made:
        display, shape, pixel = _form(size, form)
        blank = noise(display, shape, pixel, seed=ulps + 5)
        depth = _boundary_depths(display, blank)
        for _ in range(abs(ulps)):
            depth = np.nextafter(depth, np.float32(math.copysign(math.inf, ulps)))
        return display, with_depth(depth, pixel, blank.covered)

    return [
        Case(f"{form}, {ulps:+d} ulp", partial(make, form, ulps))
        for form in _FORMS
        for ulps in (-1, 0, 1)
    ]


def _boundary_depths(display: Display, blank: RGBD) -> np.ndarray:
    """For each picture pixel, the float32 nearest to a depth at which some ray leaves it."""
    low, high = display.depth_range_mm
    rays = rays_of(display, blank, np.zeros((1, 2), int))
    depth = np.array(blank.depth_mm)
    rng = np.random.default_rng(7)
    for axis, line in ((0, rays.rows), (1, rays.columns)):
        for i in range(len(line.start)):
            if line.slope[i] == 0:
                continue
            ends = sorted((line.start[i] + line.slope[i] * Fraction(z)) for z in (low, high))
            for border in range(math.floor(ends[0]) + 1, math.ceil(ends[1])):
                cell = border if line.slope[i] > 0 else border - 1
                if not 0 <= cell < depth.shape[axis]:
                    continue
                z = np.float32(float((border - line.start[i]) / line.slope[i]))
                across = rng.random(depth.shape[1 - axis]) < 0.3
                depth[(cell, across) if axis == 0 else (across, cell)] = z
    return depth


def _shapes(size: Size) -> list[Case]:
    def make(form: str, kind: str) -> Made:
        display, shape, pixel = _form(size, form)
        return display, shaped(kind, display, shape, pixel)

    kinds = ("spikes", "slits", "checkerboard", "ramp", "stairs")
    return [Case(f"{kind}, {form}", partial(make, form, kind)) for form in _FORMS for kind in kinds]


def _odd_and_even(size: Size) -> list[Case]:
    del size

    def make(columns: int, rows: int, pixels: int, per_pitch: int) -> Made:
        small = Size((columns, rows), pixels, 1, 0, 0, 0)
        return sized(display_of(small), seed=columns + 7 * rows, per_pitch=per_pitch)

    return [
        Case(
            f"{n} x {m} lenses of {p} pixels, {k} per pitch",
            partial(make, n, m, p, k),
        )
        for n, m in ((1, 1), (1, 2), (2, 2), (3, 2), (4, 4))
        for p, k in ((1, 1), (2, 1), (3, 2), (4, 3), (5, 2))
    ]


def _tiny_lengths(size: Size) -> list[Case]:
    """All lengths times a factor, down to where floats end."""

    def make(factor: float) -> Made:
        lengths = {"pitch_mm": 1.0, "focal_length_mm": 3.0, "gap_mm": 3.3}
        scaled = {name: value * factor for name, value in lengths.items()}
        pixel = factor / size.pixels
        display = display_of(size, **scaled, pixel_pitch_mm=pixel)
        return display, noise(display, *over(display))

    may = dict.fromkeys((-60.0, -42.0, -40.0, 30.0, 36.0, 40.0))
    powers = (-60.0, -42.0, -40.0, -30.0, -9.0, 9.0, 18.0, 30.0, 36.0, 40.0)
    return [
        case_at(f"10^{p:g}", make, 10.0**p, refused=None if p in may else False) for p in powers
    ]


def _subnormal_depths(size: Size) -> list[Case]:
    def make(half: float) -> Made:
        display = display_of(size, depth_min_mm=-half, depth_max_mm=half)
        return display, noise(display, (12, 12), 0.5)

    return [case_at(f"+-{z:g} mm", make, z) for z in (1e-45, 1e-42, 1e-38, 1e-30, 1e-10)]


def _not_finite(size: Size) -> list[Case]:
    def garbage(value: float) -> Made:
        display, rgbd = sized(display_of(size))
        depth = np.where(rgbd.covered, rgbd.depth_mm, np.float32(value))
        return display, with_depth(depth, rgbd.pixel_mm, rgbd.covered)

    def covered(value: float) -> Made:
        display, rgbd = sized(display_of(size))
        depth = np.array(rgbd.depth_mm)
        depth[3, 3] = value
        return display, with_depth(depth, rgbd.pixel_mm)

    def with_changes(changes: dict[str, float]) -> Made:
        return sized(display_of(size, **changes))

    found = []
    for value in (math.nan, math.inf, -math.inf):
        found.append(Case(f"uncovered {value}", partial(garbage, value)))
        found.append(Case(f"covered {value}", partial(covered, value), refused=True))
        for name in ("pitch_mm", "gap_mm", "focal_length_mm", "pixel_pitch_mm", "depth_min_mm"):
            both = {"depth_max_mm": 40.0} if name == "depth_min_mm" else {}
            given = {name: value, **both}
            found.append(
                Case(
                    f"{name} = {value}",
                    partial(with_changes, given),
                    refused=True,
                )
            )
    return found


def _small(size: Size) -> list[Case]:
    def one_cell() -> Made:
        display = display_of(size)
        return display, noise(display, (1, 1), 3.0, covered=1.1)

    def empty() -> Made:
        return display_of(size), with_depth(np.zeros((0, 0), np.float32), 0.5)

    def one_panel_pixel() -> Made:
        one = Size((1, 1), 1, 1, 0, 0, 0)
        return sized(display_of(one))

    def bare() -> Made:
        display, rgbd = sized(display_of(size))
        return display, with_depth(np.array(rgbd.depth_mm), 0.5, np.zeros(rgbd.shape, bool))

    return [
        Case("a picture of one pixel", one_cell),
        Case("a picture without pixels", empty, refused=True),
        Case("one lens over one pixel", one_panel_pixel),
        Case("nothing covered", bare),
        Case("one lens", lambda: sized(display_of(size, lens_columns=1, lens_rows=1))),
    ]


def _many_lenses(size: Size) -> list[Case]:
    def make(pixels: int) -> Made:
        many = Size((size.many, size.many), pixels, 1, 0, 0, 0)
        display = display_of(many, depth_min_mm=2.0, depth_max_mm=6.0)
        return sized(display, per_pitch=1)

    side = size.many
    return [
        Case(f"{side} x {side} lenses of {p} pixels", partial(make, p), side**2)
        for p in ((2,) if size.many < 1000 else (1, 2))
    ]


def random_case(seed: int) -> Made:
    """A random display of plausible lengths in random units, and a random picture over it."""
    rng = np.random.default_rng(seed)
    pitch = float(rng.choice([1.0, 0.5, 0.93, 1 / 3, rng.uniform(0.1, 3)]))
    pixels = float(rng.choice([3, 5, 7.5, 4.25, rng.uniform(2, 9)]))
    f = pitch * float(rng.choice([2.0, 3.0, rng.uniform(1.5, 5)]))
    gap = f * float(rng.choice([1.1, 0.9, 1.25, rng.uniform(0.7, 1.4)]))
    near, far = np.sort(rng.uniform(-30, 30, 2)) * pitch
    stated = {"depth_min_mm": near, "depth_max_mm": far} if rng.random() < 0.5 else {}
    display = Display(
        pitch, f, gap, pitch / pixels, int(rng.integers(1, 6)), int(rng.integers(1, 5)), **stated
    )
    per_pitch = int(rng.integers(1, 4))
    if rng.random() < 0.4:
        return display, noise(display, (40, 36), pitch / float(rng.uniform(0.5, 3)), seed)
    shape = display.capture_shape(per_pitch)
    if max(shape) > 160:  # a display out of focus reaches far; its picture need not
        return windowed(display, seed)
    return display, noise(display, shape, pitch / per_pitch, seed)


def _shifted(size: Size) -> list[Case]:
    """Arrays beside the panel's middle, by whole and half pixels and pitches."""

    def make(shift: float, up: float, pixel: float) -> Made:
        display = display_of(size, shift_x_mm=shift, shift_y_mm=up)
        shape = display.capture_shape(2)
        return display, noise(display, shape, pixel, seed=11)

    one = 1 / size.pixels
    shifts = {
        "half a pixel": (one / 2, 0.0),
        "a pixel": (one, 0.0),
        "half a pixel each way": (one / 2, -one / 2),
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


def _random(size: Size) -> list[Case]:
    return [Case(f"seed {s}", partial(random_case, s)) for s in range(size.random)]


SEPARABLE_FAMILIES = [
    Family("distance in front", "nearest surface, mm", _distances),
    Family("distance behind", "nearest surface, mm", _distances_behind),
    Family("pixels per lens", "P / P_D", _pixels_per_lens),
    Family("picture pixels per pitch", "P / picture pixel", _picture_pixels_per_pitch),
    Family("g to f from above, own range", "-log2 |g - f| / f", _focus(+1, stated=False)),
    Family("g to f from below, own range", "-log2 |g - f| / f", _focus(-1, stated=False)),
    Family("g to f from above, stated range", "-log2 |g - f| / f", _focus(+1, stated=True)),
    Family("g to f from below, stated range", "-log2 |g - f| / f", _focus(-1, stated=True)),
    Family("g to f, fine picture", "-log2 |g - f| / f", _fine_focus),
    Family("depth span", "-log2 of span / distance", _depth_spans),
    Family("flat depth", "", _flat),
    Family("ties", "", ties),
    Family("shapes", "", _shapes),
    Family("odd and even", "", _odd_and_even),
    Family("all lengths", "factor", _tiny_lengths),
    Family("subnormal depths", "half the depth range, mm", _subnormal_depths),
    Family("not finite", "", _not_finite),
    Family("small", "", _small),
    Family("many lenses", "lenses", _many_lenses),
    Family("shifted array", "shift to the right, mm", _shifted),
    Family("random displays", "", _random),
]
