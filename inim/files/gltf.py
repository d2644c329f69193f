"""What a glTF file declares, held against the bytes there are: trimesh allocates by it."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

from inim.errors import FileError
from inim.files.mesh_guard import first_line

__all__ = ["check_gltf"]

# Accessors may share bytes (interleaved, instanced); beyond this factor it is a bomb.
_MOST_SHARING = 16
_MOST_NODES = 100_000
# What a tree raises that is not built as a glTF's is.
_WRONG_KINDS = (ValueError, AttributeError, TypeError, RecursionError)


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
