"""Mitsuba's own `.serialized` meshes, versions 3 and 4, checked before Mitsuba trusts them."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from inim.errors import FileError
from inim.files.mesh_guard import MOST_BYTES

__all__ = ["check_serialized", "is_serialized"]

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
