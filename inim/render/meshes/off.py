"""Reader of OFF texts with the colours of vertices and faces, which trimesh leaves out."""

import re
from pathlib import Path

import numpy as np

from inim.image.color import linear_from_srgb
from inim.render.meshes.triangle_mesh import Mesh
from inim.system.errors import FileError

_HEAD = re.compile(rb"\s*(ST)?(C)?(N)?OFF\b(?![ \t]+BINARY)")
_COMMENT = re.compile(rb"#[^\n]*")


def read_off(path: Path, data: bytes) -> Mesh:
    """Read an OFF text: ``[ST][C][N]OFF``, faces of three or more corners.

    Colours are whole numbers up to 255 or fractions; a face's last. Raises `FileError`: another
    kind of OFF, or a damaged file.
    """
    head = _HEAD.match(data)
    if head is None:
        raise FileError(f"{path}: not an OFF text of 3D points; open it in MeshLab, and export PLY")
    lines = [line.split() for line in _COMMENT.sub(b"", data[head.end() :]).splitlines()]
    lines = [words for words in lines if words]
    try:
        vertex_count, face_count = (int(word) for word in lines[0][:2])
        points, polygons = lines[1 : 1 + vertex_count], lines[1 + vertex_count :][:face_count]
        if len(points) < vertex_count or len(polygons) < face_count:
            raise FileError(f"{path}: declares more than it holds; it is cut short")
        first = 6 if head[3] else 3
        vertices = np.array([words[:3] for words in points], np.float64).reshape(-1, 3)
        color = _colors([words[first:] for words in points])
        corners = [[int(word) for word in words[1 : 1 + int(words[0])]] for words in polygons]
        of_faces = _colors([words[1 + int(words[0]) :] for words in polygons])
    except ValueError as error:
        raise FileError(f"{path}: not a readable off mesh ({error}); export it again") from error
    fans = [(n, c[0], c[k], c[k + 1]) for n, c in enumerate(corners) for k in range(1, len(c) - 1)]
    table = np.array(fans, np.int64).reshape(-1, 4)
    faces = table[:, 1:]
    is_valid = len(faces) and faces.min() >= 0 and faces.max() < len(vertices)
    if of_faces is not None and is_valid:
        color = np.repeat(of_faces[table[:, 0]], 3, axis=0)
        vertices, faces = vertices[faces.ravel()], np.arange(faces.size).reshape(-1, 3)
    return Mesh(vertices, faces, None, None, color, None, path.stem)


def _colors(words: list[list[bytes]]) -> np.ndarray | None:
    """Linear RGB, (n, 3) float32, of three or four numbers each; None where any has fewer."""
    if not words or any(len(numbers) < 3 for numbers in words):
        return None
    values = np.array([numbers[:3] for numbers in words], np.float64)
    is_fraction = values.max() <= 1 and any(b"." in n for numbers in words for n in numbers[:3])
    share = values if is_fraction else values / 255
    return linear_from_srgb(np.clip(share, 0, 1).astype(np.float32))
