"""Vertex normals for meshes that come without: smooth, but hard edges stay hard."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from inim.files.triangle_mesh import Mesh

__all__ = ["smoothed"]

# Edges that turn by more stay sharp: drapery and hair stay crisp, scan facets vanish.
_CREASE_DEG = 50.0


def smoothed(mesh: Mesh, crease_deg: float = _CREASE_DEG) -> Mesh:
    """The mesh with vertex normals, made where it has none: smooth, but hard edges stay hard.

    Corners that meet at a vertex share a normal when a fan of faces, each turning by less than
    `crease_deg` from the next, joins them; each such group becomes one vertex. Normals are means
    weighted by area. Vertices at one place are one for this purpose, so STL and texture seams
    come out smooth; faces without area are dropped.
    """
    if mesh.normals is not None:
        return mesh
    faces, area = _with_area(mesh)
    place = np.unique(mesh.vertices, axis=0, return_inverse=True)[1].reshape(-1)
    group = _fans(place[faces], area, np.cos(np.radians(crease_deg)))
    corner = faces.reshape(-1)
    key = group * len(mesh.vertices) + corner
    _, first, index = np.unique(key, return_index=True, return_inverse=True)
    taken = corner[first]
    return replace(
        mesh,
        vertices=mesh.vertices[taken],
        faces=index.reshape(-1, 3).astype(np.uint32),
        normals=_mean_normals(group, first, area),
        uv=None if mesh.uv is None else mesh.uv[taken],
        color=None if mesh.color is None else mesh.color[taken],
    )


def _with_area(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Faces (m, 3) int64 that have an area, and twice their area vectors (m, 3) float64."""
    points, faces = mesh.vertices.astype(np.float64), mesh.faces.astype(np.int64)
    a, b, c = (points[faces[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)
    kept = np.linalg.norm(area, axis=1) > 0
    return faces[kept], area[kept]


def _mean_normals(group: np.ndarray, first: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Unit normals (k, 3) of the groups that the corners `first` (k,) belong to."""
    weights = np.repeat(area, 3, axis=0)
    total = np.stack([np.bincount(group, weights[:, k], len(group)) for k in range(3)], axis=1)
    normals = total[group[first]]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    # A fan folded onto itself may cancel: its first face speaks for it.
    normals = np.where(length > 1e-12 * np.abs(area).max(), normals, weights[first])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    unit: np.ndarray = normals.astype(np.float32)
    return unit


def _fans(places: np.ndarray, area: np.ndarray, least_cosine: float) -> np.ndarray:
    """Group number of each corner (3 m,), given the places (m, 3) and face vectors (m, 3)."""
    unit = area / np.linalg.norm(area, axis=1, keepdims=True)
    start, end = places.reshape(-1), np.roll(places, -1, axis=1).reshape(-1)
    key = np.minimum(start, end) * (int(places.max()) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    one, two = order[:-1], order[1:]
    smooth = (key[one] == key[two]) & (
        np.einsum("ij,ij->i", unit[one // 3], unit[two // 3]) >= least_cosine
    )
    one, two = one[smooth], two[smooth]
    after = np.roll(np.arange(start.size).reshape(-1, 3), -1, axis=1).reshape(-1)
    along = start[one] == start[two]
    left = np.concatenate([one, after[one]])
    right = np.concatenate([np.where(along, two, after[two]), np.where(along, after[two], two)])
    return _joined(start.size, left, right)


def _joined(count: int, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Smallest member of each node's component under the edges left-right, by pointer jumping."""
    label = np.arange(count)
    while True:
        low = np.minimum(label[left], label[right])
        joined = label.copy()
        for ends in (left, right, label[left], label[right]):
            np.minimum.at(joined, ends, low)
        joined = joined[joined]
        if np.array_equal(joined, label):
            return label
        label = joined
