"""Algorithms against exact first hits and their own definitions, and under symmetries.

If two ways to one result differ in a pixel whose decision depends on rounding, both are correct.
The algorithm itself determines these pixels: they change if lengths and depths are changed by a
ten-millionth (`within_rounding`). Deviations count the other pixels.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np

from inim.apps.stress.oracles.generators import answer, exact_first_hits, with_rational_ties
from inim.apps.stress.oracles.rays import Rays, chosen_pixels, rays_over
from inim.apps.stress.pictures import (
    KINDS,
    SHAPES,
    PictureCase,
    algorithm_output,
    colours_of,
    displays,
    input_of,
    is_first_hit,
    misaligned_pictures,
    noise,
    noise_pictures,
    picture_of_depth,
    random_picture,
    scaled,
    shaped_picture,
    small_display,
    solids_of,
    tied_picture,
    window,
)
from inim.apps.stress.relation import ALGORITHMS, Deviation, difference, is_true, relation
from inim.display import Display
from inim.generators import (
    HOLE,
    NO_LENS,
    SourceGenerator,
    find_sources,
    parse_algorithm,
    prepare,
)
from inim.generators.accuracy_limits import accuracy_warnings
from inim.generators.base import MASKED, hole_fraction
from inim.generators.oracle import exact_hits
from inim.generators.template import ray_by_ray
from inim.image.rgbd import RGBD, Layer, LayeredRGBD
from inim.system.errors import InimError

_COVERS = "generators display.pixels display.layouts display.display image.rgbd"
# Relative change of lengths to find pixels that depend on rounding: about an ulp of float32.
_NUDGE = 1e-7
# Lens rows of hexagonal arrays with symmetry: even for a half turn, odd for a mirror.
_EVEN, _ODD = 4, 3
# Colour of an added object; all other colours are below 1.
_MARK = np.float32(1024)
_NOT_PROMISED = "follows from the definition of a first hit, which this algorithm's is not"
_BY_NEIGHBOURS = "follows only for columns whose ends do not depend on their neighbours"
_BITS = {"limit": 0, "unit": "pixels beyond rounding", "subjects": ALGORITHMS, "covers": _COVERS}
_BITWISE = {**_BITS, "unit": "pixels", "source": "no arithmetic, or powers of two only"}
_ROUNDED = {**_BITS, "source": "pixels that change with lengths by 1e-7 may differ"}

#: Output of the algorithm for a picture on a display, (rows, columns, 3).
_Show = Callable[[RGBD, Display], np.ndarray]
_Pictures = Callable[[], Iterable[PictureCase]]


def _unless_first_hit(algorithm: str) -> str:
    return "" if is_first_hit(algorithm) else _NOT_PROMISED


def _with_own_columns(algorithm: str) -> str | None:
    """Explanation of relations of pictures of one layer, whose columns do not end."""
    if parse_algorithm(algorithm).reads is not RGBD:
        return None
    by_neighbours = parse_algorithm(algorithm).columns == "surface"
    return _unless_first_hit(algorithm) or (_BY_NEIGHBOURS if by_neighbours else "")


# -- first hits and definitions -----------------------------------------------------------------


@cache
def _pictures(effort: int) -> list[tuple[str, PictureCase]]:
    """Noise over every kind of display, shapes, ties and random displays."""
    return [*_make_pictures(effort)]


def _make_pictures(effort: int) -> Iterator[tuple[str, PictureCase]]:
    for seed, (name, display) in enumerate(displays()):
        rows, columns = display.capture_shape(2)
        yield name, (display, noise(display, (rows, columns), display.capture_pixel_mm(2), seed))
    for name in ("real", "binary lengths", "virtual", "aimed", "shifted"):
        display = small_display(**KINDS[name])
        for ulps in (0, -1, 1)[:effort]:
            shape = display.capture_shape(2)
            yield f"ties, {name}, {ulps:+d} ulp", (display, tied_picture(display, shape, 0.5, ulps))
    display = small_display()
    for kind in SHAPES[: 1 + 2 * effort]:
        shape = display.capture_shape(2)
        yield kind, (display, shaped_picture(display, shape, 0.5, kind))
    for pixel in (0.3, 0.35):
        yield f"pixels of {pixel}", (display, noise(display, (31, 28), pixel, seed=5))
    for seed in range(2 * effort):
        yield f"random, seed {seed}", random_picture(seed)
    single = small_display(lens_columns=1, lens_rows=1)
    yield "a picture of one pixel", (single, noise(single, (1, 1), 1.0, covered=1.1))
    empty = np.zeros((8, 8), bool)
    yield "no surface", (display, picture_of_depth(np.ones((8, 8), np.float32), 0.5, empty))
    low, high = display.depth_range_mm
    for name, depth in (("z_min", low), ("z_max", high), ("D", display.central_depth_mm)):
        flat = np.full(display.capture_shape(2), depth, np.float32)
        yield f"flat at {name}", (display, picture_of_depth(flat, 0.5))


def _sources_of(algorithm: str, display: Display, picture: RGBD) -> np.ndarray | None:
    """Sources of an algorithm; None if it reports none."""
    generator = prepare(display, algorithm, shape=picture.shape, pixel_mm=picture.pixel_mm)
    if isinstance(generator, SourceGenerator):
        return generator.sources(picture)
    generator.generate(picture)
    return None


@dataclass(frozen=True)
class _Case:
    """Panel pixels of a picture by a rule of columns; equal for algorithms with the same rule."""

    display: Display
    picture: RGBD
    rule: str
    most: int

    @property
    def key(self) -> tuple[Any, ...]:
        """Values that decide its exact sources."""
        depths = (v.tobytes() for s in self.picture.layers for v in (s.front_mm, s.covered))
        return self.display, self.rule, self.most, self.picture.pixel_mm, *map(hash, depths)


_EXACT: dict[tuple[Any, ...], tuple[np.ndarray, Rays, np.ndarray]] = {}


def _exact(case: _Case) -> tuple[np.ndarray, Rays, np.ndarray]:
    """Pixels, their rays, and their exact sources, computed once for all algorithms."""
    if case.key not in _EXACT:
        pixels = chosen_pixels(case.display, case.most)
        rays = rays_over(case.display, case.picture, pixels)
        every = np.arange(len(pixels))
        exact = exact_first_hits(rays, case.picture, case.display, every, case.rule)
        _EXACT[case.key] = pixels, rays, exact
    return _EXACT[case.key]


def _against_first_hits(
    case: str, algorithm: str, display: Display, rgbd: RGBD, most: int, **more: Any
) -> Deviation:
    """Wrong sources of an algorithm among exact first hits, drawn at random."""
    picture, rule = input_of(rgbd, display, algorithm), parse_algorithm(algorithm).columns
    try:
        sources = _sources_of(algorithm, display, picture)
    except InimError:
        if is_first_hit(algorithm):
            raise
        return Deviation(case, 0.0, 0, **more)  # it does not support the display
    if sources is None:
        return Deviation(case, 0.0, 0, **more)
    warned = bool(accuracy_warnings(display, pixel_mm=rgbd.pixel_mm))
    pixels, rays, exact = _exact(_Case(display, picture, rule, most))
    own = sources[tuple(pixels.T)]
    wrong, certain = own != exact, np.ones(len(pixels), bool)
    if not display.is_separable and wrong.any():
        name = {"layers": "layered", "solid": "template:columns=solid"}.get(rule, "template")
        certain = ~answer(name, rays, picture, display, np.float64).uncertain
    is_hit = wrong & (own >= 0) & (exact >= 0)
    rows, columns = (
        np.subtract(
            *(np.unravel_index(s[is_hit] % rgbd.depth_mm.size, rgbd.shape)[k] for s in (own, exact))
        )
        for k in (0, 1)
    )
    farthest = float(np.hypot(rows, columns).max(initial=0))
    beyond = int((wrong & certain).sum())
    # Warnings announce ties of regular mounted arrays, whose certain pixels are right all the same.
    excused = warned and display.is_separable
    return Deviation(case, beyond, len(pixels), int(wrong.sum()), farthest=farthest,
                     warned=excused, **more)  # fmt: skip


@relation(
    "first hits", **_BITS, source="rational numbers; no tolerance",
    explain=_unless_first_hit,
)  # fmt: skip
def _first_hits(algorithm: str, effort: int) -> Iterator[Deviation]:
    """Every source is the first surface on the ray of its pixel, in rational numbers."""
    for name, (display, rgbd) in _pictures(effort):
        yield _against_first_hits(name, algorithm, display, rgbd, 36 if effort > 1 else 12)


def _growth(
    algorithm: str, effort: int, positions: Iterable[float], make: Callable[[float], PictureCase]
) -> Iterator[Deviation]:
    for position in positions:
        display, rgbd = make(position)
        yield _against_first_hits(
            f"{position:g}", algorithm, display, rgbd, 10 + 10 * effort, position=position
        )


def _distance(z: float) -> PictureCase:
    display = small_display(depth_min_mm=min(z, 1.5 * z), depth_max_mm=max(z, 1.5 * z))
    shape, pixel = window(display)
    return display, noise(display, shape, min(pixel, 1.0))


def _length_scale(factor: float) -> PictureCase:
    display = scaled(small_display(), factor)
    return display, noise(display, display.capture_shape(2), display.capture_pixel_mm(2))


def _near_focus(power: float) -> PictureCase:
    display = small_display(gap_mm=3.0 * (1 + 2.0**-power), depth_min_mm=5.0, depth_max_mm=20.0)
    return display, noise(display, *window(display))


_HITS = {**_BITS, "source": "rational numbers; beyond their digits, validations warn",
         "explain": _unless_first_hit}  # fmt: skip


@relation("growth of error with distance", axis="distance of the nearest surface, mm", **_HITS)
def _distances(algorithm: str, effort: int) -> Iterator[Deviation]:
    """First hits are exact from a micrometre to a metre in front of the array."""
    steps = [10.0**k for k in range(-3, 4, 1 if effort > 1 else 3)]
    yield from _growth(algorithm, effort, steps, _distance)


@relation("growth of error with lengths", axis="factor of all lengths", **_HITS)
def _factors(algorithm: str, effort: int) -> Iterator[Deviation]:
    """First hits are exact for displays from a nanometre to a thousand kilometres."""
    steps = [10.0**k for k in range(-6, 7, 1 if effort > 1 else 6)]
    yield from _growth(algorithm, effort, steps, _length_scale)


@relation("growth of error near focus", axis="-log2 of (g - f) / f", **_HITS)
def _focus(algorithm: str, effort: int) -> Iterator[Deviation]:
    """First hits are exact for gaps down to the focal length, or a validation warns."""
    yield from _growth(algorithm, effort, range(3, 53, 7 if effort > 1 else 24), _near_focus)


_DEFINED = ("template", "gu2020", "wang2024", "wang2024:matching=ray", "li2012")


@relation(
    "definitions", limit=0, unit="pixels beyond rounding", subjects=_DEFINED, covers=_COVERS,
    source="pixels that the oracle's own coordinates decide within four roundings may differ",
)  # fmt: skip
def _definitions(algorithm: str, effort: int) -> Iterator[Deviation]:
    """Sources are those of the paper's definition, computed by other methods in float64."""
    most = {"wang2024": 6, "wang2024:matching=ray": 6, "li2012": 12}.get(algorithm, 20) * effort
    for name, (display, rgbd) in _pictures(effort):
        try:
            sources = find_sources(rgbd, display, algorithm)
        except InimError:
            if not display.is_separable:
                continue
            raise
        if algorithm == "li2012" and not display.is_separable:
            continue  # the oracle counts rows and columns
        rays = rays_over(display, rgbd, chosen_pixels(display, most))
        low, high = display.depth_range_mm
        steps = (high - low) / display.scene_pixel_mm
        if algorithm == "gu2020" and steps * len(rays.pixels) > 100_000:
            continue
        expected = answer(algorithm, rays, rgbd, display, np.float64)
        truth = expected.sources
        if algorithm == "template":
            truth, _ = with_rational_ties(algorithm, expected, truth, rays, rgbd, display)
        wrong = (sources[tuple(rays.pixels.T)] != truth) & ~expected.uncertain
        warned = bool(accuracy_warnings(display, pixel_mm=rgbd.pixel_mm)) and display.is_separable
        yield Deviation(name, int(wrong.sum()), len(wrong), int(wrong.sum()), warned=warned)


