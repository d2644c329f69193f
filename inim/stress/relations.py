"""Relations between results that hold by themselves, whatever the right answer is.

Each is a named check: shift, mirror, scale, stretch, hide, split. A relation that an algorithm's
definition does not promise is measured all the same, and said to be explained.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from inim.display import Display
from inim.errors import InimError
from inim.generators import HOLE, find_sources
from inim.rgbd import RGBD
from inim.stress.case import Size, display_of, noise, over, with_depth
from inim.stress.free_rays import rays_over
from inim.stress.oracle import answer
from inim.stress.solids import solids_of

__all__ = [
    "ALGORITHMS",
    "RELATIONS",
    "Find",
    "Outcome",
    "Relation",
    "colours_shown",
    "noise_pictures",
    "outcome_of",
    "run_relations",
    "same_colour",
    "sources_shown",
]

Find = Callable[[RGBD, Display, str], np.ndarray]

ALGORITHMS = ("template", "gu2020", "wang2024", "wang2024:matching=ray", "li2012")
_FIRST_HIT = ("template", "gu2020")
_RIVALS = ALGORITHMS[1:]
_AND_LAYERS = (*ALGORITHMS, "layered")


@dataclass(frozen=True)
class Outcome:
    """What a relation found on one picture.

    Attributes
    ----------
    compared, broken : int
        Panel pixels, and those that break it.
    uncertain : int
        Broken ones whose decision is within float64's rounding: they may.
    """

    compared: int
    broken: int
    uncertain: int


@dataclass(frozen=True)
class Relation:
    """A named check.

    Attributes
    ----------
    name : str
    check : callable
        ``check(find, algorithm, size)`` yields outcomes.
    algorithms : tuple of str
        Which promise it.
    explained : mapping of str to str
        Which do not, and why.
    bitwise : bool
        Whether not even a pixel within rounding may differ.
    free : bool
        Whether it is one of arrays whose rays are float64, where ties are left to rounding.
    """

    name: str
    check: Callable[[Find, str, Size], Iterator[Outcome]]
    algorithms: tuple[str, ...] = ALGORITHMS
    explained: tuple[tuple[str, str], ...] = ()
    bitwise: bool = False
    free: bool = False


def sources_shown(rgbd: RGBD, display: Display, algorithm: str, **options: Any) -> np.ndarray:
    """What a generator shows; `layered` of the picture's solids, at pixel centres."""
    if algorithm != "layered":
        return find_sources(rgbd, display, algorithm, **options)
    return find_sources(solids_of(rgbd, display), display, algorithm, samples=1, **options)


def run_relations(
    size: Size, find: Find = sources_shown, relations: Sequence[Relation] | None = None
) -> list[dict[str, Any]]:
    """A row for each relation and algorithm.

    Parameters
    ----------
    size : Size
    find : callable
        What to test instead of `sources_shown`.
    relations : sequence of Relation, optional
        `RELATIONS` unless given.
    """
    rows = []
    for relation in RELATIONS if relations is None else relations:
        why = dict(relation.explained)
        for algorithm in (*relation.algorithms, *why):
            rows.append(_row(relation, algorithm, why.get(algorithm, ""), find, size))
    return rows


def _row(relation: Relation, algorithm: str, why: str, find: Find, size: Size) -> dict[str, Any]:
    row = {"relation": relation.name, "algorithm": algorithm, "explained": why}
    try:
        outcomes = list(relation.check(find, algorithm, size))
    except InimError as error:
        return (
            row
            | {"compared": 0, "broken": 0, "uncertain": 0, "message": str(error)}
            | {"passed": False}
        )
    compared, broken, uncertain = (
        sum(getattr(o, name) for o in outcomes) for name in ("compared", "broken", "uncertain")
    )
    exact = algorithm in ("template", "layered") and not relation.free
    allowed = 0 if relation.bitwise or exact else uncertain
    return row | {
        "compared": compared,
        "broken": broken,
        "uncertain": uncertain,
        "message": "",
        "passed": compared > 0 and (broken <= allowed or bool(why)),
    }


