"""Relations of arrays that are hexagonal, turned or tilted: what symmetry promises them."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from inim.display import Display
from inim.rgbd import RGBD
from inim.stress.case import Size, display_of, noise
from inim.stress.free_cases import MOUNTINGS
from inim.stress.relations import (
    Find,
    Outcome,
    Relation,
    colours_shown,
    outcome_of,
    same_colour,
)

__all__ = ["FREE_RELATIONS"]

_ALGORITHMS = ("template", "gu2020", "layered")
# Rows of hexagonal arrays: an even number is the same upside down, an odd one in a mirror.
_EVEN, _ODD = 4, 3


def _pictures(size: Size, rows: int, pixel_mm: float = 0.5) -> Iterator[tuple[Display, RGBD]]:
    for seed, changes in enumerate(MOUNTINGS.values()):
        display = display_of(size, lens_rows=rows, **changes)
        shape = display.capture_shape(2)
        yield display, noise(display, shape, pixel_mm, seed=seed)


def _as_separable(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """An array turned right round, its rays one by one, shows what the straight one does."""
    straight = display_of(size, lens_columns=size.lenses[0] + 2)
    rgbd = noise(straight, straight.capture_shape(2), 0.5)
    before = find(rgbd, straight, algorithm)
    round_ = straight.replace(rotation_deg=360.0)
    after = find(rgbd, round_, algorithm)
    yield outcome_of(before == after, straight.lensed, algorithm, rgbd, round_)


def _upside_down(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """Picture, array and panel turned by half a turn: so is what is shown."""
    for display, rgbd in _pictures(size, _EVEN):
        over = {name: -getattr(display, name) for name in _SIGNED}
        turned = display.replace(**over)
        other = RGBD(
            np.flip(rgbd.color, (0, 1)), np.flip(rgbd.depth_mm), np.flip(rgbd.covered),
            rgbd.pixel_mm,
        )  # fmt: skip
        before = colours_shown(find(rgbd, display, algorithm), rgbd)
        after = np.flip(colours_shown(find(other, turned, algorithm), other), (0, 1))
        yield outcome_of(same_colour(before, after), display.lensed, algorithm, rgbd, display)


_SIGNED = ("shift_x_mm", "shift_y_mm", "tilt_x_deg", "tilt_y_deg")


def _mirror(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """All mirrored top and bottom, turns and tilts with it."""
    for display, rgbd in _pictures(size, _ODD):
        over = {name: -getattr(display, name) for name in ("shift_y_mm", "tilt_y_deg")}
        other_array = display.replace(rotation_deg=-display.rotation_deg, **over)
        other = RGBD(
            np.flip(rgbd.color, 0), np.flip(rgbd.depth_mm, 0), np.flip(rgbd.covered, 0),
            rgbd.pixel_mm,
        )  # fmt: skip
        before = colours_shown(find(rgbd, display, algorithm), rgbd)
        after = np.flip(colours_shown(find(other, other_array, algorithm), other), 0)
        yield outcome_of(same_colour(before, after), display.lensed, algorithm, rgbd, display)


def _scale(factor: float) -> Callable[[Find, str, Size], Iterator[Outcome]]:
    """All lengths times a factor: nothing changes."""
    names = ("pitch_mm", "focal_length_mm", "gap_mm", "pixel_pitch_mm", "shift_x_mm", "shift_y_mm")

    def check(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
        for display, rgbd in _pictures(size, _EVEN):
            low, high = display.depth_range_mm
            base = display.replace(depth_min_mm=low, depth_max_mm=high)
            lengths = {name: getattr(base, name) * factor for name in names}
            if base.elemental_pitch_mm is not None:
                lengths["elemental_pitch_mm"] = base.elemental_pitch_mm * factor
            ends = {"depth_min_mm": low * factor, "depth_max_mm": high * factor}
            other = RGBD(
                rgbd.color, rgbd.depth_mm * np.float32(factor), rgbd.covered, rgbd.pixel_mm * factor
            )
            before = find(rgbd, base, algorithm)
            after = find(other, base.replace(**lengths, **ends), algorithm)
            yield outcome_of(before == after, display.lensed, algorithm, rgbd, base)

    return check


def _threads(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """One thread or all, and asked for in pieces: the same bits."""
    import numba

    before = numba.get_num_threads()
    for display, rgbd in _pictures(size, _ODD):
        many = find(rgbd, display, algorithm)
        numba.set_num_threads(1)
        try:
            one = find(rgbd, display, algorithm)
        finally:
            numba.set_num_threads(before)
        yield outcome_of(many == one, display.lensed, algorithm, rgbd, display)


FREE_RELATIONS = [
    Relation("turned right round, as straight", _as_separable, _ALGORITHMS, free=True),
    Relation("free array upside down", _upside_down, _ALGORITHMS, free=True),
    Relation("free array in a mirror", _mirror, _ALGORITHMS, free=True),
    Relation("free array, all lengths x 2^10", _scale(1024.0), _ALGORITHMS, bitwise=True),
    Relation("free array, one thread or all", _threads, _ALGORITHMS, bitwise=True),
]
