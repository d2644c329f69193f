"""Relations of `layered` alone: what cutting, adding and leaving out solids may change."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from inim.generators import find_sources
from inim.rgbd import Layer, LayeredRGBD
from inim.stress.case import Size
from inim.stress.relations import (
    Find,
    Outcome,
    Relation,
    noise_pictures,
    outcome_of,
)
from inim.stress.solids import solids_of

__all__ = ["LAYER_RELATIONS"]


def _shown(find: Find, rgbd: LayeredRGBD, display: object) -> np.ndarray:
    return find(rgbd, display, "layered:samples=1")  # type: ignore[arg-type]


def _plain(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """A picture without layers shows what `template` shows."""
    for display, rgbd in noise_pictures(size):
        found = find(rgbd, display, "layered:samples=1")
        alike = found == find_sources(rgbd, display, "template")
        yield outcome_of(alike, display.lensed, algorithm, rgbd, display)


def _cut(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """A solid cut across into two that touch is still that solid."""
    for display, rgbd in noise_pictures(size):
        solid = solids_of(rgbd, display)
        middle = (solid.depth_mm + solid.back_mm) / np.float32(2)
        lower = Layer(solid.color, middle, solid.back_mm, solid.covered)
        cut = LayeredRGBD(
            solid.color,
            solid.depth_mm,
            solid.covered,
            solid.pixel_mm,
            middle,
            (lower, *solid.deeper),
        )
        cells = rgbd.depth_mm.size
        before, after = _shown(find, solid, display), _shown(find, cut, display)
        # The lower half is layer 1, and those behind it count on.
        after = np.where(after >= cells, after - cells, after)
        yield outcome_of(before == after, display.lensed, algorithm, rgbd, display)


def _behind(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """The deepest solid changes only panel pixels that show it."""
    for display, rgbd in noise_pictures(size):
        solid = solids_of(rgbd, display)
        fewer = replace(solid, deeper=solid.deeper[:-1])
        before, after = _shown(find, fewer, display), _shown(find, solid, display)
        shows = after >= len(solid.deeper) * rgbd.depth_mm.size
        yield outcome_of((before == after) | shows, display.lensed, algorithm, rgbd, display)


def _endless(find: Find, algorithm: str, size: Size) -> Iterator[Outcome]:
    """Where every solid goes back to the next one's front, only the colours are layers'."""
    for display, rgbd in noise_pictures(size):
        solid = solids_of(rgbd, display)
        one, two = solid.deeper
        filled = replace(
            solid,
            back_mm=np.where(one.covered, one.front_mm, np.float32(-np.inf)),
            deeper=(replace(one, back_mm=two.front_mm), two),
        )
        columns = replace(solid, back_mm=np.full(rgbd.shape, -np.inf, np.float32), deeper=())
        before, after = _shown(find, columns, display), _shown(find, filled, display)
        cells = rgbd.depth_mm.size
        alike = np.where(after >= 0, after % cells, after) == before
        yield outcome_of(alike, display.lensed, algorithm, rgbd, display)


_OF = ("layered",)
LAYER_RELATIONS = [
    Relation("without layers as template", _plain, _OF, bitwise=True),
    Relation("a solid cut in two", _cut, _OF, bitwise=True),
    Relation("the deepest solid changes what shows it", _behind, _OF, bitwise=True),
    Relation("solids without gaps are columns", _endless, _OF, bitwise=True),
]
