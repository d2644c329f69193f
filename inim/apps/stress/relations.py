"""Relations between results that hold for every correct algorithm.

Each is a named check: shift, mirror, scale, stretch, hide, split. They need no oracle, so they
apply to any algorithm. Some follow only from the definition of a first hit: for other algorithms
they are measured only.

If two ways to one result differ in a pixel whose decision depends on rounding, both are correct.
The algorithm itself determines these pixels: they change if lengths and depths are
changed by a ten-millionth (`within_rounding`).
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from msgspec.structs import replace

from inim.apps.stress.document import RelationResult
from inim.apps.stress.pictures import (
    PictureCase,
    Show,
    algorithm_output,
    is_first_hit,
    misaligned_pictures,
    noise,
    noise_pictures,
    small_display,
)
from inim.display import Display
from inim.generators import parse_algorithm
from inim.image.rgbd import RGBD
from inim.system.errors import InimError

# Relative change of lengths to find pixels that depend on rounding: about an ulp of float32.
_NUDGE = 1e-7
# Lens rows of hexagonal arrays with symmetry: even for a half turn, odd for a mirror.
_EVEN, _ODD = 4, 3
# Colour of an added object; all other colours are below 1.
_MARK = np.float32(1024)
_NOT_PROMISED = "follows from the definition of a first hit, which this algorithm's is not"
_BY_NEIGHBOURS = "follows only for columns whose ends do not depend on their neighbours"

_LENGTHS = ("pitch_mm", "focal_length_mm", "gap_mm", "pixel_pitch_mm", "shift_x_mm", "shift_y_mm")
_Pictures = Callable[[], Iterable[PictureCase]]


@dataclass(frozen=True)
class Comparison:
    """Result of a relation on one picture.

    `same` and `which`, (rows, columns) bool, are the panel pixels that satisfy the relation, and
    those to which it applies.
    """

    display: Display
    rgbd: RGBD
    same: np.ndarray
    which: np.ndarray


_Check = Callable[[Show, str], Iterator[Comparison]]
#: Counts the panel pixels (n, 2) that depend on rounding, for a picture, display and algorithm.
Doubt = Callable[[RGBD, Display, str, np.ndarray], int]


@dataclass(frozen=True)
class Relation:
    """A named check: ``check(show, algorithm)`` yields comparisons.

    `bitwise`: rounding excuses no difference. `first_hit`: the relation follows only from the
    definition of a first hit. `own_columns`: it also requires that a pixel's column depends on no
    other pixel. `one_layer`: the pictures have no layers. `misaligned`: the rays of the arrays are
    float64, and ties depend on rounding.
    """

    name: str
    check: _Check
    bitwise: bool = False
    first_hit: bool = False
    own_columns: bool = False
    one_layer: bool = False
    misaligned: bool = False


def run_relations(
    algorithms: Sequence[str],
    *,
    show: Show = algorithm_output,
    relations: Sequence[Relation] | None = None,
) -> list[RelationResult]:
    """Check each relation (default: `RELATIONS`) for the algorithms to which it applies.

    `show` replaces `algorithm_output`.
    """
    rows = []
    for relation in RELATIONS if relations is None else relations:
        for algorithm in algorithms:
            if relation.one_layer and parse_algorithm(algorithm).reads is not RGBD:
                continue
            exact = is_first_hit(algorithm)
            explained = _NOT_PROMISED if relation.first_hit and not exact else ""
            if relation.own_columns and parse_algorithm(algorithm).columns == "surface":
                explained = explained or _BY_NEIGHBOURS
            rows.append(
                check_relation(relation, algorithm, show=show, exact=exact, explained=explained)
            )
    return rows


def check_relation(
    relation: Relation,
    algorithm: str,
    *,
    show: Show = algorithm_output,
    exact: bool = False,
    explained: str = "",
    doubt: Doubt | None = None,
) -> RelationResult:
    """Check one relation of one algorithm.

    `show` returns the algorithm's output; with `exact`, its definition decides ties, so that none
    depends on rounding. `explained` is the reason why the algorithm may violate the relation, which
    is then measured only. `doubt` replaces `within_rounding`.
    """
    compared = broken = uncertain = 0
    result = RelationResult(
        relation=relation.name,
        algorithm=algorithm,
        explained=explained,
        compared=compared,
        broken=broken,
        uncertain=uncertain,
        message="",
        passed=False,
    )
    # True if rounding excuses differences.
    excused = bool(explained) or not (relation.bitwise or (exact and not relation.misaligned))
    try:
        for comparison in relation.check(show, algorithm):
            pixels = np.argwhere(comparison.which & ~comparison.same)
            compared += int(comparison.which.sum())
            broken += len(pixels)
            if not (len(pixels) and excused):
                continue
            if doubt is not None:
                uncertain += doubt(comparison.rgbd, comparison.display, algorithm, pixels)
            else:
                near = within_rounding(comparison.rgbd, comparison.display, algorithm, show)
                uncertain += int(near[tuple(pixels.T)].sum())
    except InimError as error:
        # An algorithm may reject arrays whose rows and columns are not independent.
        return replace(result, message=str(error), passed=relation.misaligned and not exact)
    except Exception as error:
        message = " ".join(f"{type(error).__name__}: {error}".split())[:300]
        return replace(result, message=message)
    return replace(
        result,
        compared=compared,
        broken=broken,
        uncertain=uncertain,
        passed=compared > 0 and (broken <= uncertain or bool(explained)),
    )


def within_rounding(rgbd: RGBD, display: Display, algorithm: str, show: Show) -> np.ndarray:
    """Panel pixels that change if lengths or depths change by rounding, (rows, columns) bool.

    The gap, the depths and the array's position are each moved up and down by about one float32
    ulp.
    """
    low, high = display.depth_range_mm
    still = display.replace(depth_min_mm=low, depth_max_mm=high)
    before = show(rgbd, display, algorithm)
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
            changes |= ~same_colour(before, show(picture, other, algorithm))
    return changes


def _shift_array(display: Display, right_mm: float, up_mm: float) -> Display:
    x, y = display.shift_x_mm + right_mm, display.shift_y_mm + up_mm
    return display.replace(shift_x_mm=x, shift_y_mm=y)


def same_colour(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Mask of equal colours in two arrays, (rows, columns) bool."""
    is_equal: np.ndarray = (a == b).all(axis=-1)
    return is_equal