def outcome_of(
    same: np.ndarray, which: np.ndarray, algorithm: str, rgbd: RGBD, display: Display
) -> Outcome:
    """Count what is broken of the panel pixels `which`, (rows, columns) bool both."""
    broken = np.argwhere(which & ~same)
    doubt = 0
    if len(broken) and algorithm in _AND_LAYERS:
        rays = rays_over(display, rgbd, broken)
        picture = solids_of(rgbd, display) if algorithm == "layered" else rgbd
        doubt = int(answer(algorithm, rays, picture, display, np.float64).uncertain.sum())
    return Outcome(int(which.sum()), len(broken), doubt)


# -- pictures -----------------------------------------------------------------------------------

#: Real and virtual mode, an even and an odd number of pixels, binary and decimal lengths.
_DISPLAYS: tuple[dict[str, object], ...] = (
    {},
    {"gap_mm": 4.0, "pixel_pitch_mm": 0.125},
    {"focal_length_mm": 3.3, "gap_mm": 3.0, "pixel_pitch_mm": 0.19},
)


def noise_pictures(size: Size) -> Iterator[tuple[Display, RGBD]]:
    """Noise over small displays of each kind."""
    for seed, changes in enumerate(_DISPLAYS):
        display = display_of(size, lens_columns=size.lenses[0] + 2, **changes)
        yield display, noise(display, *over(display), seed=seed)


def colours_shown(sources: np.ndarray, rgbd: RGBD) -> np.ndarray:
    """Colours of sources: what two pictures with their pixels at other places share.

    Each layer has its own, and so have holes and pixels without a lens.
    """
    flat = rgbd.color.reshape(-1, 3)
    layer, cell = np.divmod(np.maximum(sources, 0), len(flat))
    found: np.ndarray = np.where(
        (sources >= 0)[..., None], flat[cell] + 2.0 * layer[..., None], sources[..., None] - 5.0
    )
    return found


