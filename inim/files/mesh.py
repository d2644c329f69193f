"""Triangle meshes in and out: PLY, OBJ, STL and glTF read with suspicion, PLY written for Mitsuba.

Two doors. `read_mesh` gives arrays to convert; `check_mesh_file` says whether a file that a scene
names may go to Mitsuba as it is: its loaders trust counts and indices, and a PLY whose face index
is out of range ends the process. Triangle PLY is read here; every other layout goes through
trimesh, after the declared counts were held against the file's size.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from inim.errors import FileError
from inim.files.mesh_formats import (
    check_gltf,
    check_obj,
    check_serialized,
    check_stl,
    is_serialized,
    scan_obj,
    stl_fits,
)
from inim.files.ply import check_ply, is_ply, read_ply, write_ply
from inim.files.triangle_mesh import Mesh, check_area, check_indices, has_area, read_bytes

__all__ = ["SUFFIXES", "UNIT_MM", "Mesh", "check_mesh_file", "mesh_kind", "read_mesh", "write_ply"]

# Millimetres in one unit of length.
UNIT_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
SUFFIXES = (".ply", ".obj", ".stl", ".glb", ".gltf")

# What a file must pass before trimesh may read it; PLY passes while its header is read.
_BEFORE_TRIMESH: dict[str, Callable[[Path, bytes], object]] = {
    "obj": scan_obj,
    "stl": check_stl,
    "glb": check_gltf,
    "gltf": check_gltf,
}
# By Mitsuba's shape plugin: the surfaces of a file, or a FileError.
_BEFORE_MITSUBA = {"ply": check_ply, "obj": check_obj, "serialized": check_serialized}


def _silent(_: str) -> None:
    """Tell nobody."""


def read_mesh(path: Path, warn: Callable[[str], object] = _silent) -> list[Mesh]:
    """Read every triangle mesh of a PLY, OBJ, STL, GLB or glTF file, node transforms applied.

    Parameters
    ----------
    path : Path
    warn : callable
        Told in a line each what the file names and the meshes go without: pictures, materials.

    Raises
    ------
    FileError
        Missing, of another kind, damaged, without faces, or with declared sizes that the file
        cannot hold; one line naming the file and the cause.
    """
    path = Path(path)
    data = read_bytes(path)
    kind = mesh_kind(path, data)
    meshes = None
    if kind == "ply":
        meshes = read_ply(path, data)
    else:
        _BEFORE_TRIMESH[kind](path, data)
    if meshes is None:
        # Loads in a third of a second, which checking a scene's own files need not pay.
        from inim.files.trimesh_reader import read_with_trimesh

        meshes = read_with_trimesh(path, kind, warn)
    check_area(path, [(mesh.vertices, mesh.faces) for mesh in meshes])
    # Of several surfaces, those that are no more than lines show nothing.
    return [mesh for mesh in meshes if has_area(mesh.vertices, mesh.faces)]


def check_mesh_file(path: Path, plugin: str | None = None) -> None:
    """Refuse a mesh file that Mitsuba's `ply`, `obj` or `serialized` shape cannot take safely.

    Parameters
    ----------
    path : Path
    plugin : str or None
        The shape plugin that will read the file; None goes by the file's content.

    Raises
    ------
    FileError
        One line naming the file, the fault and the way out.
    """
    path = Path(path)
    data = read_bytes(path)
    if plugin is None:
        plugin = "serialized" if is_serialized(data) else mesh_kind(path, data)
    if plugin not in _BEFORE_MITSUBA:
        raise FileError(
            f"{path}: {plugin} is no mesh format of Mitsuba; convert it with `inim new-scene`"
        )
    for vertices, faces in _BEFORE_MITSUBA[plugin](path, data):
        check_indices(path, vertices, faces)
        check_area(path, [(vertices, faces)])


def mesh_kind(path: Path, data: bytes) -> str:
    """`ply`, `obj`, `stl`, `glb` or `gltf`: by the content first, by the suffix where text."""
    suffix = path.suffix.lower()
    start = data[:1024].lstrip()
    if is_ply(data):
        return "ply"
    if start.startswith(b"glTF"):
        return "glb"
    if suffix == ".stl" or start[:5].lower() == b"solid" or stl_fits(data):
        return "stl"
    if start.startswith(b"{") and b'"asset"' in data:
        return "gltf"
    if suffix == ".obj":
        return "obj"
    if suffix in SUFFIXES:
        raise FileError(f"{path}: is named {suffix} but its content is not; export it again")
    raise FileError(
        f"{path}: not a mesh that inim reads ({', '.join(SUFFIXES)}); convert it in Blender or "
        "MeshLab first"
    )
