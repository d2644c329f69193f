"""Triangle meshes in and out: PLY, OBJ, OFF, STL, glTF read with suspicion, PLY written.

`read_mesh` gives arrays to convert; `check_mesh_file` says whether a file that a scene
names may go to Mitsuba as it is: its loaders trust counts and indices, and a PLY whose face index
is out of range ends the process. Mitsuba and trimesh allocate by what a file says of itself: so
what OBJ, STL, glTF and Mitsuba's `.serialized` files declare is held against the bytes there are.
Triangle PLY is read here; every other layout goes through trimesh after that.
"""

from __future__ import annotations

import json
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from inim.errors import FileError
from inim.files.ply import check_ply, is_ply, read_ply
from inim.files.splat_ply import SPLAT_SHAPES, check_splats
from inim.files.triangle_mesh import (
    MESH_SUFFIXES,
    MOST_BYTES,
    Mesh,
    check_area,
    check_indices,
    check_points,
    first_line,
    has_area,
    numbers_in,
    read_bytes,
)

_BLOCK_BYTES = 2**22


def check_obj(path: Path, data: bytes) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Vertices and corners of an OBJ that Mitsuba reads: absolute indices, one corner layout."""
    vertices, corners, layouts = scan_obj(path, data)
    if corners.min() < 0:
        raise FileError(
            f"{path}: uses relative (negative) indices, which Mitsuba does not read; convert it "
            "with `inim new-scene`"
        )
    if len(layouts) > 1:
        raise FileError(
            f"{path}: only some faces have texture coordinates or normals, which Mitsuba misreads; "
            "convert it with `inim new-scene`"
        )
    # Polygons have any number of corners: every run of three covers each triangle of a fan's rim.
    yield vertices, np.lib.stride_tricks.sliding_window_view(corners - 1, 3)


def scan_obj(path: Path, data: bytes) -> tuple[np.ndarray, np.ndarray, set[str]]:
    """Positions (n, 3), all vertex indices as written and checked, and the corner layouts met."""
    positions, corners, layouts, start = [], [], set(), 0
    while start < len(data):
        end = data.find(b"\n", min(start + _BLOCK_BYTES, len(data)))
        end = len(data) if end < 0 else end + 1
        block, start = data[start:end], end
        lines = re.findall(rb"^[ \t\r]*v[ \t]+(\S+(?:[ \t]+\S+){0,2})", block, re.M)
        numbers = numbers_in(b" ".join(lines))
        if numbers is None or numbers.size != 3 * len(lines):
            raise FileError(
                f"{path}: a vertex line is not made of three numbers; the file is damaged"
            )
        positions.append(numbers.reshape(-1, 3).astype(np.float32))
        found, layout = _corners(path, block)
        corners.append(found)
        layouts |= layout
    vertices, indices = np.concatenate(positions), np.concatenate(corners)
    _check_corners(path, vertices, indices)
    return vertices, indices, layouts


def _corners(path: Path, block: bytes) -> tuple[np.ndarray, set[str]]:
    """Vertex indices of the faces in a block, and which of `v`, `v/t`, `v//n`, `v/t/n` it uses."""
    text = b" ".join(re.findall(rb"^[ \t\r]*f[ \t]+([^#\r\n\\]*)", block, re.M))
    slashes = text.count(b"/")
    if slashes:
        text = re.sub(rb"/(?=[\s/]|$)", b"/0", text)
    tokens = len(text.split())
    numbers = _obj_indices(path, text.replace(b"/", b" "))
    width, rest = divmod(numbers.size, max(tokens, 1))
    if rest or (slashes and slashes != (width - 1) * tokens):
        # Unlike corners side by side: the vertex index is what stands before the first slash.
        first = b" ".join(token.partition(b"/")[0] or b"?" for token in text.split())
        return _obj_indices(path, first), {"some", "other"}
    table = numbers.reshape(tokens, max(width, 1))
    return table[:, 0], {str((table != 0).any(axis=0).tolist())} if tokens else set()


def _obj_indices(path: Path, text: bytes) -> np.ndarray:
    """Whole numbers as int64; anything else, or what a float64 cannot count, is a FileError."""
    numbers = numbers_in(text)
    if numbers is None or not (np.abs(numbers) < 2**53).all() or (numbers % 1).any():
        raise FileError(f"{path}: a face line is not made of indices; the file is damaged")
    return numbers.astype(np.int64)


def _check_corners(path: Path, vertices: np.ndarray, corners: np.ndarray) -> None:
    """Refuse indices that no vertex answers to; OBJ counts from 1, negative ones from the end."""
    check_points(path, vertices, len(corners) // 3)
    worst = int(corners[np.abs(corners).argmax()])
    if abs(worst) > len(vertices) or (corners == 0).any():
        raise FileError(
            f"{path}: a face refers to vertex {worst if abs(worst) > len(vertices) else 0}, but "
            f"there are {len(vertices)} (1 to {len(vertices)}); the file is damaged"
        )


# A binary STL: a title, the count, then a record for each triangle.
_STL_COUNT_AT, _STL_HEAD_BYTES, _STL_RECORD_BYTES = 80, 84, 50


def stl_fits(data: bytes) -> bool:
    """Whether the bytes are a binary STL, which is exactly as long as its count says."""
    return len(data) == _stl_size(_stl_count(data))


def check_stl(path: Path, data: bytes) -> None:
    """A binary STL is exactly as long as its count says; a text one has facets."""
    if stl_fits(data):
        if len(data) == _STL_HEAD_BYTES:
            raise FileError(f"{path}: holds no triangles; export the mesh again")
        return
    if data[:5].lower() == b"solid" and b"\0" not in data:
        if b"vertex" not in data.lower():
            raise FileError(f"{path}: holds no triangles; export the mesh again")
        return
    count = _stl_count(data)
    raise FileError(
        f"{path}: an STL of {count} triangles is {_stl_size(count)} bytes long, this one is "
        f"{len(data)}; it is cut short or damaged"
    )


def _stl_count(data: bytes) -> int:
    """Triangles that a binary STL declares; 0 where it is too short to say."""
    return (
        int(struct.unpack_from("<I", data, _STL_COUNT_AT)[0]) if len(data) >= _STL_HEAD_BYTES else 0
    )


def _stl_size(count: int) -> int:
    return _STL_HEAD_BYTES + _STL_RECORD_BYTES * count


# Accessors may share bytes (interleaved, instanced); beyond this factor it is a bomb.
_MOST_SHARING = 16
_MOST_NODES = 100_000
# What a tree raises that is not built as a glTF's is.
_WRONG_KINDS = (ValueError, AttributeError, TypeError, RuntimeError, OSError)


def check_gltf(path: Path, data: bytes) -> None:
    """Hold the accessors of a glTF against the bytes there are: trimesh allocates what they say."""
    text = data
    try:
        if data.lstrip().startswith(b"glTF"):
            text = data[20 : _check_chunks(data)]
        tree = json.loads(text)
        bytes_there = len(data) + sum(_outside_bytes(path, b) for b in tree.get("buffers", []))
        declared = sum(_accessor_bytes(a) for a in tree.get("accessors", []))
        nodes = len(tree.get("nodes", []))
    except (struct.error, ArithmeticError, LookupError, *_WRONG_KINDS) as error:
        raise FileError(f"{path}: not a sound glTF file ({first_line(error)})") from error
    if declared > _MOST_SHARING * bytes_there or nodes > _MOST_NODES:
        raise FileError(
            f"{path}: declares {declared} bytes of data in {nodes} nodes, but has {bytes_there}; "
            "it is cut short or damaged"
        )


def _check_chunks(data: bytes) -> int:
    """Where the first chunk, the JSON, ends; a ValueError where a chunk is longer than the file."""
    at, first_end = 12, 0
    while at + 8 <= len(data):
        length = struct.unpack_from("<I", data, at)[0]
        at += 8 + length
        if at > len(data):
            raise ValueError("a chunk of it is cut short")
        first_end = first_end or at
    return first_end


def _accessor_bytes(accessor: dict[str, Any]) -> int:
    sizes = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
    count = int(accessor["count"])
    if count < 0:
        raise ValueError(f"an accessor has {count} items")
    return count * sizes[accessor["componentType"]] * width[accessor["type"]]


def _outside_bytes(path: Path, buffer: dict[str, Any]) -> int:
    """Size of a buffer's own file, if it lies in the glTF's folder."""
    uri = str(buffer.get("uri", ""))
    if not uri or uri.startswith("data:"):
        return 0
    folder = path.parent.resolve()
    target = (folder / uri).resolve()
    if not target.is_relative_to(folder) or not target.is_file():
        raise ValueError(f"its buffer {uri[:60]!r} is not a file in the same folder")
    return target.stat().st_size


_MAGIC = 0x041C
# DEFLATE cannot shrink by more than this.
_MOST_DEFLATE = 1032


def is_serialized(data: bytes) -> bool:
    """Whether a file opens as one of Mitsuba's `.serialized` files."""
    return data[:2] == struct.pack("<H", _MAGIC)