# -- shifts and symmetries ------------------------------------------------------------------------


def _rearrange(rgbd: RGBD, move: Callable[[np.ndarray], np.ndarray]) -> RGBD:
    """Apply a change of rows and columns to all arrays of a picture."""
    return RGBD(move(rgbd.color), move(rgbd.depth_mm), move(rgbd.covered), rgbd.pixel_mm)


def _shift(show: Show, algorithm: str) -> Iterator[Comparison]:
    """A picture moved by one pitch shows under the next lens."""
    for display, rgbd in noise_pictures():
        if not display.has_integer_ratio:
            continue  # lenses have different numbers of pixels
        cells, pixels = 2, round(display.pixels_per_lens)
        moved = _rearrange(rgbd, partial(np.roll, shift=cells, axis=1))
        before = show(rgbd, display, algorithm)[:, :-pixels]
        after = show(moved, display, algorithm)[:, pixels:]
        which = np.zeros(display.eia_shape, bool)
        same = np.ones(display.eia_shape, bool)
        which[:, :-pixels] = _away_from_rim(display, rgbd, cells)[:, :-pixels]
        same[:, :-pixels] = same_colour(before, after)
        yield Comparison(display, rgbd, same, which)


def _away_from_rim(display: Display, rgbd: RGBD, cells: int) -> np.ndarray:
    """Panel pixels whose rays do not reach the cells that `np.roll` moved to the other side."""
    ends = np.array(display.depth_range_mm)[:, None]
    at = (display.columns.centre_mm + display.columns.slope * ends) / rgbd.pixel_mm
    at += rgbd.shape[1] / 2
    clear = (at >= cells).all(axis=0) & (at < rgbd.shape[1] - cells).all(axis=0)
    is_clear: np.ndarray = display.lensed & clear[None, :]
    return is_clear


def _flip(axes: tuple[int, ...], pictures: _Pictures, negated: Sequence[str] = ()) -> _Check:
    """Flipping the picture and negating misalignments flips the EIA."""

    def check(show: Show, algorithm: str) -> Iterator[Comparison]:
        for display, rgbd in pictures():
            flipped = _rearrange(rgbd, lambda values: np.flip(values, axes))
            turned = display.replace(**{name: -getattr(display, name) for name in negated})
            before = show(rgbd, display, algorithm)
            after = np.flip(show(flipped, turned, algorithm), axes)
            which = display.lensed & _off_borders(display, rgbd)
            yield Comparison(display, rgbd, same_colour(before, after), which)

    return check


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


def _transpose(show: Show, algorithm: str) -> Iterator[Comparison]:
    """Equal treatment of rows and columns: a transposed problem has the transposed result."""
    for display, rgbd in noise_pictures():
        turned = display.replace(lens_columns=display.lens_rows, lens_rows=display.lens_columns)
        other = _rearrange(rgbd, lambda values: np.swapaxes(values, 0, 1))
        before = show(rgbd, display, algorithm)
        after = np.swapaxes(show(other, turned, algorithm), 0, 1)
        yield Comparison(display, rgbd, same_colour(before, after), display.lensed)


