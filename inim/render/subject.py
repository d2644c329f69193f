"""Subject of a scene: the shapes that form the relic.

Many scenes have a floor, a wall, or a room around what they show. Such shapes would decide the size
of all others on the display.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from inim.render.culling import world_points
from inim.render.library import mi
from inim.render.scene_files.file import SceneFile
from inim.system.errors import SceneError, suggest_words

# A shape this many times as large as all others that belong together is their surroundings.
_SURROUNDINGS = 4.0
# Camera rays along each side of the picture.
_RAYS = 33


def find_left_out(
    file: SceneFile, scene: Any, shapes: Sequence[Any], relic: str
) -> tuple[Any, ...]:
    """Shapes that do not belong to the relic.

    * `shapes`: those of the scene that are no lights.
    * `relic`: names of its shapes, separated by commas; empty: all but those more than four times
      as large as what the scene's first camera looks at, with all that is next to it.

    Raises `SceneError`: a name without a shape.
    """
    names = [name.strip() for name in relic.split(",") if name.strip()]
    if names:
        ids = [shape.id() for shape in shapes]
        for name in names:
            if name not in ids:
                raise SceneError(
                    f"{file.path}: inim.relic = {name!r}: the scene has no such shape; "
                    f"{suggest_words(name, ids)}"
                )
        return tuple(s for s, name in zip(shapes, ids, strict=True) if name not in names)
    if len(shapes) == 1 or not scene.sensors():
        return ()
    subject = _looked_at(scene, shapes)
    if subject is None:
        return ()
    points = [world_points(shape) for shape in shapes]
    lows, highs = (np.array([end(p, axis=0) for p in points]) for end in (np.min, np.max))
    sizes = np.linalg.norm(highs - lows, axis=1)
    low, high = lows[subject], highs[subject]
    while True:
        size = float(np.linalg.norm(high - low))
        near = np.all((lows <= high + size / 2) & (highs >= low - size / 2), axis=1)
        near &= sizes <= _SURROUNDINGS * size
        grown_low, grown_high = lows[near].min(axis=0), highs[near].max(axis=0)
        if not near.any() or (np.array_equal(grown_low, low) and np.array_equal(grown_high, high)):
            break
        low, high = np.minimum(low, grown_low), np.maximum(high, grown_high)
    return tuple(shape for shape, length in zip(shapes, sizes, strict=True)
                 if length > _SURROUNDINGS * size)  # fmt: skip


def _looked_at(scene: Any, shapes: Sequence[Any]) -> int | None:
    """Number of the shape nearest to the middle of the picture of the first camera."""
    places = (np.arange(_RAYS) + 0.5) / _RAYS
    x, y = (grid.ravel() for grid in np.meshgrid(places, places))
    order = np.argsort(np.hypot(x - 0.5, y - 0.5), kind="stable")
    film = mi.Point2f(x[order], y[order])
    rays, _ = scene.sensors()[0].sample_ray(mi.Float(0), mi.Float(0.5), film, mi.Point2f(0.5))
    hit = scene.ray_intersect(rays)
    for place in np.flatnonzero(np.asarray(hit.is_valid())):
        for number, shape in enumerate(shapes):
            is_shape = (hit.shape == mi.ShapePtr(shape)) | (hit.instance == mi.ShapePtr(shape))
            if bool(np.asarray(is_shape)[place]):
                return number
    return None