def same_colour(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Where two pictures of colours agree, (rows, columns) bool."""
    found: np.ndarray = (a == b).all(axis=-1)
    return found


# -- relations ----------------------------------------------------------------------------------


def _shift(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """A picture moved by one pitch shows under the next lens."""
    for display, rgbd in noise_pictures(size):
        if not display.has_integer_ratio:
            continue  # lenses differ: no two show alike
        cells, pixels = 2, round(display.pixels_per_lens)
        moved = RGBD(
            np.roll(rgbd.color, cells, axis=1),
            np.roll(rgbd.depth_mm, cells, axis=1),
            np.roll(rgbd.covered, cells, axis=1),
            rgbd.pixel_mm,
        )
        before = colours_shown(find(rgbd, display, algorithm), rgbd)[:, :-pixels]
        after = colours_shown(find(moved, display, algorithm), moved)[:, pixels:]
        which = _away_from_rim(display, rgbd, cells)[:, :-pixels]
        full = np.zeros(display.eia_shape, bool)
        same = np.ones(display.eia_shape, bool)
        full[:, :-pixels], same[:, :-pixels] = which, same_colour(before, after)
        yield outcome_of(same, full, algorithm, rgbd, display)


def _away_from_rim(display: Display, rgbd: RGBD, cells: int) -> np.ndarray:
    """Panel pixels whose rays stay clear of the cells that wrapped around the picture's side."""
    ends = np.array(display.depth_range_mm)[:, None]
    at = (display.columns.centre_mm + display.columns.slope * ends) / rgbd.pixel_mm
    at += rgbd.shape[1] / 2
    clear = (at >= cells).all(axis=0) & (at < rgbd.shape[1] - cells).all(axis=0)
    found: np.ndarray = display.lensed & clear[None, :]
    return found


def _mirror(axis: int) -> Callable[[Find, str, Size], Iterator[Outcome]]:
    """A mirrored picture gives the mirrored EIA, but for rays along borders, which take a side."""

    def check(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
        for display, rgbd in noise_pictures(size):
            flipped = RGBD(
                np.flip(rgbd.color, axis),
                np.flip(rgbd.depth_mm, axis),
                np.flip(rgbd.covered, axis),
                rgbd.pixel_mm,
            )
            before = colours_shown(find(rgbd, display, algorithm), rgbd)
            after = np.flip(colours_shown(find(flipped, display, algorithm), flipped), axis)
            which = display.lensed & _off_borders(display, rgbd)
            yield outcome_of(same_colour(before, after), which, algorithm, rgbd, display)

    return check


def _off_borders(display: Display, rgbd: RGBD) -> np.ndarray:
    """Panel pixels whose ray does not run along a border between picture pixels.

    Nor lies on one between lenses: both belong to one side by rule.
    """
    clear = []
    for axis, cells in ((display.rows, rgbd.shape[0]), (display.columns, rgbd.shape[1])):
        start = axis.centre_mm / rgbd.pixel_mm + cells / 2
        along = (axis.slope == 0) & (np.abs(start - np.rint(start)) < 1e-9)
        half = abs(display.elemental_image_pitch_mm / 2)
        on_edge = np.abs(np.abs(axis.position_mm - axis.centre_mm) - half) < 1e-9
        clear.append(~along & ~on_edge)
    found: np.ndarray = clear[0][:, None] & clear[1][None, :]
    return found


def _transpose(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """Rows and columns are treated alike."""
    for display, rgbd in noise_pictures(size):
        turned = display.replace(lens_columns=display.lens_rows, lens_rows=display.lens_columns)
        other = RGBD(np.swapaxes(rgbd.color, 0, 1), rgbd.depth_mm.T, rgbd.covered.T, rgbd.pixel_mm)
        before = colours_shown(find(rgbd, display, algorithm), rgbd)
        after = np.swapaxes(colours_shown(find(other, turned, algorithm), other), 0, 1)
        yield outcome_of(same_colour(before, after), display.lensed, algorithm, rgbd, display)


def _scale(factor: float) -> Callable[[Find, str, Size], Iterator[Outcome]]:
    """All lengths times a factor: nothing changes."""
    names = ("pitch_mm", "focal_length_mm", "gap_mm", "pixel_pitch_mm")

    def check(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
        for display, rgbd in noise_pictures(size):
            low, high = display.depth_range_mm
            lengths = {name: getattr(display, name) * factor for name in names}
            ends = {"depth_min_mm": low * factor, "depth_max_mm": high * factor}
            base = display.replace(depth_min_mm=low, depth_max_mm=high)
            scaled = display.replace(**lengths, **ends)
            # Depths that both float32 pictures hold exactly: of 12 binary digits.
            depth = _short(rgbd.depth_mm)
            one = RGBD(rgbd.color, depth, rgbd.covered, rgbd.pixel_mm)
            other = RGBD(
                rgbd.color, depth * np.float32(factor), rgbd.covered, rgbd.pixel_mm * factor
            )
            before, after = find(one, base, algorithm), find(other, scaled, algorithm)
            yield outcome_of(before == after, display.lensed, algorithm, one, base)

    return check


def _short(depth: np.ndarray) -> np.ndarray:
    mantissa, power = np.frexp(depth)
    short: np.ndarray = np.ldexp(np.rint(mantissa * 4096) / 4096, power).astype(np.float32)
    return short


def _stretch(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """Scene, gap and depth range stretched along z alone: every ray meets the same cells."""
    for display, rgbd in noise_pictures(size):
        low, high = display.depth_range_mm
        base = display.replace(depth_min_mm=low, depth_max_mm=high)
        # f follows, so that D and P_I, which some of them step by, stretch too.
        long = base.replace(
            focal_length_mm=display.focal_length_mm * 4,
            gap_mm=display.gap_mm * 4,
            depth_min_mm=low * 4,
            depth_max_mm=high * 4,
        )
        other = RGBD(rgbd.color, rgbd.depth_mm * np.float32(4), rgbd.covered, rgbd.pixel_mm)
        before, after = find(rgbd, base, algorithm), find(other, long, algorithm)
        yield outcome_of(before == after, display.lensed, algorithm, rgbd, base)


def _along_z(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """Scene and depth range moved along z: rays under lens centres, which run along it, agree."""
    display = display_of(size, pixel_pitch_mm=0.2, depth_min_mm=16.0, depth_max_mm=24.0)
    rgbd = noise(display, display.capture_shape(3), 1 / 3)
    depth = np.round(rgbd.depth_mm * 64) / np.float32(64)
    for step in (8.0, -8.0, 1000.0):
        moved = display.replace(depth_min_mm=16.0 + step, depth_max_mm=24.0 + step)
        one = RGBD(rgbd.color, depth, rgbd.covered, rgbd.pixel_mm)
        other = RGBD(rgbd.color, depth + np.float32(step), rgbd.covered, rgbd.pixel_mm)
        before, after = find(one, display, algorithm), find(other, moved, algorithm)
        upright = (display.rows.slope == 0)[:, None] & (display.columns.slope == 0)[None, :]
        yield outcome_of(before == after, upright & display.lensed, algorithm, one, display)


def _shadow(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """A nearer object changes only panel pixels that now show it."""
    for display, rgbd in noise_pictures(size):
        high = np.float32(display.depth_range_mm[1])
        r, c = (n // 2 for n in rgbd.shape)
        depth = np.array(rgbd.depth_mm)
        covered = np.array(rgbd.covered)
        there = np.zeros(rgbd.shape, bool)
        there[r - 2 : r + 2, c - 2 : c + 2] = True
        depth[there] = np.nextafter(high, np.float32(-np.inf))
        covered |= there
        other = RGBD(rgbd.color, depth, covered, rgbd.pixel_mm)
        before, after = find(rgbd, display, algorithm), find(other, display, algorithm)
        shows = (after >= 0) & there.ravel()[np.maximum(after, 0)]
        yield outcome_of((before == after) | shows, display.lensed, algorithm, rgbd, display)


def _appears(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """An object where nothing was changes only panel pixels that now show it."""
    for display, rgbd in noise_pictures(size):
        there = ~rgbd.covered
        full = with_depth(rgbd.depth_mm, rgbd.pixel_mm)
        before = find(rgbd, display, algorithm)
        after = find(
            RGBD(rgbd.color, full.depth_mm, full.covered, full.pixel_mm), display, algorithm
        )
        shows = (after >= 0) & there.ravel()[np.maximum(after, 0)]
        yield outcome_of((before == after) | shows, display.lensed, algorithm, rgbd, display)


def _garbage(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """What uncovered pixels hold, NaN and infinities too, changes nothing."""
    for display, rgbd in noise_pictures(size):
        before = find(rgbd, display, algorithm)
        for value in (np.nan, np.inf, -np.inf, 1e30):
            depth = np.where(rgbd.covered, rgbd.depth_mm, np.float32(value))
            after = find(RGBD(rgbd.color, depth, rgbd.covered, rgbd.pixel_mm), display, algorithm)
            yield outcome_of(before == after, display.lensed, algorithm, rgbd, display)


def _threads(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """One thread or all: the same bits."""
    import numba

    before = numba.get_num_threads()
    for display, rgbd in noise_pictures(size):
        many = find(rgbd, display, algorithm)
        numba.set_num_threads(1)
        try:
            one = find(rgbd, display, algorithm)
        finally:
            numba.set_num_threads(before)
        yield outcome_of(many == one, display.lensed, algorithm, rgbd, display)


def _tiles(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """Asked for in pieces, the panel is the same as whole."""
    for display, rgbd in noise_pictures(size):
        whole = find(rgbd, display, algorithm)
        pieces = np.full_like(whole, HOLE)
        tile = np.indices(display.eia_shape).sum(axis=0) // 3 % 3
        for n in range(3):
            part = sources_shown(rgbd, display, algorithm, mask=tile == n)
            pieces[tile == n] = part[tile == n]
        yield outcome_of(whole == pieces, display.lensed, algorithm, rgbd, display)


def _interpreted(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """Compiled or as plain Python: the same bits."""
    for display, rgbd in noise_pictures(size):
        compiled = find(rgbd, display, algorithm)
        plain = find(rgbd, display, f"{algorithm}:implementation=python")
        yield outcome_of(compiled == plain, display.lensed, algorithm, rgbd, display)


def _types(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """The exact path: tables of float32 and rays in float64, the same bits."""
    from inim.generators.template import ray_by_ray

    for display, rgbd in noise_pictures(size):
        tables = find(rgbd, display, algorithm)
        rays = ray_by_ray(display, rgbd.shape, rgbd.pixel_mm).sources(rgbd)
        yield outcome_of(tables == rays, display.lensed, algorithm, rgbd, display)


def _backends(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """Compiled by numba or by Dr.Jit for LLVM: the same bits."""
    for display, rgbd in noise_pictures(size):
        ours, theirs = find(rgbd, display, algorithm), find(rgbd, display, "template_jit")
        yield outcome_of(ours == theirs, display.lensed, algorithm, rgbd, display)


_NO_OCCLUSION = "the best match wins, wherever on the ray: occlusion is no part of the method"
_A_POINT = "a picture pixel is a point: raised, it lands elsewhere and uncovers what was behind"
_STEPS = "its step P_I is a length across: along a stretched z it samples more finely"
_SIZE = "a picture pixel is a point: farther away, more of them land on one panel pixel"

RELATIONS = [
    Relation("shift by one pitch", _shift, _AND_LAYERS),
    Relation("mirror left and right", _mirror(1), _AND_LAYERS),
    Relation("mirror top and bottom", _mirror(0), _AND_LAYERS),
    Relation(
        "transpose", _transpose,
        ("template", "gu2020", "wang2024:matching=ray", "li2012", "layered"),
        (("wang2024", "z depends on the rows alone: a transposed picture is another problem"),),
    ),
    Relation("all lengths x 2^10", _scale(1024.0), _AND_LAYERS, bitwise=True),
    Relation("all lengths x 2^-7", _scale(2.0**-7), _AND_LAYERS, bitwise=True),
    Relation("all lengths x 1000", _scale(1000.0), _AND_LAYERS),
    Relation(
        "stretch along z x 4", _stretch, tuple(a for a in _AND_LAYERS if a != "gu2020"),
        (("gu2020", _STEPS),), bitwise=True,
    ),
    Relation("move along z", _along_z, (*ALGORITHMS[:-1], "layered"), (("li2012", _SIZE),)),
    Relation(
        "a nearer object changes only its shadow", _shadow, _FIRST_HIT,
        (
            ("wang2024", _NO_OCCLUSION),
            ("wang2024:matching=ray", _NO_OCCLUSION),
            ("li2012", _A_POINT),
        ),
    ),
    Relation("an object where nothing was", _appears),
    Relation("uncovered pixels do not matter", _garbage, _AND_LAYERS, bitwise=True),
    Relation("one thread or all", _threads, _AND_LAYERS, bitwise=True),
    Relation("tiles or whole", _tiles, _AND_LAYERS, bitwise=True),
    Relation("compiled or plain Python", _interpreted, _RIVALS, bitwise=True),
    Relation("float32 tables or float64 rays", _types, ("template",), bitwise=True),
    Relation("numba or Dr.Jit on LLVM", _backends, ("template",), bitwise=True),
]  # fmt: skip
