"""Reader of triangle meshes: PLY, OBJ, OFF, STL and glTF.

Files are decoded here or by trimesh, checked once as arrays, and passed to Mitsuba as arrays.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from inim.display.pixels import MM_PER_INCH
from inim.render.meshes.obj import read_obj
from inim.render.meshes.off import read_off
from inim.render.meshes.ply import is_ply, read_ply
from inim.render.meshes.serialized import read_serialized
from inim.render.meshes.triangle_mesh import (
    MESH_SUFFIXES,
    Mesh,
    check_mesh,
    coarse_text,
    has_area,
    read_bytes,
)
from inim.system.errors import FileError

# Millimetres in one unit of length.
UNIT_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": MM_PER_INCH}

# Formats that MeshLab does not read, but Blender does.
_OF_BLENDER = (".usdz", ".usd", ".usda", ".usdc", ".abc", ".blend")


def _silent(_: str) -> None:
    """Ignore a warning."""


def read_mesh(
    path: Path, warn: Callable[[str], object] = _silent, data: bytes | None = None
) -> list[Mesh]:
    """Read every triangle mesh of a PLY, OBJ, OFF, STL, GLB or glTF file, node transforms applied.

    * `warn`: called with a line on what is not read.
    * `data`: content of the file, if already read.

    Raises `FileError`: the file is missing, of another kind, damaged or without faces; one line
    with the file and the cause.
    """
    path = Path(path)
    data = read_bytes(path) if data is None else data
    return _meshes(path, data, mesh_kind(path, data), warn, materials=True)


def read_shapes(
    path: Path, plugin: str, warn: Callable[[str], object] = _silent
) -> tuple[Mesh, ...]:
    """Read the mesh file of a scene's shape, without its materials: the scene has its own.

    * `plugin`: Mitsuba's name of the shape, which is that of the format: ply, obj or serialized.
      Only the last has several meshes, which `shape_index` numbers.
    * `warn`: called with a line if its coordinates are too large for float32.

    Raises `FileError`: as `read_mesh`.
    """
    meshes = _meshes(path, read_bytes(path), plugin, warn, materials=False)
    for mesh in meshes:
        if text := coarse_text(mesh.vertices):
            warn(f"{path}: {text}; `inim new-scene` centres a mesh first")
    if plugin != "serialized":
        meshes = meshes[:1]
    return tuple(replace(mesh, vertices=mesh.vertices.astype(np.float32)) for mesh in meshes)


def _meshes(
    path: Path, data: bytes, kind: str, warn: Callable[[str], object], *, materials: bool
) -> list[Mesh]:
    if kind == "ply":
        meshes = [read_ply(path, data, warn, materials=materials)]
    elif kind == "obj":
        meshes = read_obj(path, data, warn, materials=materials)
    elif kind == "off":
        meshes = [read_off(path, data, warn)]
    elif kind == "serialized":
        meshes = read_serialized(path, data)
    else:
        # Loads in a third of a second, which scenes of plain PLY meshes need not pay.
        from inim.render.meshes.trimesh_reader import read_with_trimesh

        meshes = read_with_trimesh(path, data, kind, warn)
    for mesh in meshes:
        check_mesh(path, mesh)
    if kind == "serialized":  # whose numbers must not change
        return meshes
    # Of several surfaces, those that are no more than lines show nothing.
    surfaces = [mesh for mesh in meshes if has_area(mesh.vertices, mesh.faces)]
    if not surfaces:
        raise FileError(f"{path}: all faces have zero area; export the surface again")
    return surfaces


def mesh_kind(path: Path, data: bytes) -> str:
    """A suffix of `MESH_SUFFIXES` without its dot: by the content first, where text by the name."""
    suffix = path.suffix.lower()
    start = data[:1024].lstrip()
    if is_ply(data):
        return "ply"
    if start.startswith(b"glTF"):
        return "glb"
    if suffix == ".stl" or start[:5].lower() == b"solid" or _is_binary_stl(data):
        return "stl"
    if start.startswith(b"{") and b'"asset"' in data:
        return "gltf"
    if suffix in (".obj", ".off"):
        return suffix[1:]
    if suffix in MESH_SUFFIXES:
        raise FileError(f"{path}: is named {suffix} but its content is not; export it again")
    remedy = "open it in MeshLab, or in Blender, and export it as glTF (.glb)"
    if suffix in _OF_BLENDER:
        remedy = "import it in Blender (File, Import), and export it as glTF (.glb)"
    raise FileError(f"{path}: not a mesh that inim reads ({', '.join(MESH_SUFFIXES)}); {remedy}")


def _is_binary_stl(data: bytes) -> bool:
    """True if the file is as long as a binary STL of the declared triangles: 50 bytes each."""
    return len(data) >= 84 and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")