@relation(
    "definitions at ties", limit=0, unit="pixels", subjects=_DEFINED, covers=_COVERS,
    source="short binary lengths, of which nothing is rounded",
)  # fmt: skip
def _exact_definitions(algorithm: str, effort: int) -> Iterator[Deviation]:
    """Ties of a definition are decided as it states, where float64 holds all of its numbers."""
    binary = {"gap_mm": 4.0, "pixel_pitch_mm": 0.125}
    # Rays of 1/32, 3/32, ... cells per mm: over 16 mm, half-integral numbers of entries.
    halves = small_display(**binary, depth_min_mm=5.0, depth_max_mm=21.0)
    short = small_display(**binary, depth_min_mm=-0.5, depth_max_mm=0.75)
    level = small_display(**binary, depth_min_mm=4.0, depth_max_mm=8.0)
    # Single entries are in other cells at the ends of the range than in its middle.
    beside = small_display(**binary, depth_min_mm=-1.0, depth_max_mm=1.0, shift_x_mm=0.1875)
    # A point on the panel's axis lies on the border between two of its four columns.
    lone = small_display(gap_mm=4.0, pixel_pitch_mm=0.25, lens_columns=1, lens_rows=1)
    shape = (16, 18)
    flat, last = (picture_of_depth(np.full(shape, z, np.float32), 0.5) for z in (8.0, 4.0))
    for name, display, rgbd in (
        ("beside centres", beside, noise(beside, shape, 0.5, 5)),
        ("on the axis", lone, noise(lone, (9, 9), 0.25, 6)),
        ("at z_min", level, last),
        ("half steps", halves, noise(halves, (48, 48), 0.5, 2)),
        ("short rays", short, noise(short, shape, 0.5, 4)),
        ("at z_max", level, flat),
    ):
        # The whole matrix of an entry takes longest.
        most = (12 if algorithm == "wang2024" else 60) * effort
        rays = rays_over(display, rgbd, chosen_pixels(display, most))
        if algorithm == "template":
            truth = exact_first_hits(rays, rgbd, display, np.arange(len(rays.pixels)))
        else:
            truth = answer(algorithm, rays, rgbd, display, np.float64).sources
        wrong = find_sources(rgbd, display, algorithm)[tuple(rays.pixels.T)] != truth
        yield Deviation(name, int(wrong.sum()), len(wrong), int(wrong.sum()))


