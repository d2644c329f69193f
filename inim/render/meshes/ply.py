"""Reader and writer of PLY files that consist of triangles; trimesh reads the others.

trimesh needs one line per record of a text, drops attributes, and trusts that all lists are as long
as the first. Importing it takes a third of a second, which scenes with PLY meshes need not pay.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from inim.image.color import linear_from_srgb
from inim.render.meshes.triangle_mesh import Mesh, parse_numbers, usable_normals
from inim.system.errors import FileError
from inim.system.process.atomic_file import write_atomically

_HEADER_BYTES = 2**20
_END = b"\nend_header"
_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "long": "i8", "ulong": "u8", "half": "f2", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float16": "f2", "float32": "f4", "float64": "f8",
}  # fmt: skip


@dataclass(frozen=True)
class PlyElement:
    """PLY element of fixed records, in which each list is a count and 3 items."""

    name: str
    count: int  #: Records declared.
    #: Name and NumPy type; a list `a` is `a.count`, `a.0`, `a.1`, `a.2`.
    fields: list[tuple[str, str]] = field(default_factory=list)
    lists: list[str] = field(default_factory=list)


class PlyHeader(NamedTuple):
    """Header of a PLY file."""

    order: str  #: NumPy's sign for the byte order; "=" for text.
    elements: list[PlyElement]
    comments: list[str]
    size: int  #: Bytes up to the body.


def is_ply(data: bytes) -> bool:
    """True if the content opens as a PLY file."""
    return data[:3] == b"ply"


def ply_header(path: Path, data: bytes) -> PlyHeader:
    """Parse the header of a PLY file.

    Raises `FileError`: the header is damaged.
    """
    end = data.find(_END, 0, _HEADER_BYTES)
    size = data.find(b"\n", end + len(_END), _HEADER_BYTES) + 1
    if end < 0 or not size:
        raise FileError(f"{path}: the PLY header has no end; the file is damaged")
    order, comments = "", []
    elements: list[PlyElement] = []
    for line in data[:end].decode("latin-1").split("\n"):
        match line.split():
            case ["format", name, "1.0"] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, count] if count.isdecimal() and len(count) < 20:
                elements.append(PlyElement(name, int(count)))
            case ["property", "list", count, item, name] if elements and {count, item} <= {*_TYPES}:
                items = [(f"{name}.{k}", _TYPES[item]) for k in range(3)]
                elements[-1].fields.extend([(f"{name}.count", _TYPES[count]), *items])
                elements[-1].lists.append(name)
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].fields.append((name, _TYPES[kind]))
            case [] | ["ply"] | ["obj_info", *_]:
                pass
            case ["comment", *words]:
                comments.append(" ".join(words))
            case words:
                text = " ".join(words)[:60]
                raise FileError(f"{path}: PLY header line {text!r} makes no sense; export it again")
    names = [[element.name for element in elements]]
    names += [[name for name, _ in element.fields] for element in elements]
    if not order or any(len(set(group)) < len(group) for group in names):
        raise FileError(f"{path}: the PLY header lacks a format or has a name twice; damaged")
    return PlyHeader(order, elements, comments, size)


_NORMAL_NAMES = (("nx", "ny", "nz"),)
_UV_NAMES = (("u", "v"), ("texture_u", "texture_v"), ("s", "t"))
_COLOR_NAMES = (("r", "g", "b"), ("red", "green", "blue"))

_Columns = dict[str, np.ndarray]
_Names = tuple[tuple[str, ...], ...]
# Last letters of the columns that make an attribute, and the end of its name, as Mitsuba has them.
_CHANNELS = {"xyz": "", "rgb": "_color", "012": "", "123": ""}


def read_ply(
    path: Path, data: bytes, warn: Callable[[str], object], *, materials: bool = True
) -> Mesh | None:
    """Read the mesh of a PLY of triangles.

    * `path`: for messages.
    * `data`: content of the file.
    * `warn`: called with a line on content that is not read, if materials are needed.
    * `materials`: whether colours and a picture that the file names are needed.

    Returns None for other polygons, and where a picture is needed: trimesh reads these.

    Raises `FileError`: the file is damaged.
    """
    header = ply_header(path, data)
    kinds = {element.name: dict(element.fields) for element in header.elements}
    if "tristrips" in kinds:  # trimesh reads their vertices as points
        raise FileError(f"{path}: has triangle strips; open it in MeshLab, and export triangles")
    pictures = [comment for comment in header.comments if comment.startswith("TextureFile")]
    if materials and len(pictures) > 1:
        raise FileError(f"{path}: has {len(pictures)} pictures; open it in MeshLab, and export OBJ")
    # A number takes a byte at least, and a list may be empty.
    if sum(e.count * (len(e.fields) - 3 * len(e.lists)) for e in header.elements) > len(data):
        raise FileError(f"{path}: declares more than its {len(data)} bytes; it is cut short")
    columns = columns_of(data, header)
    if columns is None or not {"vertex", "face"} <= columns.keys():
        return None
    vertex, face = columns["vertex"], columns["face"]
    uv = _stack_columns(vertex, _UV_NAMES)
    if materials and uv is not None and pictures:
        return None
    vertices, faces = _geometry(path, vertex, face)
    normals = usable_normals(_stack_columns(vertex, _NORMAL_NAMES))
    attributes = _attributes("vertex", vertex, kinds["vertex"])
    attributes |= _attributes("face", face, kinds["face"])
    color = attributes.pop("vertex_color", None)
    if materials and (unread := _unread(header)):
        warn(f"{path}: not read: {', '.join(unread)}")
    if materials and color is None and "face_color" in attributes:
        # Every face gets corners of its own.
        color = np.repeat(attributes.pop("face_color"), 3, axis=0)
        corner, faces = faces.ravel(), np.arange(faces.size).reshape(-1, 3)
        return Mesh(vertices[corner], faces, None, None, color, None, path.stem)
    return Mesh(vertices, faces, normals, uv, color, None, path.stem, attributes)


def _unread(header: PlyHeader) -> list[str]:
    """Elements and properties that no mesh has."""
    used_names = {
        name for groups in (_NORMAL_NAMES, _UV_NAMES, _COLOR_NAMES) for g in groups for name in g
    }
    used_names |= {"x", "y", "z", "vertex_index", "vertex_indices", "flags"}
    unread = [f"{e.count} of {e.name}" for e in header.elements
              if e.name not in ("vertex", "face") and e.count]  # fmt: skip
    for element in header.elements:
        if element.name in ("vertex", "face"):
            names = dict.fromkeys(name.partition(".")[0] for name, _ in element.fields)
            unread += [f"{name} of each {element.name}" for name in names if name not in used_names]
    return unread


def write_ply(path: Path, mesh: Mesh) -> None:
    """Write a binary PLY whose normals, `u` `v` and `vertex_color` Mitsuba 3.9 reads; atomic.

    Colours go out as floats `r`, `g`, `b`, which the `ply` shape groups as the mesh attribute
    `vertex_color`. `v` keeps growing upwards: set `flip_tex_coords` on the shape.
    """
    parts = [("xyz", mesh.vertices), (("nx", "ny", "nz"), mesh.normals)]
    parts += [("uv", mesh.uv), ("rgb", mesh.color)]
    present = [(names, array) for names, array in parts if array is not None]
    names = [name for group, _ in present for name in group]
    records = np.hstack([array for _, array in present]).astype("<f4")
    faces = np.empty(len(mesh.faces), [("count", "u1"), ("index", "<i4", 3)])
    faces["count"], faces["index"] = 3, mesh.faces
    end = [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    body = write_header(names, len(records), end) + records.tobytes() + faces.tobytes()
    write_atomically(path, lambda p: p.write_bytes(body))


def write_header(names: Iterable[str], vertices: int, end: Sequence[str] = ()) -> bytes:
    """Header of a binary PLY with vertices of floats, by their names; `end` are further lines."""
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {vertices}"]
    lines += [*(f"property float {name}" for name in names), *end, "end_header"]
    return ("\n".join(lines) + "\n").encode("ascii")


def columns_of(data: bytes, header: PlyHeader) -> dict[str, _Columns] | None:
    """Columns by element and property; None where lists are no triangles, or bytes are left.

    Integers of a text are floats.
    """
    is_text = header.order == "="
    body: Any = parse_numbers(data[header.size :]) if is_text else memoryview(data)[header.size :]
    if body is None:
        return None
    tables, start = {}, 0
    for element in header.elements:
        if is_text:
            fields = [(name, code if code[0] == "f" else "f8") for name, code in element.fields]
            size = element.count * len(fields)
        else:
            fields = [(name, header.order + code) for name, code in element.fields]
            size = element.count * np.dtype(fields).itemsize
        part, start = body[start : start + size], start + size
        if len(part) < size:
            return None
        if is_text:
            rows = part.reshape(element.count, len(fields)).T
            columns = {n: row.astype(code) for (n, code), row in zip(fields, rows, strict=True)}
        else:
            table = np.frombuffer(part, fields, element.count)
            columns = {name: table[name] for name, _ in fields}
        if any((columns[f"{name}.count"] != 3).any() for name in element.lists):
            return None
        tables[element.name] = columns
    return tables if start == len(body) else None


def _geometry(path: Path, vertex: _Columns, face: _Columns) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3), float32 or float64, and faces (m, 3) int64."""
    key = next((k for k in ("vertex_index", "vertex_indices") if f"{k}.count" in face), None)
    if key is None or not {"x", "y", "z"} <= vertex.keys():
        raise FileError(f"{path}: the PLY has no x, y, z or no vertex_indices; export it again")
    corners = np.stack([face[f"{key}.{k}"] for k in range(3)], axis=1)
    if corners.dtype.kind == "f" and (corners != np.floor(corners)).any():
        raise FileError(f"{path}: face indices are not whole numbers; export it again")
    vertices = np.stack([vertex[name] for name in "xyz"], axis=1)
    kind = np.float64 if vertices.dtype.itemsize > 4 else np.float32
    return vertices.astype(kind), corners.astype(np.int64)