def _turned_round(show: Show, algorithm: str) -> Iterator[Comparison]:
    """Equal result of an array rotated by half a turn, traced ray by ray, and the aligned array."""
    straight = small_display(lens_columns=5)
    rgbd = noise(straight, straight.capture_shape(2), 0.5)
    turned = straight.replace(rotation_deg=360.0)
    same = same_colour(show(rgbd, straight, algorithm), show(rgbd, turned, algorithm))
    # Rounding matters for the aligned array only, whose rays pass exactly through corners.
    yield Comparison(straight, rgbd, same, straight.lensed)


# -- other lengths ------------------------------------------------------------------------------


def _scale(factor: float, pictures: _Pictures) -> _Check:
    """Invariance under a common scale of all lengths."""

    def check(show: Show, algorithm: str) -> Iterator[Comparison]:
        for display, rgbd in pictures():
            low, high = display.depth_range_mm
            base = display.replace(depth_min_mm=low, depth_max_mm=high)
            lengths: dict[str, Any] = {name: getattr(base, name) * factor for name in _LENGTHS}
            if base.elemental_pitch_mm is not None:
                lengths["elemental_pitch_mm"] = base.elemental_pitch_mm * factor
            lengths |= {"depth_min_mm": low * factor, "depth_max_mm": high * factor}
            # Depths that both float32 pictures hold exactly: of 12 binary digits.
            depth = _short(rgbd.depth_mm)
            scaled = RGBD(rgbd.color, depth, rgbd.covered, rgbd.pixel_mm)
            pixel = rgbd.pixel_mm * factor
            other = RGBD(rgbd.color, depth * np.float32(factor), rgbd.covered, pixel)
            before = show(scaled, base, algorithm)
            after = show(other, base.replace(**lengths), algorithm)
            yield Comparison(base, scaled, same_colour(before, after), display.lensed)

    return check


def _short(depth: np.ndarray) -> np.ndarray:
    mantissa, power = np.frexp(depth)
    short: np.ndarray = np.ldexp(np.rint(mantissa * 4096) / 4096, power).astype(np.float32)
    return short


def _stretch(show: Show, algorithm: str) -> Iterator[Comparison]:
    """Stretching scene, gap and depth range along z: every ray crosses the same cells."""
    for display, rgbd in noise_pictures():
        low, high = display.depth_range_mm
        base = display.replace(depth_min_mm=low, depth_max_mm=high)
        # f is stretched, too, because the step of some algorithms depends on D and P_I.
        long = base.replace(
            focal_length_mm=display.focal_length_mm * 4,
            gap_mm=display.gap_mm * 4,
            depth_min_mm=low * 4,
            depth_max_mm=high * 4,
        )
        other = RGBD(rgbd.color, rgbd.depth_mm * np.float32(4), rgbd.covered, rgbd.pixel_mm)
        same = same_colour(show(rgbd, base, algorithm), show(other, long, algorithm))
        yield Comparison(base, rgbd, same, display.lensed)


def _along_z(show: Show, algorithm: str) -> Iterator[Comparison]:
    """Moving scene and depth range along z does not change rays that are parallel to z."""
    display = small_display(depth_min_mm=16.0, depth_max_mm=24.0)
    rgbd = noise(display, display.capture_shape(3), 1 / 3)
    depth = np.round(rgbd.depth_mm * 64) / np.float32(64)
    picture = RGBD(rgbd.color, depth, rgbd.covered, rgbd.pixel_mm)
    before = show(picture, display, algorithm)
    upright = (display.rows.slope == 0)[:, None] & (display.columns.slope == 0)[None, :]
    for step in (8.0, -8.0, 1000.0):
        moved = display.replace(depth_min_mm=16.0 + step, depth_max_mm=24.0 + step)
        other = RGBD(rgbd.color, depth + np.float32(step), rgbd.covered, rgbd.pixel_mm)
        same = same_colour(before, show(other, moved, algorithm))
        yield Comparison(display, picture, same, upright & display.lensed)


# -- other pictures -----------------------------------------------------------------------------


