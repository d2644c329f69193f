"""Writer of Mitsuba's `serialized` meshes, from the description of the format."""

import struct
import zlib
from collections.abc import Sequence

import numpy as np

#: Bits of the flags: normals, texture coordinates, colours, float32, float64.
FLAGS = {"normals": 0x1, "uv": 0x2, "color": 0x8}
SINGLE, DOUBLE = 0x1000, 0x2000


def serialized(
    meshes: Sequence[dict[str, np.ndarray]], version: int = 4, kind: str = "f4"
) -> bytes:
    """Content of a file; each mesh has `vertices` and `faces`, and what `FLAGS` lists."""
    parts = []
    for number, mesh in enumerate(meshes):
        flags = SINGLE if kind == "f4" else DOUBLE
        flags |= sum(bit for name, bit in FLAGS.items() if name in mesh)
        content = struct.pack("<I", flags)
        if version == 4:
            content += f"mesh {number}".encode() + b"\0"
        content += struct.pack("<QQ", len(mesh["vertices"]), len(mesh["faces"]))
        for name in ("vertices", *FLAGS):
            if name in mesh:
                content += mesh[name].astype(f"<{kind}").tobytes()
        content += mesh["faces"].astype("<u4").tobytes()
        parts.append(struct.pack("<HH", 0x041C, version) + zlib.compress(content))
    starts = np.cumsum([0, *(len(part) for part in parts[:-1])])
    size = "u8" if version == 4 else "u4"
    return b"".join(parts) + starts.astype(f"<{size}").tobytes() + struct.pack("<I", len(parts))
