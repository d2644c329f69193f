"""Account of a mesh file: what it contains, and what a scene shows of it."""

import re
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from inim.render.meshes.gltf import count_triangles
from inim.render.meshes.triangle_mesh import Mesh, bounds, face_areas

_FACE = re.compile(rb"^[ \t]*[fF][ \t]+([^\r\n#]*)", re.MULTILINE)
# Relative difference of areas that is no rounding of coordinates.
_TOLERANCE = 1e-3


class MeshAccount(msgspec.Struct, frozen=True, kw_only=True):
    """Contents of a mesh file as they were read."""

    triangles: int
    #: Triangles by the file's own numbers; None if it has polygons, which are counted only by
    #: reading them.
    declared: int | None
    bodies: int  #: Connected parts.
    size: list[float]  #: Along x, y and z, in the file's unit.
    area: float  #: Of all triangles, in the file's unit.
    textures: int
    colored: bool  #: True if it has colours other than those of textures.

    @property
    def text(self) -> str:
        """The account in one line."""
        lengths = " x ".join(f"{length:.5g}" for length in self.size)
        colors = [f"{self.textures} texture{'s' * (self.textures > 1)}"] * bool(self.textures)
        colors += ["colours"] * self.colored
        bodies = f"{self.bodies} bod{'y' if self.bodies == 1 else 'ies'}"
        return (
            f"{self.triangles} triangles, {bodies}, {lengths} units, "
            f"{' and '.join(colors) or 'no colours'}"
        )

    def lost(self, parts: Sequence[Mesh], scale: float) -> list[str]:
        """Sentences on what is missing in the parts of a scene, `scale` times as large."""
        sentences = []
        if self.declared is not None and self.declared != self.triangles:
            sentences.append(f"{self.triangles} triangles were read, of {self.declared} in it")
        area = _area(parts) / scale**2
        if abs(area - self.area) > _TOLERANCE * self.area:
            sentences.append(
                f"the scene has an area of {area:.4g} square units, the file {self.area:.4g}"
            )
        return sentences


def mesh_account(data: bytes, kind: str, meshes: Sequence[Mesh]) -> MeshAccount:
    """Account of a file, from its content and the meshes that were read from it."""
    low, high = bounds(meshes)
    textures = {mesh.texture.tobytes() for mesh in meshes if mesh.texture is not None}
    return MeshAccount(
        triangles=sum(len(mesh.faces) for mesh in meshes),
        declared=_declared(data, kind),
        bodies=sum(_bodies(mesh) for mesh in meshes),
        size=[float(length) for length in high - low],
        area=_area(meshes),
        textures=len(textures),
        colored=any(mesh.color is not None for mesh in meshes),
    )


def _declared(data: bytes, kind: str) -> int | None:
    if kind == "obj":
        text = data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
        return sum(max(0, len(line.split()) - 2) for line in _FACE.findall(text))
    if kind == "stl":
        if len(data) == 84 + 50 * int.from_bytes(data[80:84], "little"):
            return int.from_bytes(data[80:84], "little")
        return data.lower().count(b"endfacet")
    if kind in ("glb", "gltf"):
        return count_triangles(data)
    return None


def _area(meshes: Sequence[Mesh]) -> float:
    return sum(float(a.sum()) for mesh in meshes for a in face_areas(mesh.vertices, mesh.faces))


def _bodies(mesh: Mesh) -> int:
    """Connected parts; vertices at one place are one."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    rows: Any = np.ascontiguousarray(mesh.vertices).view(
        np.dtype((np.void, mesh.vertices.dtype.itemsize * 3))
    )
    place = np.unique(rows.ravel(), return_inverse=True)[1].reshape(-1)[mesh.faces]
    used, corner = np.unique(place, return_inverse=True)
    corner = corner.reshape(-1, 3)
    ends = np.concatenate([corner[:, :2], corner[:, 1:]])
    graph = coo_matrix((np.ones(len(ends), bool), tuple(ends.T)), shape=(len(used),) * 2)
    return int(connected_components(graph, directed=False)[0])
