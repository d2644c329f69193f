"""Reader of OFF texts with the colours of vertices and faces, which trimesh leaves out."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from inim.image.color import linear_from_srgb
from inim.render.meshes.polygons import triangulate
from inim.render.meshes.triangle_mesh import Mesh, check_indices
from inim.system.errors import FileError

_HEAD = re.compile(rb"\s*(?:(ST)?(C)?(N)?OFF(?![ \t]*BINARY)|(?=\d+\s+\d+))")
_COMMENT = re.compile(rb"#[^\n]*")


def read_off(path: Path, data: bytes, warn: Callable[[str], object]) -> Mesh:
    """Read an OFF text: ``[ST][C][N]OFF``, faces of three or more corners.

    Colours are whole numbers up to 255 or fractions. Those of faces count more than those of
    vertices. `warn` is called with a line on colours that are not read.

    Raises `FileError`: another kind of OFF, or a damaged file.
    """
    data = _COMMENT.sub(b"", data.removeprefix(b"\xef\xbb\xbf").replace(b"\r", b"\n"))
    head = _HEAD.match(data)
    if head is None:
        raise FileError(f"{path}: not an OFF text of 3D points; open it in MeshLab, and export PLY")
    lines = [line.split() for line in data[head.end() :].splitlines()]
    lines = [words for words in lines if words]
    try:
        vertex_count, face_count = (int(word) for word in lines[0][:2])
        points, polygons = lines[1 : 1 + vertex_count], lines[1 + vertex_count :][:face_count]
        if len(points) < vertex_count or len(polygons) < face_count:
            raise FileError(f"{path}: declares more than it holds; it is cut short")
        first = 6 if head[3] else 3
        vertices = np.array([words[:3] for words in points], np.float64).reshape(-1, 3)
        color = _colors([words[first:] for words in points])
        counts = np.array([int(words[0]) for words in polygons], np.int64)
        corners = [int(w) for words in polygons for w in words[1 : 1 + int(words[0])]]
        after = [words[1 + int(words[0]) :] for words in polygons]
        of_faces = _colors(after)
        indices = np.array(corners, np.int64)
    except (IndexError, ValueError, OverflowError) as error:
        raise FileError(f"{path}: not a readable off mesh ({error}); export it again") from error
    if len(corners) < counts.sum():
        raise FileError(f"{path}: a face has fewer corners than it declares; export it again")
    check_indices(path, indices, len(vertices))
    triangles, polygon = triangulate(vertices[indices], counts)
    faces = indices[triangles]
    if any(0 < len(words) < 3 for words in after):
        warn(f"{path}: not read: colours of faces by their number in a table")
    if of_faces is None:
        return Mesh(vertices, faces, None, None, color, None, path.stem)
    if color is not None:
        warn(f"{path}: not read: colours of vertices next to those of faces")
    own = np.repeat(of_faces[polygon], 3, axis=0)
    numbers = np.arange(faces.size).reshape(-1, 3)
    return Mesh(vertices[faces.ravel()], numbers, None, None, own, None, path.stem)


def _colors(words: list[list[bytes]]) -> np.ndarray | None:
    """Linear RGB, (n, 3) float32, of three or four numbers each; None where none has them.

    Items without a colour have the mean of the others.
    """
    has_color = np.array([len(numbers) >= 3 for numbers in words], bool)
    if not has_color.any():
        return None
    values = np.array([numbers[:3] for numbers in words if len(numbers) >= 3], np.float64)
    is_fraction = values.max(axis=1, keepdims=True) <= 1
    share = np.clip(np.where(is_fraction, values, values / 255), 0, 1).astype(np.float32)
    color = np.zeros((len(words), 3), np.float32)
    color[has_color] = linear_from_srgb(share)
    color[~has_color] = color[has_color].mean(axis=0)
    return color
