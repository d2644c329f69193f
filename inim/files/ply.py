"""PLY in and out, in the record layout that Mitsuba expects: triangles, one record each.

Quads, mixed polygons and textured PLY are left to trimesh.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from inim.color import linear_from_srgb
from inim.errors import FileError
from inim.files.image import write_atomically
from inim.files.mesh_guard import check_indices
from inim.files.ply_header import PlyHeader, read_ply_header
from inim.files.text_numbers import numbers_in
from inim.files.triangle_mesh import Mesh, usable_normals

__all__ = ["check_ply", "read_ply", "write_ply"]

_NORMAL_NAMES = (("nx", "ny", "nz"),)
_UV_NAMES = (("u", "v"), ("texture_u", "texture_v"), ("s", "t"))
_COLOR_NAMES = (("r", "g", "b"), ("red", "green", "blue"))

_Columns = dict[str, np.ndarray]
_Names = tuple[tuple[str, ...], ...]


def read_ply(path: Path, data: bytes) -> list[Mesh] | None:
    """The mesh of a PLY in plain triangles, indices checked; None leaves the file to trimesh."""
    header = read_ply_header(path, data)
    columns = _columns(data, header)
    if columns is None:
        return None
    vertices, faces = _geometry(path, columns)
    check_indices(path, vertices, faces)
    vertex = columns["vertex"]
    uv = _stacked(vertex, _UV_NAMES)
    if uv is not None and any(c.startswith("TextureFile") for c in header.comments):
        return None  # trimesh finds the picture
    normals = usable_normals(_stacked(vertex, _NORMAL_NAMES))
    color = _color(header, vertex)
    return [Mesh(vertices, faces.astype(np.uint32), normals, uv, color, None, path.stem)]


def check_ply(path: Path, data: bytes) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Vertices and faces of a PLY that Mitsuba can read, or a FileError."""
    header = read_ply_header(path, data)
    columns = _columns(data, header)
    if columns is None or any(len(element.lists) > 1 for element in header.elements):
        raise FileError(
            f"{path}: not plain triangles, or its length does not match its header; Mitsuba "
            "cannot read it, convert it with `inim new-scene`"
        )
    for name, values in columns["vertex"].items():
        if name not in "xyz" and values.dtype.kind == "f" and not np.isfinite(values).all():
            raise FileError(f"{path}: vertex property {name!r} is not finite; export it again")
    yield _geometry(path, columns)


def write_ply(path: Path, mesh: Mesh) -> None:
    """Write a binary PLY whose normals, `u` `v` and `vertex_color` Mitsuba 3.9 reads; atomic.

    Colours go out as floats `r`, `g`, `b`, which the `ply` shape groups as the mesh attribute
    `vertex_color`. `v` keeps growing upwards: set `flip_tex_coords` on the shape.
    """
    parts = [("xyz", mesh.vertices), (("nx", "ny", "nz"), mesh.normals)]
    parts += [("uv", mesh.uv), ("rgb", mesh.color)]
    given = [(names, array) for names, array in parts if array is not None]
    names = [name for group, _ in given for name in group]
    records = np.hstack([array for _, array in given]).astype("<f4")
    faces = np.empty(len(mesh.faces), [("count", "u1"), ("index", "<i4", 3)])
    faces["count"], faces["index"] = 3, mesh.faces
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(records)}"]
    header += [f"property float {name}" for name in names]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    body = ("\n".join(header) + "\n").encode("ascii") + records.tobytes() + faces.tobytes()

    def save(temporary: Path) -> None:
        temporary.write_bytes(body)

    write_atomically(path, save)


def _columns(data: bytes, header: PlyHeader) -> dict[str, _Columns] | None:
    """Columns by element and property; None where the body is not triangles record by record."""
    tables = (_text_columns if header.is_text else _binary_columns)(data, header)
    if tables is None:
        return None
    for element in header.elements:
        columns = tables[element.name]
        if any((columns[f"{name}.count"] != 3).any() for name in element.lists):
            return None
    return tables


def _binary_columns(data: bytes, header: PlyHeader) -> dict[str, _Columns] | None:
    tables, offset = {}, header.size
    for element in header.elements:
        dtype = np.dtype([(name, header.order + code) for name, code in element.fields])
        if offset + dtype.itemsize * element.count > len(data):
            return None
        table = np.frombuffer(data, dtype, element.count, offset)
        tables[element.name] = {name: table[name] for name, _ in element.fields}
        offset += table.nbytes
    return tables if offset == len(data) else None


def _text_columns(data: bytes, header: PlyHeader) -> dict[str, _Columns] | None:
    numbers = numbers_in(data[header.size :])
    if numbers is None or numbers.size != sum(e.count * len(e.fields) for e in header.elements):
        return None
    tables, start = {}, 0
    for element in header.elements:
        width = len(element.fields)
        table = numbers[start : start + element.count * width].reshape(element.count, width)
        tables[element.name] = {
            name: table[:, k].astype(code) if code[0] == "f" else table[:, k]
            for k, (name, code) in enumerate(element.fields)
        }
        start += table.size
    return tables


def _geometry(path: Path, columns: dict[str, _Columns]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) float32 and faces (m, 3) int64, checked to be floats and integers."""
    vertex, face = columns["vertex"], columns["face"]
    key = next((k for k in ("vertex_index", "vertex_indices") if f"{k}.count" in face), None)
    if key is None or not {"x", "y", "z"} <= vertex.keys():
        raise FileError(f"{path}: the PLY has no x, y, z or no vertex_indices; export it again")
    if any(vertex[name].dtype.kind != "f" for name in "xyz"):
        raise FileError(f"{path}: x, y, z are integers, which Mitsuba misreads; export as float")
    corners = [face[f"{key}.{k}"] for k in range(3)]
    if any(c.dtype.kind == "f" and (c != np.floor(c)).any() for c in corners):
        raise FileError(f"{path}: face indices are not whole numbers; export it again")
    with np.errstate(over="ignore"):  # beyond float32's range is infinite: refused later
        vertices = np.stack([vertex[name] for name in "xyz"], axis=1).astype(np.float32)
    return vertices, np.stack(corners, axis=1).astype(np.int64)


def _present(columns: _Columns, groups: _Names) -> tuple[str, ...] | None:
    """The first group of names that is wholly there."""
    return next((names for names in groups if set(names) <= columns.keys()), None)


def _stacked(columns: _Columns, groups: _Names) -> np.ndarray | None:
    names = _present(columns, groups)
    if names is None:
        return None
    return np.nan_to_num(np.stack([columns[n] for n in names], axis=1).astype(np.float32))


def _color(header: PlyHeader, vertex: _Columns) -> np.ndarray | None:
    """Linear vertex colours: floats are linear, as Mitsuba takes them; integers are sRGB."""
    names, color = _present(vertex, _COLOR_NAMES), _stacked(vertex, _COLOR_NAMES)
    if names is None or color is None:
        return None
    # Columns of a text body are floats whatever was declared.
    fields = next(e.fields for e in header.elements if e.name == "vertex")
    code = dict(fields)[names[0]]
    return color.clip(0, 1) if code[0] == "f" else linear_from_srgb(color / np.iinfo(code).max)