@relation(
    "planes under cylinders", limit=0, unit="pixels", subjects=("li2012",), covers=_COVERS,
    source="the row of the picture in which the ray of a pixel meets the plane",
)  # fmt: skip
def _planes_under_cylinders(algorithm: str, effort: int) -> Iterator[Deviation]:
    """Along cylinders, which magnify nothing, a row of the picture colours the rays meeting it."""
    for name, display in displays():
        if not display.layout.of_cylinders or display.subpixels == "cells":
            continue
        for z in np.linspace(*display.depth_range_mm, 4):
            shape = display.capture_shape(2)
            rgbd = picture_of_depth(np.full(shape, z, np.float32), display.capture_pixel_mm(2))
            try:
                sources = find_sources(rgbd, display, algorithm)
            except InimError:  # a tilted array
                continue
            rays = rays_over(display, rgbd, chosen_pixels(display, 100 * effort))
            own = sources[tuple(rays.pixels.T)]
            down = rays.v0 + rays.dv * float(np.float32(z))
            clear = (own >= 0) & (np.abs(down - np.rint(down)) > 1e-6)
            wrong = clear & (own // shape[1] != np.floor(down))
            yield Deviation(f"{name}, {z:g} mm", int(wrong.sum()), int(clear.sum()))


@relation("wrong sources are counted", **_BITWISE)
def _counted(algorithm: str, effort: int) -> Iterator[Deviation]:
    """Sources are within the picture, holes and pixels without a lens are marked, shares agree."""
    for name, display in displays():
        rgbd = noise(display, display.capture_shape(2), display.capture_pixel_mm(2), 3)
        try:
            sources = _sources_of(algorithm, display, input_of(rgbd, display, algorithm))
        except InimError:
            continue
        if sources is None:
            continue
        yield is_true(f"{name}: marks", (sources == NO_LENS) == ~display.lensed, sources.size)
        cells = rgbd.depth_mm.size * (1 if parse_algorithm(algorithm).reads is RGBD else 3)
        yield is_true(f"{name}: range", (sources >= NO_LENS) & (sources < cells), sources.size)
        share = (sources == HOLE).sum() / display.lensed.sum()
        yield difference(f"{name}: holes", hole_fraction(sources), share)
        if not is_first_hit(algorithm) or not display.is_separable:
            continue
        if parse_algorithm(algorithm).reads is RGBD:
            hits = exact_hits(rgbd, display, parse_algorithm(algorithm).columns, 30)
            moved = np.where(sources >= 0, sources + 1, sources)
            share = (moved[tuple(hits.pixels.T)] != hits.sources).mean()
            yield difference(f"{name}: wrong share", hits.wrong_share(moved), share)


# -- comparisons of two results -----------------------------------------------------------------


def _check(
    case: str, algorithm: str, rgbd: RGBD, display: Display, same: np.ndarray, which: np.ndarray,
    *, bitwise: bool,
) -> Deviation:  # fmt: skip
    """Pixels that break a relation, without those that depend on rounding unless `bitwise`.

    Relations that need not hold for an algorithm count all pixels: to find those that depend on
    rounding takes longest.
    """
    broken = which & ~same
    beyond = broken
    if broken.any() and not bitwise:
        near = within_rounding(rgbd, display, partial(algorithm_output, algorithm=algorithm))
        beyond = broken & ~near
    return Deviation(case, int(beyond.sum()), int(which.sum()), int(broken.sum()))


def within_rounding(rgbd: RGBD, display: Display, show: _Show) -> np.ndarray:
    """Panel pixels that change if lengths or depths change by rounding, (rows, columns) bool.

    The gap, the depths and the array's position are each moved up and down by about one float32
    ulp.
    """
    low, high = display.depth_range_mm
    still = display.replace(depth_min_mm=low, depth_max_mm=high)
    before = show(rgbd, display)
    changes = np.zeros(display.eia_shape, bool)
    for sign in (1, -1):
        depth = np.nextafter(rgbd.depth_mm, np.float32(sign * np.inf))
        step = sign * _NUDGE
        by = step * display.pitch_mm
        moved = [
            (rgbd, still.replace(gap_mm=display.gap_mm * (1 + step))),
            (RGBD(rgbd.color, depth, rgbd.covered, rgbd.pixel_mm), display),
            *(
                (rgbd, _shift_array(display, by * right, by * up))
                for right, up in ((1, 0), (0, 1), (1, 1), (1, -1))
            ),
        ]
        for picture, other in moved:
            changes |= ~same_colour(before, show(picture, other))
    return changes


def _shift_array(display: Display, right_mm: float, up_mm: float) -> Display:
    x, y = display.shift_x_mm + right_mm, display.shift_y_mm + up_mm
    return display.replace(shift_x_mm=x, shift_y_mm=y)


def same_colour(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Mask of equal colours in two arrays, (rows, columns) bool."""
    is_equal: np.ndarray = (a == b).all(axis=-1)
    return is_equal


def _shown(algorithm: str) -> tuple[_Show, bool]:
    """The algorithm's output, and whether its definition decides ties."""
    return partial(algorithm_output, algorithm=algorithm), is_first_hit(algorithm)


def _rearrange(rgbd: RGBD, move: Callable[[np.ndarray], np.ndarray]) -> RGBD:
    """Apply a change of rows and columns to all arrays of a picture."""
    return RGBD(move(rgbd.color), move(rgbd.depth_mm), move(rgbd.covered), rgbd.pixel_mm)


@relation("moved by a lens", **_ROUNDED)
def _shift(algorithm: str, effort: int) -> Iterator[Deviation]:
    """A picture moved by one pitch shows under the next lens."""
    show, exact = _shown(algorithm)
    for display, rgbd in noise_pictures():
        if not display.has_integer_ratio:
            continue  # lenses have different numbers of pixels
        cells, pixels = 2, round(display.pixels_per_lens)
        moved = _rearrange(rgbd, partial(np.roll, shift=cells, axis=1))
        before, after = show(rgbd, display)[:, :-pixels], show(moved, display)[:, pixels:]
        which, same = np.zeros(display.eia_shape, bool), np.ones(display.eia_shape, bool)
        which[:, :-pixels] = _away_from_rim(display, rgbd, cells)[:, :-pixels]
        same[:, :-pixels] = same_colour(before, after)
        yield _check("to the right", algorithm, rgbd, display, same, which, bitwise=exact)


def _away_from_rim(display: Display, rgbd: RGBD, cells: int) -> np.ndarray:
    """Panel pixels whose rays do not reach the cells that `np.roll` moved to the other side."""
    ends = np.array(display.depth_range_mm)[:, None]
    at = (display.columns.centre_mm + display.columns.slope * ends) / rgbd.pixel_mm
    at += rgbd.shape[1] / 2
    clear = (at >= cells).all(axis=0) & (at < rgbd.shape[1] - cells).all(axis=0)
    is_clear: np.ndarray = display.lensed & clear[None, :]
    return is_clear


def _flip(
    algorithm: str, axes: tuple[int, ...], pictures: _Pictures, negated: tuple[str, ...] = ()
) -> Iterator[Deviation]:
    """Flip the picture and negate misalignments, which flips the EIA."""
    show, exact = _shown(algorithm)
    for display, rgbd in pictures():
        flipped = _rearrange(rgbd, lambda values: np.flip(values, axes))
        turned = display.replace(**{name: -getattr(display, name) for name in negated})
        try:
            before, after = show(rgbd, display), np.flip(show(flipped, turned), axes)
        except InimError:
            if exact:
                raise
            continue
        which = display.lensed & _off_borders(display, rgbd)
        bitwise = exact and display.is_separable
        yield _check(f"axes {axes}", algorithm, rgbd, display, same_colour(before, after), which,
                     bitwise=bitwise)  # fmt: skip


def _off_borders(display: Display, rgbd: RGBD) -> np.ndarray:
    """Panel pixels whose ray does not follow a border between picture pixels.

    Pixels on a border between lenses are also excluded: by rule, such points belong to one side.
    """
    if not display.is_separable:
        return np.ones(display.eia_shape, bool)
    clear = []
    for axis, cells in ((display.rows, rgbd.shape[0]), (display.columns, rgbd.shape[1])):
        start = axis.centre_mm / rgbd.pixel_mm + cells / 2
        along = (axis.slope == 0) & (np.abs(start - np.rint(start)) < 1e-9)
        half = abs(display.elemental_image_pitch_mm / 2)
        on_edge = np.abs(np.abs(axis.position_mm - axis.centre_mm) - half) < 1e-9
        clear.append(~along & ~on_edge)
    is_clear: np.ndarray = clear[0][:, None] & clear[1][None, :]
    return is_clear


@relation("mirrored", **_ROUNDED)
def _mirror(algorithm: str, effort: int) -> Iterator[Deviation]:
    """A mirrored picture gives a mirrored EIA, also under mirrored misalignments."""
    yield from _flip(algorithm, (1,), noise_pictures)
    yield from _flip(algorithm, (0,), noise_pictures)
    turned = ("shift_x_mm", "shift_y_mm", "tilt_x_deg", "tilt_y_deg")
    yield from _flip(algorithm, (0, 1), partial(misaligned_pictures, _EVEN), turned)
    mirrored = ("shift_y_mm", "tilt_y_deg", "rotation_deg")
    yield from _flip(algorithm, (0,), partial(misaligned_pictures, _ODD), mirrored)


@relation("transposed", **_ROUNDED, explain=_unless_first_hit)
def _transpose(algorithm: str, effort: int) -> Iterator[Deviation]:
    """Rows and columns are treated equally: a transposed problem has the transposed result."""
    show, _ = _shown(algorithm)
    for display, rgbd in noise_pictures():
        turned = display.replace(lens_columns=display.lens_rows, lens_rows=display.lens_columns)
        other = _rearrange(rgbd, lambda values: np.swapaxes(values, 0, 1))
        after = np.swapaxes(show(other, turned), 0, 1)
        same = same_colour(show(rgbd, display), after)
        yield _check("transposed", algorithm, rgbd, display, same, display.lensed, bitwise=True)


@relation("turned by 90 degrees", **_ROUNDED, explain=_unless_first_hit)
def _quarter(algorithm: str, effort: int) -> Iterator[Deviation]:
    """A display and a picture turned by a right angle give the turned EIA."""
    show, _ = _shown(algorithm)
    for display, rgbd in noise_pictures():
        turned, other = display.turned(), _rearrange(rgbd, np.rot90)
        after = np.rot90(show(other, turned), -1)
        which = display.lensed & _off_borders(display, rgbd)
        same = same_colour(show(rgbd, display), after)
        yield _check("turned", algorithm, rgbd, display, same, which, bitwise=True)


@relation("turned right round", **_ROUNDED)
def _turned_round(algorithm: str, effort: int) -> Iterator[Deviation]:
    """An array rotated by a whole turn, traced ray by ray, shows what the aligned array shows."""
    show, exact = _shown(algorithm)
    straight = small_display(lens_columns=5)
    rgbd = noise(straight, straight.capture_shape(2), 0.5)
    try:
        after = show(rgbd, straight.replace(rotation_deg=360.0))
    except InimError:
        if exact:
            raise
        yield Deviation("not supported", 0.0)
        return
    same = same_colour(show(rgbd, straight), after)
    yield _check("whole turn", algorithm, rgbd, straight, same, straight.lensed, bitwise=False)


def _scale(
    algorithm: str, factor: float, pictures: _Pictures, *, bitwise: bool
) -> Iterator[Deviation]:
    """Multiply all lengths by a factor, which changes nothing."""
    show, exact = _shown(algorithm)
    for display, rgbd in pictures():
        low, high = display.depth_range_mm
        base = display.replace(depth_min_mm=low, depth_max_mm=high)
        # Depths that both float32 pictures hold exactly: of 12 binary digits.
        depth = _short(rgbd.depth_mm)
        short = RGBD(rgbd.color, depth, rgbd.covered, rgbd.pixel_mm)
        other = RGBD(rgbd.color, depth * np.float32(factor), rgbd.covered, rgbd.pixel_mm * factor)
        try:
            before, after = show(short, base), show(other, scaled(base, factor))
        except InimError:
            if exact:
                raise
            continue
        same = same_colour(before, after)
        yield _check(f"x {factor:g}", algorithm, short, base, same, display.lensed,
                     bitwise=bitwise or (exact and display.is_separable))  # fmt: skip


def _short(depth: np.ndarray) -> np.ndarray:
    mantissa, power = np.frexp(depth)
    short: np.ndarray = np.ldexp(np.rint(mantissa * 4096) / 4096, power).astype(np.float32)
    return short


@relation("scaled by powers of two", **_BITWISE)
def _powers(algorithm: str, effort: int) -> Iterator[Deviation]:
    """All lengths times 2^k give the same bits, also for mounted arrays."""
    for factor in (2.0**10, 2.0**-7):
        yield from _scale(algorithm, factor, noise_pictures, bitwise=True)
    mounted = partial(misaligned_pictures, _EVEN)
    yield from _scale(algorithm, 2.0**10, mounted, bitwise=True)


@relation("scaled by other factors", **_ROUNDED)
def _other_factors(algorithm: str, effort: int) -> Iterator[Deviation]:
    """All lengths times any factor give the same sources, but for rounding."""
    for factor in (1000.0, 0.3)[:effort]:
        yield from _scale(algorithm, factor, noise_pictures, bitwise=False)


@relation("stretched along z", **_ROUNDED, explain=_with_own_columns)
def _stretch(algorithm: str, effort: int) -> Iterator[Deviation]:
    """Scene, gap, focal length and depth range times 4: every ray crosses the same cells."""
    show, _ = _shown(algorithm)
    for display, rgbd in noise_pictures():
        low, high = display.depth_range_mm
        base = display.replace(depth_min_mm=low, depth_max_mm=high)
        long = base.replace(
            focal_length_mm=display.focal_length_mm * 4, gap_mm=display.gap_mm * 4,
            depth_min_mm=low * 4, depth_max_mm=high * 4,
        )  # fmt: skip
        other = RGBD(rgbd.color, rgbd.depth_mm * np.float32(4), rgbd.covered, rgbd.pixel_mm)
        same = same_colour(show(rgbd, base), show(other, long))
        yield _check("x 4", algorithm, rgbd, base, same, display.lensed, bitwise=True)


@relation("moved along z", **_ROUNDED, explain=_unless_first_hit)
def _along_z(algorithm: str, effort: int) -> Iterator[Deviation]:
    """Moving scene and depth range along z does not change rays that are parallel to z."""
    show, _ = _shown(algorithm)
    display = small_display(depth_min_mm=16.0, depth_max_mm=24.0)
    rgbd = noise(display, display.capture_shape(3), 1 / 3)
    depth = np.round(rgbd.depth_mm * 64) / np.float32(64)
    picture = RGBD(rgbd.color, depth, rgbd.covered, rgbd.pixel_mm)
    before = show(picture, display)
    upright = (display.rows.slope == 0)[:, None] & (display.columns.slope == 0)[None, :]
    for step in (8.0, -8.0, 1000.0):
        moved = display.replace(depth_min_mm=16.0 + step, depth_max_mm=24.0 + step)
        other = RGBD(rgbd.color, depth + np.float32(step), rgbd.covered, rgbd.pixel_mm)
        same = same_colour(before, show(other, moved))
        yield _check(f"by {step:g} mm", algorithm, picture, display, same,
                     upright & display.lensed, bitwise=True)  # fmt: skip


# -- other pictures -----------------------------------------------------------------------------


@relation("refined pictures", **_ROUNDED, explain=_with_own_columns)
def _refine(algorithm: str, effort: int) -> Iterator[Deviation]:
    """A picture with each pixel cut into two by two shows the same colours."""
    show, _ = _shown(algorithm)
    for display, rgbd in noise_pictures():
        fine = _rearrange(rgbd, lambda v: np.repeat(np.repeat(v, 2, axis=0), 2, axis=1))
        fine = RGBD(fine.color, fine.depth_mm, fine.covered, rgbd.pixel_mm / 2)
        same = same_colour(show(rgbd, display), show(fine, display))
        yield _check("2 x 2", algorithm, rgbd, display, same, display.lensed, bitwise=True)


@relation("larger pictures", **_ROUNDED)
def _pad(algorithm: str, effort: int) -> Iterator[Deviation]:
    """Adding empty pixels around a picture changes nothing."""
    show, exact = _shown(algorithm)
    for display, rgbd in noise_pictures():
        edge = ((2, 2), (3, 3))
        wide = RGBD(
            np.pad(rgbd.color, (*edge, (0, 0))), np.pad(rgbd.depth_mm, edge),
            np.pad(rgbd.covered, edge), rgbd.pixel_mm,
        )  # fmt: skip
        same = same_colour(show(rgbd, display), show(wide, display))
        yield _check("padded", algorithm, rgbd, display, same, display.lensed, bitwise=exact)


@relation("added objects", **_ROUNDED, explain=_with_own_columns)
def _objects(algorithm: str, effort: int) -> Iterator[Deviation]:
    """A nearer object, or one where nothing was, changes only panel pixels that then show it."""
    for display, rgbd in noise_pictures():
        high = np.float32(display.depth_range_mm[1])
        r, c = (n // 2 for n in rgbd.shape)
        there = np.zeros(rgbd.shape, bool)
        there[r - 2 : r + 2, c - 2 : c + 2] = True
        depth = np.where(there, np.nextafter(high, np.float32(-np.inf)), rgbd.depth_mm)
        yield _with_object(algorithm, display, rgbd, there, depth)
        yield _with_object(algorithm, display, rgbd, ~rgbd.covered, rgbd.depth_mm)


def _with_object(
    algorithm: str, display: Display, rgbd: RGBD, there: np.ndarray, depth: np.ndarray
) -> Deviation:
    show, _ = _shown(algorithm)
    marked = np.where(there[..., None], _MARK, rgbd.color)
    other = RGBD(marked, depth, rgbd.covered | there, rgbd.pixel_mm)
    # The object's pixels have its colour in both pictures.
    painted = RGBD(marked, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
    before, after = show(painted, display), show(other, display)
    shows = (after > 1).any(axis=-1)
    same = same_colour(before, after) | shows
    return _check("object", algorithm, rgbd, display, same, display.lensed, bitwise=True)


@relation("content of uncovered pixels", **_BITWISE)
def _uncovered(algorithm: str, effort: int) -> Iterator[Deviation]:
    """The content of uncovered pixels changes nothing, including NaN and infinities."""
    show, _ = _shown(algorithm)
    for display, rgbd in noise_pictures():
        before = show(rgbd, display)
        for value in (np.nan, np.inf, -np.inf, 1e30)[: 1 + effort]:
            depth = np.where(rgbd.covered, rgbd.depth_mm, np.float32(value))
            after = show(RGBD(rgbd.color, depth, rgbd.covered, rgbd.pixel_mm), display)
            yield _check(f"{value}", algorithm, rgbd, display, same_colour(before, after),
                         display.lensed, bitwise=True)  # fmt: skip


# -- other ways of computing --------------------------------------------------------------------


@relation("one thread or all", **_BITWISE)
def _threads(algorithm: str, effort: int) -> Iterator[Deviation]:
    """One thread and all threads give equal bits."""
    from inim.system.backend.kernels import limited_threads

    show, exact = _shown(algorithm)
    for display, rgbd in (*noise_pictures(), *misaligned_pictures(_ODD)):
        try:
            with_all_threads = show(rgbd, display)
        except InimError:
            if exact:
                raise
            continue
        with limited_threads(1):
            with_one_thread = show(rgbd, display)
        same = same_colour(with_all_threads, with_one_thread)
        yield _check("threads", algorithm, rgbd, display, same, display.lensed, bitwise=True)


@relation("split panels", **_BITWISE)
def _masks(algorithm: str, effort: int) -> Iterator[Deviation]:
    """Parts by dense and sparse masks, put together, are the whole panel; the rest is marked."""
    show, exact = _shown(algorithm)
    for display, rgbd in (*noise_pictures(), *misaligned_pictures(_ODD)):
        try:
            whole = show(rgbd, display)
        except InimError:
            if exact:
                raise
            continue
        tile = np.indices(display.eia_shape).sum(axis=0)
        for count in (3, 16):
            pieces = whole.copy()
            for n in range(min(count, 3 * effort)):
                mask = tile % count == n
                part = algorithm_output(rgbd, display, algorithm, mask=mask)
                pieces[mask] = part[mask]
                outside = part[~mask & display.lensed]
                marked = (outside == MASKED - 5.0).all() or not outside.any()
                yield is_true(f"{count} parts: marks", marked, len(outside))
            same = same_colour(whole, pieces)
            yield _check(f"{count} parts", algorithm, rgbd, display, same, display.lensed,
                         bitwise=True)  # fmt: skip


@relation("streams of pictures", **_BITWISE)
def _stream(algorithm: str, effort: int) -> Iterator[Deviation]:
    """A generator that has seen other pictures gives the bits of a new one, in its own array."""
    for display, rgbd in (*noise_pictures(), *misaligned_pictures(_ODD)):
        picture = input_of(rgbd, display, algorithm)
        other = input_of(noise(display, rgbd.shape, rgbd.pixel_mm, 77, 0.3), display, algorithm)
        if isinstance(picture, LayeredRGBD):  # fewer layers
            other = replace(picture, deeper=picture.deeper[:-1])
        size = {"shape": rgbd.shape, "pixel_mm": rgbd.pixel_mm}
        try:
            used, new = (prepare(display, algorithm, **size) for _ in range(2))
        except InimError:
            continue
        used.generate(other)
        out = np.full((*display.eia_shape, 3), 7, np.float32)
        result = used.generate(picture, out)
        yield is_true("own array", result is out)
        yield is_true("after another", result == new.generate(picture), out.size)
        yield is_true("again", used.generate(picture) == new.generate(picture), out.size)


# -- layers -------------------------------------------------------------------------------------


def _reads_layers(algorithm: str) -> str | None:
    return None if parse_algorithm(algorithm).reads is RGBD else ""


@relation("layers", **_BITWISE, explain=_reads_layers)
def _layers(algorithm: str, effort: int) -> Iterator[Deviation]:
    """Solids may be cut, removed behind all others, or filled up, as their definition says."""
    find = partial(find_sources, algorithm=algorithm)
    for display, rgbd in noise_pictures():
        lensed = display.lensed
        check = partial(_check, algorithm=algorithm, rgbd=rgbd, display=display, bitwise=True)
        plain = find(rgbd, display) == find_sources(rgbd, display, "template")
        yield check("without layers as template", same=plain, which=lensed)
        solid, cells = solids_of(rgbd, display), rgbd.depth_mm.size
        before = find(solid, display)
        middle = (solid.depth_mm + solid.back_mm) / np.float32(2)
        lower = Layer(solid.color, middle, solid.back_mm, solid.covered)
        cut = LayeredRGBD(solid.color, solid.depth_mm, solid.covered, solid.pixel_mm, middle,
                          (lower, *solid.deeper))  # fmt: skip
        after = find(cut, display)
        # The lower half is layer 1; the numbers of the layers behind it increase by one.
        after = np.where(after >= cells, after - cells, after)
        yield check("a solid cut in two", same=before == after, which=lensed)
        fewer = find(replace(solid, deeper=solid.deeper[:-1]), display)
        shows = before >= len(solid.deeper) * cells
        yield check("without the deepest", same=(fewer == before) | shows, which=lensed)
        second, third = solid.deeper
        filled = replace(
            solid, back_mm=np.where(second.covered, second.front_mm, np.float32(-np.inf)),
            deeper=(replace(second, back_mm=third.front_mm), third),
        )  # fmt: skip
        endless = np.full(rgbd.shape, -np.inf, np.float32)
        columns = find(replace(solid, back_mm=endless, deeper=()), display)
        after = find(filled, display)
        equal = np.where(after >= 0, after % cells, after) == columns
        yield check("solids without gaps", same=equal, which=lensed)


@relation(
    "tables or single rays", limit=0, unit="pixels", source="both are exact", covers=_COVERS,
    subjects=("template",),
)  # fmt: skip
def _equal_types(algorithm: str, effort: int) -> Iterator[Deviation]:
    """Float32 tables and float64 rays give equal bits, also with many lenses in strips."""
    wide = small_display(lens_columns=70, lens_rows=1, depth_min_mm=-4.0, depth_max_mm=5.0)
    pictures = [*noise_pictures(), (wide, noise(wide, wide.capture_shape(2), 0.5, 8))]
    for display, rgbd in pictures:
        rays = ray_by_ray(display, rgbd.shape, rgbd.pixel_mm)
        colours = colours_of(rays.sources(rgbd), rgbd)
        equal = same_colour(algorithm_output(rgbd, display, algorithm), colours)
        yield _check("types", algorithm, rgbd, display, equal, display.lensed, bitwise=True)


def lines_of(rays: Rays) -> np.ndarray:
    """Rays as (n, 4) float64: v0, dv, u0, du."""
    return np.stack([rays.v0, rays.dv, rays.u0, rays.du], axis=1)
