"""PLY in and out, in the record layout that Mitsuba expects: triangles, one record each.

The header's counts are held against the bytes there are before anything is read. Quads, mixed
polygons and textured PLY are left to trimesh.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inim.errors import FileError
from inim.files.image import write_atomically
from inim.files.triangle_mesh import Mesh, check_indices, numbers_in, usable_normals
from inim.image.color import linear_from_srgb

_LINE_BYTES = 2**16
_HEADER_BYTES = 16 * _LINE_BYTES
_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
# The type names that Mitsuba's PLY loader knows; trimesh knows no others.
_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "long": "i8", "ulong": "u8", "half": "f2", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float16": "f2", "float32": "f4", "float64": "f8",
}  # fmt: skip


@dataclass(frozen=True)
class PlyElement:
    """One PLY element as Mitsuba sees it: fixed records, each list being a count and 3 items.

    Attributes
    ----------
    name : str
    count : int
        Records declared.
    fields : tuple of (str, str)
        Name and NumPy type; a list `a` is `a.count`, `a.0`, `a.1`, `a.2`.
    lists : tuple of str
    """

    name: str
    count: int
    fields: tuple[tuple[str, str], ...] = ()
    lists: tuple[str, ...] = ()


@dataclass(frozen=True)
class PlyHeader:
    """What a PLY file says about its body.

    Attributes
    ----------
    order : str
        NumPy's sign for the byte order; "=" for text.
    elements : tuple of PlyElement
    comments : tuple of str
    size : int
        Bytes up to the body.
    """

    order: str
    elements: tuple[PlyElement, ...]
    comments: tuple[str, ...]
    size: int

    @property
    def is_text(self) -> bool:
        """Whether the body is text."""
        return self.order == "="


def is_ply(data: bytes) -> bool:
    """Mitsuba skips blank lines and comments before the `ply` line, so this does too."""
    lines = (line.split() for line in data[:_LINE_BYTES].split(b"\n", 256))
    first = next((words[0] for words in lines if words and words[0] != b"comment"), b"")
    return first == b"ply"


def sized_header(path: Path, data: bytes) -> PlyHeader:
    """The header of a PLY file whose bytes suffice for what it declares.

    Raises
    ------
    FileError
        The header makes no sense, or declares more than the file holds.
    """
    header = _parsed(path, data)
    for element in header.elements:
        if _least_bytes(element, header.is_text) > len(data) - header.size:
            raise FileError(
                f"{path}: declares {element.count} x {element.name}, but is only {len(data)} "
                "bytes long; it is cut short or damaged"
            )
    return header


def read_ply_header(path: Path, data: bytes) -> PlyHeader:
    """As `sized_header`, of a file of plain faces."""
    header = sized_header(path, data)
    names = {element.name for element in header.elements if element.count}
    if "tristrips" in names:
        raise FileError(f"{path}: holds triangle strips; export it as plain triangles")
    if "vertex" not in names or "face" not in names:
        what = "points but no faces" if "vertex" in names else "no vertices"
        raise FileError(f"{path}: holds {what}; inim needs a triangle mesh")
    return header


def _least_bytes(element: PlyElement, is_text: bool) -> int:
    """Fewest bytes that the declared records can take, lists being empty."""
    items = {f"{name}.{k}" for name in element.lists for k in range(3)}
    codes = [code for name, code in element.fields if name not in items]
    if is_text:
        return element.count * max(2 * len(codes), 1) - 1
    return element.count * max(sum(np.dtype(code).itemsize for code in codes), 1)


def _parsed(path: Path, data: bytes) -> PlyHeader:
    order, comments, offset = "", [], 0
    elements: list[PlyElement] = []
    while True:
        end = data.find(b"\n", offset, offset + _LINE_BYTES)
        if end < 0 or end > _HEADER_BYTES:
            raise FileError(f"{path}: the PLY header has no end; the file is damaged")
        words = data[offset:end].decode("latin-1").split()
        offset = end + 1
        match words:
            case ["end_header"]:
                break
            case ["format", name, "1.0"] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, count] if count.isdecimal() and len(count) < 20:
                elements.append(PlyElement(name, int(count)))
            case ["property", *rest] if elements:
                elements[-1] = _with_property(path, elements[-1], rest)
            case [] | ["ply"] | ["obj_info", *_]:
                pass
            case ["comment", *rest]:
                comments.append(" ".join(rest))
            case _:
                line = " ".join(words)[:60]
                raise FileError(f"{path}: PLY header line {line!r} makes no sense; export it again")
    if not order or len({element.name for element in elements}) < len(elements):
        raise FileError(f"{path}: the PLY header lacks a format or repeats an element; damaged")
    return PlyHeader(order, tuple(elements), tuple(comments), offset)


def _with_property(path: Path, element: PlyElement, words: list[str]) -> PlyElement:
    match words:
        case ["list", count, item, name] if count in _TYPES and item in _TYPES:
            fields = [(f"{name}.count", _TYPES[count])]
            fields += [(f"{name}.{k}", _TYPES[item]) for k in range(3)]
            lists = (*element.lists, name)
        case [kind, name] if kind in _TYPES:
            fields, lists = [(name, _TYPES[kind])], element.lists
        case _:
            raise FileError(f"{path}: PLY property {' '.join(words)[:60]!r} is unknown; damaged")
    known = {name for name, _ in element.fields}
    if known & {name for name, _ in fields}:
        raise FileError(f"{path}: PLY property {words[-1][:40]!r} is there twice; damaged")
    return PlyElement(element.name, element.count, (*element.fields, *fields), lists)


_NORMAL_NAMES = (("nx", "ny", "nz"),)
_UV_NAMES = (("u", "v"), ("texture_u", "texture_v"), ("s", "t"))
_COLOR_NAMES = (("r", "g", "b"), ("red", "green", "blue"))

_Columns = dict[str, np.ndarray]
_Names = tuple[tuple[str, ...], ...]


def read_ply(path: Path, data: bytes) -> list[Mesh] | None:
    """The mesh of a PLY in plain triangles, indices checked; None leaves the file to trimesh."""
    header = read_ply_header(path, data)
    columns = columns_of(data, header)
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
    columns = columns_of(data, header)
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
    write_atomically(path, lambda p: p.write_bytes(body))


def columns_of(data: bytes, header: PlyHeader) -> dict[str, _Columns] | None:
    """Columns by element and property; None where lists are no triangles, or bytes are left."""
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
