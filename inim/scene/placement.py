"""The relic's meshes merged, turned and centred, in millimetres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from inim.files.mesh import Mesh
from inim.scene.scene_xml import STONE

__all__ = ["bounds", "merged", "placed"]


def merged(meshes: Sequence[Mesh]) -> list[Mesh]:
    """One mesh for all without texture, one for each texture: Mitsuba dislikes many shapes."""
    alike: dict[object, list[Mesh]] = {}
    for mesh in meshes:
        key = None if mesh.texture is None else (mesh.texture.shape, mesh.texture.tobytes())
        alike.setdefault(key, []).append(mesh)
    return [_one(group) for group in alike.values()]


def _one(group: Sequence[Mesh]) -> Mesh:
    """Meshes with normals, of one texture or of none, as one."""
    starts = np.cumsum([0, *(len(m.vertices) for m in group)])
    textured = group[0].texture is not None
    colored = not textured and any(m.color is not None for m in group)
    colors = [np.tile(STONE, (len(m.vertices), 1)) if m.color is None else m.color for m in group]
    return replace(
        group[0],
        vertices=np.concatenate([m.vertices for m in group]),
        faces=np.concatenate([m.faces + n for m, n in zip(group, starts, strict=False)]),
        normals=np.concatenate([m.normals for m in group if m.normals is not None]),
        uv=np.concatenate([m.uv for m in group if m.uv is not None]) if textured else None,
        color=np.concatenate(colors) if colored else None,
    )


def bounds(meshes: Sequence[Mesh]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) float64 of what the faces use."""
    used = [mesh.vertices[np.unique(mesh.faces)] for mesh in meshes]
    low = np.min([points.min(axis=0) for points in used], axis=0)
    return low.astype(float), np.max([points.max(axis=0) for points in used], axis=0).astype(float)


def placed(meshes: Sequence[Mesh], turn: np.ndarray, scale_mm: float) -> list[Mesh]:
    """Turned, in millimetres, with the centre of the bounding box at the origin."""
    low, high = bounds(meshes)
    middle = (low + high) / 2
    moved = []
    for mesh in meshes:
        points = (mesh.vertices.astype(np.float64) - middle) @ turn.T * scale_mm
        normals = None if mesh.normals is None else mesh.normals @ turn.T
        moved.append(replace(mesh, vertices=points.astype(np.float32), normals=normals))
    return moved