def check_serialized(path: Path, data: bytes) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Every mesh of a `.serialized` file, versions 3 and 4, inflated no further than declared."""
    try:
        count = struct.unpack_from("<I", data, len(data) - 4)[0]
        version = struct.unpack_from("<HH", data)[1]
        code, width = ("<Q", 8) if version == 4 else ("<I", 4)
        table = len(data) - 4 - width * count
        if version not in (3, 4) or not 1 <= count <= len(data) // width or table < 4:
            raise ValueError("version or table of meshes is wrong")
        for k in range(count):
            offset = struct.unpack_from(code, data, table + width * k)[0]
            yield _inflate_mesh(data[offset + 4 : table], version)
    except (struct.error, zlib.error, ValueError) as error:
        raise FileError(
            f"{path}: not a sound .serialized mesh ({error}); export it as PLY"
        ) from error


def _inflate_mesh(data: bytes, version: int) -> tuple[np.ndarray, np.ndarray]:
    stream = zlib.decompressobj()
    head = stream.decompress(data, 4096)
    flags = struct.unpack_from("<I", head)[0]
    start = head.index(b"\0", 4) + 1 if version == 4 else 4
    n, m = struct.unpack_from("<QQ", head, start)
    start += 16
    size = 8 if flags & 0x2000 else 4
    floats = 3 + 3 * bool(flags & 1) + 2 * bool(flags & 2) + 3 * bool(flags & 8)
    total = start + n * floats * size + m * 12
    if total > _MOST_DEFLATE * len(data) or total > MOST_BYTES:
        raise ValueError(f"declares {n} vertices and {m} faces in {len(data)} bytes")
    if total > len(head):
        head += stream.decompress(stream.unconsumed_tail, total - len(head))
    if len(head) < total:
        raise ValueError("it is cut short")
    vertices = np.frombuffer(head, f"<f{size}", 3 * n, start).reshape(-1, 3)
    faces = np.frombuffer(head, "<u4", 3 * m, start + n * floats * size).reshape(-1, 3)
    return vertices.astype(np.float32), faces.astype(np.int64)


# `STOFF`, `COFF`, `NOFF`: with texture coordinates, colours, normals, which are not read.
_OFF = re.compile(rb"(?:ST)?C?N?OFF\b(?!\s*BINARY)")
# Read as lines of text, in some twenty times as much memory.
_MOST_OFF_BYTES = 2**28


def check_off(path: Path, data: bytes) -> None:
    """An OFF is text in three dimensions, and of a size that can be split into lines."""
    if not _OFF.match(data):
        raise FileError(f"{path}: not an OFF of text in three dimensions; export it as PLY")
    if len(data) > _MOST_OFF_BYTES:
        raise FileError(f"{path}: an OFF of {len(data)} bytes; export it as PLY")


# Millimetres in one unit of length.
UNIT_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}

# What a file must pass before trimesh may read it; PLY passes while its header is read.
_BEFORE_TRIMESH: dict[str, Callable[[Path, bytes], object]] = {
    "obj": scan_obj,
    "off": check_off,
    "stl": check_stl,
    "glb": check_gltf,
    "gltf": check_gltf,
}
# By Mitsuba's shape plugin: the surfaces of a file, or a FileError.
_BEFORE_MITSUBA = {"ply": check_ply, "obj": check_obj, "serialized": check_serialized}


def _silent(_: str) -> None:
    """Ignore a warning."""


def read_mesh(path: Path, warn: Callable[[str], object] = _silent) -> list[Mesh]:
    """Read every triangle mesh of a PLY, OBJ, OFF, STL, GLB or glTF file, node transforms applied.

    Parameters
    ----------
    path : Path
    warn : callable
        Called with a line for each thing that the file names and the meshes go without.

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


