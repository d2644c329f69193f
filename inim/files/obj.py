"""Sizes and indices of an OBJ file, before anyone allocates by them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from inim.errors import FileError
from inim.files.mesh_guard import check_points
from inim.files.text_numbers import numbers_in

__all__ = ["check_obj", "scan_obj"]

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
    numbers = _indices(path, text.replace(b"/", b" "))
    width, rest = divmod(numbers.size, max(tokens, 1))
    if rest or (slashes and slashes != (width - 1) * tokens):
        # Unlike corners side by side: the vertex index is what stands before the first slash.
        first = b" ".join(token.partition(b"/")[0] or b"?" for token in text.split())
        return _indices(path, first), {"some", "other"}
    table = numbers.reshape(tokens, max(width, 1))
    return table[:, 0], {str((table != 0).any(axis=0).tolist())} if tokens else set()


def _indices(path: Path, text: bytes) -> np.ndarray:
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
