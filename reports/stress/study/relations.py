"""Relations of layers, and of the number types of `template`.

`inim stress` checks the relations that hold for every algorithm.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from inim.apps.stress.document import RelationResult
from inim.apps.stress.pictures import (
    Show,
    algorithm_output,
    colours_of,
    noise_pictures,
    solids_of,
)
from inim.apps.stress.relations import (
    Comparison,
    Relation,
    check_relation,
    same_colour,
)
from inim.generators import find_sources
from inim.generators.template import ray_by_ray
from inim.image.rgbd import Layer, LayeredRGBD

_LAYERED = "layered:samples=1"


def run_relations(find: Show = find_sources, show: Show = algorithm_output) -> list[RelationResult]:
    """Check the relations of layers with the sources of `find`, and that of types with `show`."""
    pairs = [(relation, _LAYERED, find) for relation in LAYER_RELATIONS]
    return [
        check_relation(relation, algorithm, show=output, exact=True, doubt=lambda *_: 0)
        for relation, algorithm, output in (*pairs, (_TYPES, "template", show))
    ]


# -- layers -------------------------------------------------------------------------------------


def _plain(find: Show, algorithm: str) -> Iterator[Comparison]:
    """A picture without layers gives the sources of `template`."""
    for display, rgbd in noise_pictures():
        equal = find(rgbd, display, algorithm) == find_sources(rgbd, display, "template")
        yield Comparison(display, rgbd, equal, display.lensed)


def _cut(find: Show, algorithm: str) -> Iterator[Comparison]:
    """Cutting a solid into two adjacent solids does not change its sources."""
    for display, rgbd in noise_pictures():
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
        before, after = find(solid, display, algorithm), find(cut, display, algorithm)
        # The lower half is layer 1; the numbers of the layers behind it increase by one.
        after = np.where(after >= cells, after - cells, after)
        yield Comparison(display, rgbd, before == after, display.lensed)


def _behind(find: Show, algorithm: str) -> Iterator[Comparison]:
    """Adding the deepest solid changes only panel pixels that show it."""
    for display, rgbd in noise_pictures():
        solid = solids_of(rgbd, display)
        fewer = replace(solid, deeper=solid.deeper[:-1])
        before, after = find(fewer, display, algorithm), find(solid, display, algorithm)
        shows = after >= len(solid.deeper) * rgbd.depth_mm.size
        yield Comparison(display, rgbd, (before == after) | shows, display.lensed)


def _endless(find: Show, algorithm: str) -> Iterator[Comparison]:
    """Solids that extend to the next front have the sources of endless columns."""
    for display, rgbd in noise_pictures():
        solid = solids_of(rgbd, display)
        second, third = solid.deeper
        filled = replace(
            solid,
            back_mm=np.where(second.covered, second.front_mm, np.float32(-np.inf)),
            deeper=(replace(second, back_mm=third.front_mm), third),
        )
        columns = replace(solid, back_mm=np.full(rgbd.shape, -np.inf, np.float32), deeper=())
        before, after = find(columns, display, algorithm), find(filled, display, algorithm)
        cells = rgbd.depth_mm.size
        equal = np.where(after >= 0, after % cells, after) == before
        yield Comparison(display, rgbd, equal, display.lensed)


LAYER_RELATIONS = [
    Relation("without layers as template", _plain, bitwise=True),
    Relation("a solid cut in two", _cut, bitwise=True),
    Relation("the deepest solid changes what shows it", _behind, bitwise=True),
    Relation("solids without gaps are columns", _endless, bitwise=True),
]


# -- types --------------------------------------------------------------------------------------


def _equal_types(show: Show, algorithm: str) -> Iterator[Comparison]:
    """Float32 tables and float64 rays give equal bits."""
    for display, rgbd in noise_pictures():
        rays = ray_by_ray(display, rgbd.shape, rgbd.pixel_mm)
        colours = colours_of(rays.sources(rgbd), rgbd)
        equal = same_colour(show(rgbd, display, algorithm), colours)
        yield Comparison(display, rgbd, equal, display.lensed)


_TYPES = Relation("float32 tables or float64 rays", _equal_types, bitwise=True)