def _present(columns: _Columns, groups: _Names) -> tuple[str, ...] | None:
    """The first group of names that is wholly there."""
    return next((names for names in groups if set(names) <= columns.keys()), None)


def _stack_columns(columns: _Columns, groups: _Names) -> np.ndarray | None:
    names = _present(columns, groups)
    if names is None:
        return None
    return np.nan_to_num(np.stack([columns[n] for n in names], axis=1).astype(np.float32))


def _attributes(owner: str, columns: _Columns, kinds: dict[str, str]) -> dict[str, np.ndarray]:
    """Colours and other attributes by the names that Mitsuba gives them, (n, 3) or (n, 1) float32.

    Floats are linear; integers are sRGB.
    """
    groups = {f"{owner}_color": names} if (names := _present(columns, _COLOR_NAMES)) else {}
    stems: dict[str, str] = {}
    for name in columns:
        stem, _, letter = name.rpartition("_")
        if stem and len(letter) == 1:
            stems[stem] = stems.get(stem, "") + letter
    for stem, letters in stems.items():
        for channels, end in _CHANNELS.items():
            if letters in (channels, channels[0]):
                groups[f"{owner}_{stem}{end}"] = tuple(f"{stem}_{c}" for c in letters)
    attributes = {}
    for name, names in groups.items():
        values = _stack_columns(columns, (names,))
        code = kinds[names[0]]  # columns of a text body are floats whatever was declared
        if values is not None:
            is_srgb = code[0] != "f"
            attributes[name] = linear_from_srgb(values / np.iinfo(code).max) if is_srgb else values
    return attributes
