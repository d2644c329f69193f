"""Relations of the project's own generators: layers, implementations and types.

`EXPLAINED` lists the relations of `inim.apps.stress.relations` that a definition does not promise.
The study measures them, too, and gives the reason in the report.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from inim.apps.stress.document import RelationResult
from inim.apps.stress.pictures import (
    Show,
    algorithm_output,
    colours_of,
    input_of,
    noise_pictures,
    solids_of,
)
from inim.apps.stress.relations import (
    RELATIONS,
    Comparison,
    Relation,
    check_relation,
    same_colour,
)
from inim.display import Display
from inim.generators import find_sources
from inim.generators.template import ray_by_ray
from inim.image.rgbd import RGBD, Layer, LayeredRGBD
from reports.stress.study.oracles import answer
from reports.stress.study.rays import rays_over

_LAYERED = "layered:samples=1"
_SOLID = "template:columns=solid"
_ALGORITHMS = (
    "template",
    _SOLID,
    "gu2020",
    "wang2024",
    "wang2024:matching=ray",
    "li2012",
    _LAYERED,
)
_RIVALS = ("gu2020", "wang2024", "wang2024:matching=ray", "li2012")
# Algorithms for non-separable displays.
_NONSEPARABLE = ("template", _SOLID, "gu2020", _LAYERED)

_NO_OCCLUSION = "the best match on the ray is used; the method ignores occlusion"
_A_POINT = "a picture pixel is a point; a nearer one lands elsewhere and uncovers others"
_STEPS = "its depth step P_I is a lateral length; a stretched z is sampled more finely"
_SIZE = "a picture pixel is a point; more distant pixels are denser on the panel"
_BY_ROWS = "z depends only on the rows; a transposed picture is a different problem"
_BY_NEIGHBOURS = "a surface column ends at the depths of its neighbours"
_STRETCH = "stretch along z x 4"
_NEARER = "a nearer object changes only its shadow"
#: Relations that a definition does not promise, with the reason.
EXPLAINED = {
    ("transpose", "wang2024"): _BY_ROWS,
    (_STRETCH, "template"): _BY_NEIGHBOURS,
    (_NEARER, "template"): _BY_NEIGHBOURS,
    ("an object where nothing was", "template"): _BY_NEIGHBOURS,
    (_STRETCH, "gu2020"): _STEPS,
    ("move along z", "li2012"): _SIZE,
    (_NEARER, "wang2024"): _NO_OCCLUSION,
    (_NEARER, "wang2024:matching=ray"): _NO_OCCLUSION,
    (_NEARER, "li2012"): _A_POINT,
}


def run_relations(
    show: Show = algorithm_output,
    relations: list[tuple[Relation, tuple[str, ...]]] | None = None,
    explained: dict[tuple[str, str], str] = EXPLAINED,
) -> list[RelationResult]:
    """Check each relation for each algorithm; see `inim.apps.stress.relations.check_relation`.

    Parameters
    ----------
    show : callable
        The tested function.
    relations : list of (Relation, algorithms), optional
        Default: all relations.
    explained : dict
        Reasons by relation and algorithm.
    """
    return [
        check_relation(
            relation,
            algorithm,
            show=show,
            exact=algorithm in ("template", _SOLID, _LAYERED),
            explained=explained.get((relation.name, algorithm), ""),
            doubt=_uncertain,
        )
        for relation, algorithms in (all_relations() if relations is None else relations)
        for algorithm in algorithms
    ]


def all_relations() -> list[tuple[Relation, tuple[str, ...]]]:
    """All relations, each with its algorithms."""
    relations = []
    for relation in RELATIONS:
        algorithms = _NONSEPARABLE if relation.misaligned else _ALGORITHMS
        relations.append((relation, algorithms[:-1] if relation.one_layer else algorithms))
    return [*relations, *_IMPLEMENTATIONS]


def _uncertain(rgbd: RGBD, display: Display, algorithm: str, pixels: np.ndarray) -> int:
    """Number of panel pixels that rounding decides."""
    picture = input_of(rgbd, display, algorithm)
    rays = rays_over(display, rgbd, pixels)
    name = "layered" if algorithm == _LAYERED else algorithm
    return int(answer(name, rays, picture, display, np.float64).uncertain.sum())


# -- layers -------------------------------------------------------------------------------------


def run_layer_relations(find: Show = find_sources) -> list[RelationResult]:
    """Check each of `LAYER_RELATIONS` with the sources of `find`."""
    return [
        check_relation(relation, _LAYERED, show=find, exact=True, doubt=lambda *_: 0)
        for relation in LAYER_RELATIONS
    ]


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


# -- implementations ----------------------------------------------------------------------------


def _equal_to(other: Callable[[RGBD, Display, str], np.ndarray]) -> Callable:
    """Check that an algorithm and another implementation of it give equal bits."""

    def check(show: Show, algorithm: str) -> Iterator[Comparison]:
        for display, rgbd in noise_pictures():
            equal = same_colour(show(rgbd, display, algorithm), other(rgbd, display, algorithm))
            yield Comparison(display, rgbd, equal, display.lensed)

    return check


def _in_float64(rgbd: RGBD, display: Display, _: str) -> np.ndarray:
    return colours_of(ray_by_ray(display, rgbd.shape, rgbd.pixel_mm).sources(rgbd), rgbd)


_IMPLEMENTATIONS = [
    (
        Relation("float32 tables or float64 rays", _equal_to(_in_float64), bitwise=True),
        ("template",),
    ),
]
