"""Triangle mesh: its value, validity checks, and normals.

Readers return a `Mesh` and writers accept one; the checks apply to every format.
"""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from inim.system.errors import FileError
from inim.system.files import read_file
from inim.system.process.printing import printable


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh in the unit and axes of the file it came from."""

    #: (n, 3) float64, or float32 where the file has no more digits
    vertices: np.ndarray
    faces: np.ndarray  #: (m, 3) integers, counter-clockwise from outside
    #: (n, 3) float32, finite and not zero, as in the file, or None
    normals: np.ndarray | None = None
    #: (n, 2) float32 or None; v grows upwards, row 0 of the texture is at v = 1
    uv: np.ndarray | None = None
    #: (n, 3) float32 or None; linear RGB in 0..1 (8-bit PLY, OBJ and STL colours are sRGB and
    #: decoded, glTF's are linear already)
    color: np.ndarray | None = None
    texture: np.ndarray | None = None  #: (h, w, 3) uint8 or None; sRGB, base colour
    name: str = ""
    #: Further values of vertices or faces, (n or m, 1 or 3) float32, by Mitsuba's names for them.
    attributes: dict[str, np.ndarray] = field(default_factory=dict)


def usable_normals(normals: np.ndarray | None) -> np.ndarray | None:
    """The normals; None where any is zero or not finite, so that they are computed."""
    if normals is None:
        return None
    length = np.linalg.norm(normals, axis=1)
    return normals if np.isfinite(length).all() and (length >= 1e-6).all() else None


#: Of the mesh files that are read.
MESH_SUFFIXES = (".ply", ".obj", ".off", ".stl", ".glb", ".gltf")
# Scans of a hundred million triangles are decimated before they are rendered.
MOST_BYTES = 2**31
# Squares of coordinates must stay finite in float32 (largest 3.4e38).
_MOST_EXTENT = 1e15
# Area of a face against the square of the extent: below it, rounding of float64 products.
_LEAST_AREA = 1e-14
_FACES_AT_ONCE = 65536


def read_bytes(path: Path) -> bytes:
    """Read a mesh file; raises `FileError` if it is missing, blank or too large."""
    data = read_file(path, MOST_BYTES)
    if not data.strip(b" \t\r\n\0"):
        raise FileError(f"{path}: the file is empty; export the mesh again")
    return data


def check_mesh(path: Path, mesh: Mesh) -> None:
    """Raise `FileError` unless a mesh has faces with valid vertices, all finite and of plausible
    extent.

    Mitsuba does not check its input: an index out of range ends the process.
    """
    vertices, faces = mesh.vertices, mesh.faces
    if not len(faces):
        content = "points or lines but no faces" if len(vertices) else "no vertices and no faces"
        raise FileError(f"{path}: holds {content}; inim needs a triangle mesh")
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise FileError(
            f"{path}: vertex {int(bad.argmax())} is not finite; clean the mesh and export it again"
        )
    reach = np.abs(vertices).max(initial=0)
    if reach > _MOST_EXTENT:
        raise FileError(
            f"{path}: coordinates reach {reach:.3g}; the file is damaged, or scale it down first"
        )
    check_indices(path, faces, len(vertices))


def check_indices(path: Path, corners: np.ndarray, count: int) -> None:
    """Raise `FileError` unless all corners of faces are among `count` vertices."""
    low, high = int(corners.min(initial=0)), int(corners.max(initial=0))
    if low < 0 or high >= count:
        raise FileError(
            f"{path}: a face refers to vertex {low if low < 0 else high}, but there are "
            f"{count} (0 to {count - 1}); the file is damaged, export it again"
        )


# Steps of coordinates that are visible, as a share of the extent.
_COARSE = 1e-4


def coarse_text(vertices: np.ndarray) -> str:
    """Words on coordinates, (n, 3), that float32 cannot tell apart; empty if it can."""
    reach = float(np.abs(vertices).max())
    extent = float(np.ptp(vertices.astype(np.float64), axis=0).max())
    step = float(np.spacing(np.float32(reach)))
    if step <= _COARSE * extent:
        return ""
    return (
        f"its coordinates reach {reach:.4g}, where 32-bit numbers have steps of {step:.2g}, and it "
        f"is {extent:.4g} large"
    )


def face_areas(vertices: np.ndarray, faces: np.ndarray) -> Iterator[np.ndarray]:
    """Areas of faces in float64, block by block."""
    for start in range(0, len(faces), _FACES_AT_ONCE):
        block = faces[start : start + _FACES_AT_ONCE]
        a, b, c = (vertices[block[:, k]].astype(np.float64) for k in range(3))
        yield np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def has_area(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """True if any face has an area."""
    extent = float(np.ptp(vertices.astype(np.float64), axis=0).max())
    least = _LEAST_AREA * extent**2
    return any(bool((2 * area > least).any()) for area in face_areas(vertices, faces))


def bounds(meshes: Sequence[Mesh]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) float64 of the vertices in faces."""
    used = [mesh.vertices[np.unique(mesh.faces)] for mesh in meshes]
    low = np.min([points.min(axis=0) for points in used], axis=0)
    return low.astype(float), np.max([points.max(axis=0) for points in used], axis=0).astype(float)


