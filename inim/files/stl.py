"""Sizes of an STL file, before anyone allocates by them."""

from __future__ import annotations

import struct
from pathlib import Path

from inim.errors import FileError

__all__ = ["check_stl", "stl_fits"]

# A binary STL: a title, the count, then a record for each triangle.
_COUNT_AT, _HEAD_BYTES, _RECORD_BYTES = 80, 84, 50


def stl_fits(data: bytes) -> bool:
    """Whether the bytes are a binary STL, which is exactly as long as its count says."""
    return len(data) == _size(_count(data))


def check_stl(path: Path, data: bytes) -> None:
    """A binary STL is exactly as long as its count says; a text one has facets."""
    if stl_fits(data):
        if len(data) == _HEAD_BYTES:
            raise FileError(f"{path}: holds no triangles; export the mesh again")
        return
    if data[:5].lower() == b"solid" and b"\0" not in data:
        if b"vertex" not in data.lower():
            raise FileError(f"{path}: holds no triangles; export the mesh again")
        return
    count = _count(data)
    raise FileError(
        f"{path}: an STL of {count} triangles is {_size(count)} bytes long, this one is "
        f"{len(data)}; it is cut short or damaged"
    )


def _count(data: bytes) -> int:
    """Triangles that a binary STL declares; 0 where it is too short to say."""
    return int(struct.unpack_from("<I", data, _COUNT_AT)[0]) if len(data) >= _HEAD_BYTES else 0


def _size(count: int) -> int:
    return _HEAD_BYTES + _RECORD_BYTES * count
