"""Triangulation of planar polygons, convex or not."""

import numpy as np
from numpy.typing import NDArray


def triangulate(
    points: np.ndarray, counts: np.ndarray
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Triangles of polygons.

    * `points`, (corners, 3) float: corners of all polygons, one polygon after the other.
    * `counts`, (polygons,) int: number of corners of each; those with fewer than 3 have no
      triangle.

    Returned values:
    * `corners`, (triangles, 3): numbers of corners.
    * `polygon`, (triangles,): number of the polygon of each triangle.
    """
    counts = np.asarray(counts, np.int64)
    starts = np.cumsum(counts) - counts
    corners, polygon = [np.empty((0, 3), np.int64)], [np.empty(0, np.int64)]
    for count in np.unique(counts[counts >= 3]):
        own = np.flatnonzero(counts == count)
        fan = np.stack([np.zeros(count - 2), np.arange(1, count - 1), np.arange(2, count)], axis=1)
        triangles = starts[own][:, None, None] + fan.astype(np.int64)
        if count > 3:
            shape = points[starts[own][:, None] + np.arange(count)].astype(np.float64)
            for number in np.flatnonzero(~_is_convex(shape)):
                triangles[number] = starts[own[number]] + _clip_ears(shape[number])
        corners.append(triangles.reshape(-1, 3))
        polygon.append(np.repeat(own, count - 2))
    order = np.argsort(np.concatenate(polygon), kind="stable")
    return np.concatenate(corners)[order], np.concatenate(polygon)[order]


def _normals(polygons: np.ndarray) -> np.ndarray:
    """Normals of polygons (n, corners, 3) by Newell's sum, twice as long as their areas."""
    after = np.roll(polygons, -1, axis=1)
    middle = polygons.mean(axis=1, keepdims=True)
    total: np.ndarray = np.cross(polygons - middle, after - middle).sum(axis=1)
    return total


def _is_convex(polygons: np.ndarray) -> NDArray[np.bool_]:
    """True for polygons, (n, corners, 3), that turn to one side at every corner."""
    before, after = np.roll(polygons, 1, axis=1), np.roll(polygons, -1, axis=1)
    turns = np.cross(polygons - before, after - polygons)
    side = np.einsum("nck,nk->nc", turns, _normals(polygons))
    is_convex: NDArray[np.bool_] = (side >= -1e-12 * np.abs(side).max(axis=1)[:, None]).all(axis=1)
    return is_convex


def _clip_ears(polygon: np.ndarray) -> np.ndarray:
    """Triangles of a polygon, (corners, 3), by cutting off corners that contain no other."""
    normal = _normals(polygon[None])[0]
    axes = np.argsort(np.abs(normal))[:2]
    x, y = polygon[:, sorted(axes)].T
    area = x @ np.roll(y, -1) - y @ np.roll(x, -1)
    sign = 1.0 if area >= 0 else -1.0

    def turn(a: int, b: int, c: int) -> float:
        return sign * float((x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a]))

    left, triangles = list(range(len(polygon))), []
    while len(left) > 3:
        for place in range(len(left)):
            a, b, c = left[place - 1], left[place], left[(place + 1) % len(left)]
            others = [p for p in left if p not in (a, b, c)]
            is_ear = turn(a, b, c) > 0 and not any(
                turn(a, b, p) >= 0 and turn(b, c, p) >= 0 and turn(c, a, p) >= 0 for p in others
            )
            if is_ear:
                break
        else:  # it crosses itself
            place, (a, b, c) = 1, left[:3]
        triangles.append((a, b, c))
        del left[place]
    return np.array([*triangles, left], np.int64)
