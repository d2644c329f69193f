"""Subject of a scene: the shapes that form the relic.

Many scenes have a floor, a wall, or a room around what they show. Such shapes would decide the size
of all others on the display. The scene's own camera tells what it shows: shapes that lie wholly
inside its picture.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from inim.render.culling import world_points
from inim.render.library import mi
from inim.render.scene_files.file import SceneFile
from inim.render.trace import first_not_light
from inim.system.errors import SceneError, suggest_words

# Shapes that make a scene more than this many times as large as its subject are surroundings.
_SURROUNDINGS = 4.0
# Camera rays along each side of the picture.
_RAYS = 33


class Subject(NamedTuple):
    """Shapes that do not belong to the relic, and warnings about them."""

    left_out: tuple[Any, ...] = ()
    warnings: tuple[str, ...] = ()


def find_subject(file: SceneFile, scene: Any, shapes: Sequence[Any], relic: str) -> Subject:
    """Choose the shapes that form the relic.

    * `shapes`: those of the scene that are no lights.
    * `relic`: names of its shapes, separated by commas. Empty: what the scene's first camera shows
      as a whole, or else what it looks at with all that is next to it; and all other shapes, unless
      they make the scene more than four times as large.

    Raises `SceneError`: a name without a shape.
    """
    if names := [name.strip() for name in relic.split(",") if name.strip()]:
        return Subject(_others(file, shapes, names))
    if len(shapes) == 1:
        return Subject()
    boxes = _Boxes.of(shapes)
    whole = boxes.size(np.ones(len(shapes), bool))
    smallest = float(np.linalg.norm(boxes.high - boxes.low, axis=1).min())
    if whole <= _SURROUNDINGS * smallest:  # whatever the camera shows
        return Subject()
    group = _shown(scene, shapes, boxes)
    if group is None:
        return Subject((), _dominating(file, shapes, boxes))
    if whole <= _SURROUNDINGS * boxes.size(group):
        return Subject()
    left_out = tuple(shape for shape, is_in in zip(shapes, group, strict=True) if not is_in)
    names = [shape.id() for shape in left_out]
    more = f" and {len(names) - 5} more" * (len(names) > 5)
    return Subject(left_out, (
        f"{file.path}: left out {', '.join(names[:5])}{more}, which would make the scene far "
        "larger than what its camera shows; to choose the shapes, set inim.relic",
    ))  # fmt: skip


def _others(file: SceneFile, shapes: Sequence[Any], names: Sequence[str]) -> tuple[Any, ...]:
    """Shapes without one of these names; raises `SceneError` for a name without a shape."""
    ids = [shape.id() for shape in shapes]
    for name in names:
        if name not in ids:
            raise SceneError(
                f"{file.path}: inim.relic = {name!r}: the scene has no such shape; "
                f"{suggest_words(name, ids)}"
            )
    return tuple(s for s, name in zip(shapes, ids, strict=True) if name not in names)


class _Boxes(NamedTuple):
    """Corners of the bounding boxes of shapes, (n, 3) each."""

    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(cls, shapes: Sequence[Any]) -> "_Boxes":
        points = [world_points(shape) for shape in shapes]
        low, high = (np.array([end(p, axis=0) for p in points]) for end in (np.min, np.max))
        return cls(low, high)

    def size(self, chosen: np.ndarray) -> float:
        """Diagonal of the box around some of them."""
        span = self.high[chosen].max(axis=0) - self.low[chosen].min(axis=0)
        return float(np.linalg.norm(span))


def _shown(scene: Any, shapes: Sequence[Any], boxes: _Boxes) -> np.ndarray | None:
    """Mask of the shapes that the first camera shows; None without a camera or a hit."""
    if not scene.sensors():
        return None
    numbers = _hit_numbers(scene, shapes)
    border = np.concatenate([numbers[0], numbers[-1], numbers[:, 0], numbers[:, -1]])
    whole = np.setdiff1d(numbers[numbers >= 0], border)
    if len(whole):
        return np.isin(np.arange(len(shapes)), whole)
    rows, columns = np.nonzero(numbers >= 0)
    if not len(rows):
        return None
    middle = np.argmin(np.hypot(rows - _RAYS // 2, columns - _RAYS // 2))
    group = np.arange(len(shapes)) == numbers[rows[middle], columns[middle]]
    sizes = np.linalg.norm(boxes.high - boxes.low, axis=1)
    while True:
        low, high = boxes.low[group].min(axis=0), boxes.high[group].max(axis=0)
        size = boxes.size(group)
        near = np.all((boxes.low <= high + size / 2) & (boxes.high >= low - size / 2), axis=1)
        grown = group | (near & (sizes <= _SURROUNDINGS * size))
        if np.array_equal(grown, group):
            return np.asarray(group)
        group = grown


def _hit_numbers(scene: Any, shapes: Sequence[Any]) -> np.ndarray:
    """Number of the shape that each ray of the first camera meets, or -1; lights are invisible."""
    places = (np.arange(_RAYS) + 0.5) / _RAYS
    x, y = (grid.ravel() for grid in np.meshgrid(places, places))
    film = mi.Point2f(x, y)
    rays, _ = scene.sensors()[0].sample_ray(mi.Float(0), mi.Float(0.5), film, mi.Point2f(0.5))
    hit = first_not_light(scene, rays)
    is_valid = np.asarray(hit.is_valid() & ~hit.shape.is_emitter())
    numbers = np.full(len(x), -1)
    for number, shape in enumerate(shapes):
        pointer = mi.ShapePtr(shape)
        is_shape = np.asarray((hit.shape == pointer) | (hit.instance == pointer))
        numbers[is_valid & is_shape] = number
    return numbers.reshape(_RAYS, _RAYS)


def _dominating(file: SceneFile, shapes: Sequence[Any], boxes: _Boxes) -> tuple[str, ...]:
    """Warning of a shape far larger than all others together."""
    largest = int(np.argmax(np.linalg.norm(boxes.high - boxes.low, axis=1)))
    others = np.arange(len(shapes)) != largest
    own, rest = boxes.size(~others), boxes.size(others)
    if own <= _SURROUNDINGS * rest:
        return ()
    return (
        f"{file.path}: the shape {shapes[largest].id()} is {own / max(rest, 1e-30):.3g} times as "
        "large as all others together; to leave it out, name the others in inim.relic",
    )