def check_mesh_file(path: Path, plugin: str | None = None) -> int:
    """Refuse a file that Mitsuba's `ply`, `obj`, `serialized` or `ellipsoids` cannot take safely.

    Parameters
    ----------
    path : Path
    plugin : str or None
        The shape plugin that will read the file; None goes by the file's content.

    Returns
    -------
    int
        How many splats it holds; 0 of a mesh.

    Raises
    ------
    FileError
        One line naming the file, the fault and the way out.
    """
    path = Path(path)
    data = read_bytes(path)
    if plugin in SPLAT_SHAPES:
        return check_splats(path, data)
    if plugin is None:
        plugin = "serialized" if is_serialized(data) else mesh_kind(path, data)
    if plugin not in _BEFORE_MITSUBA:
        raise FileError(
            f"{path}: {plugin} is no mesh format of Mitsuba; convert it with `inim new-scene`"
        )
    for vertices, faces in _BEFORE_MITSUBA[plugin](path, data):
        check_indices(path, vertices, faces)
        check_area(path, [(vertices, faces)])
    return 0


def mesh_kind(path: Path, data: bytes) -> str:
    """A suffix of `MESH_SUFFIXES` without its dot: by the content first, where text by the name."""
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
    if suffix in (".obj", ".off"):
        return suffix[1:]
    if suffix in MESH_SUFFIXES:
        raise FileError(f"{path}: is named {suffix} but its content is not; export it again")
    raise FileError(
        f"{path}: not a mesh that inim reads ({', '.join(MESH_SUFFIXES)}); convert it in Blender "
        "or MeshLab first"
    )