def _nearer(show: Show, algorithm: str) -> Iterator[Comparison]:
    """A nearer object changes only panel pixels that now show it."""
    for display, rgbd in noise_pictures():
        high = np.float32(display.depth_range_mm[1])
        r, c = (n // 2 for n in rgbd.shape)
        there = np.zeros(rgbd.shape, bool)
        there[r - 2 : r + 2, c - 2 : c + 2] = True
        depth = np.where(there, np.nextafter(high, np.float32(-np.inf)), rgbd.depth_mm)
        yield _with_object(show, algorithm, display, rgbd, there, depth)


def _appears(show: Show, algorithm: str) -> Iterator[Comparison]:
    """Restricted effect of a new object: only panel pixels that show it change."""
    for display, rgbd in noise_pictures():
        yield _with_object(show, algorithm, display, rgbd, ~rgbd.covered, rgbd.depth_mm)


def _with_object(
    show: Show, algorithm: str, display: Display, rgbd: RGBD, there: np.ndarray, depth: np.ndarray
) -> Comparison:
    marked = np.where(there[..., None], _MARK, rgbd.color)
    other = RGBD(marked, depth, rgbd.covered | there, rgbd.pixel_mm)
    # The object's pixels have its colour in both pictures.
    painted = RGBD(marked, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
    before, after = show(painted, display, algorithm), show(other, display, algorithm)
    shows = (after > 1).any(axis=-1)
    return Comparison(display, rgbd, same_colour(before, after) | shows, display.lensed)


def _uncovered(show: Show, algorithm: str) -> Iterator[Comparison]:
    """Independence of the content of uncovered pixels, including NaN and infinities."""
    for display, rgbd in noise_pictures():
        before = show(rgbd, display, algorithm)
        for value in (np.nan, np.inf, -np.inf, 1e30):
            depth = np.where(rgbd.covered, rgbd.depth_mm, np.float32(value))
            after = show(RGBD(rgbd.color, depth, rgbd.covered, rgbd.pixel_mm), display, algorithm)
            yield Comparison(display, rgbd, same_colour(before, after), display.lensed)


# -- other ways of computing --------------------------------------------------------------------


def _threads(pictures: _Pictures) -> _Check:
    """Equal bits with one thread and with all."""

    def check(show: Show, algorithm: str) -> Iterator[Comparison]:
        from inim.system.backend.kernels import limited_threads

        for display, rgbd in pictures():
            with_all_threads = show(rgbd, display, algorithm)
            with limited_threads(1):
                with_one_thread = show(rgbd, display, algorithm)
            yield Comparison(
                display, rgbd, same_colour(with_all_threads, with_one_thread), display.lensed
            )

    return check


def _tiles(show: Show, algorithm: str) -> Iterator[Comparison]:
    """Equality of a panel generated in three masked parts with a whole one."""
    for display, rgbd in noise_pictures():
        whole = show(rgbd, display, algorithm)
        pieces = np.full_like(whole, np.nan)
        tile = np.indices(display.eia_shape).sum(axis=0) // 3 % 3
        for n in range(3):
            part = algorithm_output(rgbd, display, algorithm, mask=tile == n)
            pieces[tile == n] = part[tile == n]
        yield Comparison(display, rgbd, same_colour(whole, pieces), display.lensed)


_even, _odd = (partial(misaligned_pictures, rows) for rows in (_EVEN, _ODD))
_TURNED = ("shift_x_mm", "shift_y_mm", "tilt_x_deg", "tilt_y_deg")
_MIRRORED = ("shift_y_mm", "tilt_y_deg", "rotation_deg")

RELATIONS = [
    Relation("shift by one pitch", _shift),
    Relation("mirror left and right", _flip((1,), noise_pictures)),
    Relation("mirror top and bottom", _flip((0,), noise_pictures)),
    Relation("transpose", _transpose, first_hit=True),
    Relation("all lengths x 2^10", _scale(2.0**10, noise_pictures), bitwise=True),
    Relation("all lengths x 2^-7", _scale(2.0**-7, noise_pictures), bitwise=True),
    Relation("all lengths x 1000", _scale(1000.0, noise_pictures)),
    Relation("stretch along z x 4", _stretch, True, True, own_columns=True),
    Relation("move along z", _along_z, first_hit=True),
    Relation("a nearer object changes only its shadow", _nearer, False, True, True, True),
    Relation("an object where nothing was", _appears, False, True, True, True),
    Relation("uncovered pixels do not matter", _uncovered, bitwise=True),
    Relation("one thread or all", _threads(noise_pictures), bitwise=True),
    Relation("tiles or whole", _tiles, bitwise=True),
    Relation("turned right round, as straight", _turned_round, misaligned=True),
    Relation("mounted array upside down", _flip((0, 1), _even, _TURNED), misaligned=True),
    Relation("mounted array in a mirror", _flip((0,), _odd, _MIRRORED), misaligned=True),
    Relation("mounted array, all lengths x 2^10", _scale(2.0**10, _even), True, misaligned=True),
    Relation("mounted array, one thread or all", _threads(_odd), True, misaligned=True),
]