def first_line(error: BaseException) -> str:
    """First line of another library's message, printable and short."""
    text = next(iter(str(error).splitlines()), "") or type(error).__name__
    return printable(text)[:120]


def parse_numbers(text: bytes) -> np.ndarray | None:
    """All whitespace-separated numbers of a text as float64; None if anything else is there."""
    try:
        with warnings.catch_warnings():
            # Older NumPy warns at the first token that is no number, newer NumPy raises.
            warnings.simplefilter("error", DeprecationWarning)
            numbers: np.ndarray = np.fromstring(text.decode("ascii"), np.float64, sep=" ")
            return numbers
    except (ValueError, DeprecationWarning):
        return None


# Edges that turn by more stay sharp: drapery and hair stay crisp, scan facets vanish.
_CREASE_DEG = 50.0


def add_vertex_normals(mesh: Mesh, crease_deg: float = _CREASE_DEG) -> Mesh:
    """Add vertex normals to a mesh without them: smooth, except at hard edges.

    Corners that meet at a vertex share a normal when a fan of faces, each turning by less than
    `crease_deg` from the next, joins them; each such group becomes one vertex. Normals are means
    weighted by area. Vertices at one place are one for this purpose, so STL and texture seams
    come out smooth; faces without area are dropped.
    """
    if mesh.normals is not None:
        length = np.linalg.norm(mesh.normals, axis=1, keepdims=True)
        return replace(mesh, normals=(mesh.normals / length).astype(np.float32), attributes={})
    points, faces = mesh.vertices.astype(np.float64), mesh.faces.astype(np.int64)
    a, b, c = (points[faces[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)
    has_area = np.linalg.norm(area, axis=1) > 0
    faces, area = faces[has_area], area[has_area]
    place = np.unique(mesh.vertices, axis=0, return_inverse=True)[1].reshape(-1)
    group = _fans(place[faces], area, np.cos(np.radians(crease_deg)))
    corner = faces.reshape(-1)
    key = group * len(mesh.vertices) + corner
    _, first, index = np.unique(key, return_index=True, return_inverse=True)
    normals = corner[first]
    return replace(
        mesh,
        vertices=mesh.vertices[normals],
        faces=index.reshape(-1, 3).astype(np.uint32),
        normals=_mean_normals(group, first, area),
        uv=None if mesh.uv is None else mesh.uv[normals],
        color=None if mesh.color is None else mesh.color[normals],
        attributes={},
    )


def _mean_normals(group: np.ndarray, first: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Unit normals (k, 3) of the groups that the corners `first` (k,) belong to."""
    weights = np.repeat(area, 3, axis=0)
    total = np.stack([np.bincount(group, weights[:, k], len(group)) for k in range(3)], axis=1)
    normals = total[group[first]]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    # A fan folded onto itself may cancel: its first face speaks for it.
    normals = np.where(length > 1e-12 * np.abs(area).max(), normals, weights[first])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    unit: np.ndarray = normals.astype(np.float32)
    return unit


def _fans(places: np.ndarray, area: np.ndarray, least_cosine: float) -> np.ndarray:
    """Group number of each corner (3 m,), given the places (m, 3) and face vectors (m, 3)."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    unit = area / np.linalg.norm(area, axis=1, keepdims=True)
    start, end = places.reshape(-1), np.roll(places, -1, axis=1).reshape(-1)
    key = np.minimum(start, end) * (int(places.max()) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    previous, two = order[:-1], order[1:]
    smooth = (key[previous] == key[two]) & (
        np.einsum("ij,ij->i", unit[previous // 3], unit[two // 3]) >= least_cosine
    )
    previous, two = previous[smooth], two[smooth]
    after = np.roll(np.arange(start.size).reshape(-1, 3), -1, axis=1).reshape(-1)
    along = start[previous] == start[two]
    left = np.concatenate([previous, after[previous]])
    right = np.concatenate([np.where(along, two, after[two]), np.where(along, after[two], two)])
    shape = (start.size, start.size)
    graph = coo_matrix((np.ones(left.size, bool), (left, right)), shape=shape)
    # Numbers grow with the smallest corner of a fan.
    group: np.ndarray = connected_components(graph, directed=False)[1]
    return group.astype(np.int64)
