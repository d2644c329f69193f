"""Reader of Mitsuba's `serialized` meshes: several meshes in one file, each packed by zlib.

Each mesh begins with the numbers 0x041C and 3 or 4, the version of the format. Packed are flags,
from version 4 on a name, the numbers of vertices and triangles, and the arrays that the flags list.
At the end of the file are the offsets of its meshes and their number.
"""

import struct
import zlib
from pathlib import Path

import numpy as np

from inim.render.meshes.triangle_mesh import Mesh, check_indices, usable_normals
from inim.system.errors import FileError

_MAGIC = 0x041C
_NORMALS, _UV, _COLORS, _DOUBLE = 0x0001, 0x0002, 0x0008, 0x2000
_MOST_MESHES = 100_000
# Bytes of a mesh: this many, or this many times those of its packed form.
_LEAST_LIMIT, _MOST_UNFOLDING = 2**28, 100


def read_serialized(path: Path, data: bytes) -> list[Mesh]:
    """Read all meshes of a file, in the order of `shape_index`.

    Raises `FileError`: another format, or a damaged file.
    """
    try:
        magic, version = struct.unpack_from("<HH", data)
        (count,) = struct.unpack_from("<I", data, len(data) - 4)
        if magic != _MAGIC or version not in (3, 4) or not 0 < count <= _MOST_MESHES:
            raise FileError(f"{path}: not a serialized mesh of version 3 or 4; export it as PLY")
        size = 8 if version == 4 else 4
        end = len(data) - 4 - count * size
        starts = np.frombuffer(data, f"<u{size}", count, end).astype(np.int64)
        ends = np.append(starts[1:], end)
        if end < 4 or (starts < 0).any() or (starts + 4 > ends).any():
            raise FileError(f"{path}: the offsets of its meshes are damaged; export it as PLY")
        return [
            _read_one(path, data[start + 4 : stop], version, f"{path.stem}-{number}")
            for number, (start, stop) in enumerate(zip(starts, ends, strict=True))
        ]
    except (struct.error, zlib.error, ValueError) as error:
        raise FileError(
            f"{path}: not a readable serialized mesh ({error}); export it as PLY"
        ) from error


def _read_one(path: Path, packed: bytes, version: int, name: str) -> Mesh:
    unpacker = zlib.decompressobj()
    content = unpacker.decompress(packed, max(_LEAST_LIMIT, _MOST_UNFOLDING * len(packed)))
    if unpacker.unconsumed_tail:
        raise FileError(
            f"{path}: unfolds from {len(packed)} to more than {len(content)} bytes; refused as "
            "damaged, export it as PLY"
        )
    (flags,) = struct.unpack_from("<I", content)
    at = 4
    if version == 4:
        stop = content.index(b"\0", at)
        name, at = content[at:stop].decode("utf-8", "replace") or name, stop + 1
    vertex_count, face_count = struct.unpack_from("<QQ", content, at)
    at += 16
    number = np.dtype("<f8" if flags & _DOUBLE else "<f4")
    index = np.dtype("<u8" if vertex_count > 0xFFFFFFFF else "<u4")

    def take(kind: np.dtype, count: int, width: int) -> np.ndarray:
        nonlocal at
        values = np.frombuffer(content, kind, count * width, at).reshape(count, width)
        at += values.nbytes
        return values

    vertices = take(number, vertex_count, 3).astype(np.float64)
    normals = take(number, vertex_count, 3).astype(np.float32) if flags & _NORMALS else None
    uv = take(number, vertex_count, 2).astype(np.float32) if flags & _UV else None
    if flags & _COLORS:  # Mitsuba does not read them either: a scene has its own materials
        take(number, vertex_count, 3)
    faces = take(index, face_count, 3).astype(np.int64)
    check_indices(path, faces, vertex_count)
    return Mesh(vertices, faces, usable_normals(normals), uv, None, None, name)
