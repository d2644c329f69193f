"""Reader and writer of PLY files that consist of triangles; trimesh reads the others.

Importing trimesh takes a third of a second, which scenes with PLY meshes need not pay.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inim.image.color import linear_from_srgb
from inim.render.meshes.triangle_mesh import Mesh, parse_numbers, usable_normals
from inim.system.errors import FileError
from inim.system.process.atomic_file import write_atomically

_LINE_BYTES = 2**16
_HEADER_BYTES = 16 * _LINE_BYTES
_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "long": "i8", "ulong": "u8", "half": "f2", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float16": "f2", "float32": "f4", "float64": "f8",
}  # fmt: skip


@dataclass(frozen=True)
class PlyElement:
    """One PLY element of fixed records, each list being a count and 3 items."""

    name: str
    count: int  #: Records declared.
    #: Name and NumPy type; a list `a` is `a.count`, `a.0`, `a.1`, `a.2`.
    fields: tuple[tuple[str, str], ...] = ()
    lists: tuple[str, ...] = ()


@dataclass(frozen=True)
class PlyHeader:
    """Header of a PLY file."""

    order: str  #: NumPy's sign for the byte order; "=" for text.
    elements: tuple[PlyElement, ...]
    comments: tuple[str, ...]
    size: int  #: Bytes up to the body.

    @property
    def is_text(self) -> bool:
        """True if the body is text."""
        return self.order == "="


def is_ply(data: bytes) -> bool:
    """True if the content opens as a PLY file."""
    return data[:3] == b"ply"


def ply_header(path: Path, data: bytes) -> PlyHeader:
    """Parse the header of a PLY file.

    Raises `FileError`: the header is damaged.
    """
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
    names = {name for name, _ in element.fields}
    if names & {name for name, _ in fields}:
        raise FileError(f"{path}: PLY property {words[-1][:40]!r} is there twice; damaged")
    return PlyElement(element.name, element.count, (*element.fields, *fields), lists)


_NORMAL_NAMES = (("nx", "ny", "nz"),)
_UV_NAMES = (("u", "v"), ("texture_u", "texture_v"), ("s", "t"))
_COLOR_NAMES = (("r", "g", "b"), ("red", "green", "blue"))

_Columns = dict[str, np.ndarray]
_Names = tuple[tuple[str, ...], ...]
# Last letters of the columns that make an attribute, and the end of its name, as Mitsuba has them.
_CHANNELS = {"xyz": "", "rgb": "_color", "012": "", "123": ""}


def read_ply(path: Path, data: bytes, *, materials: bool = True) -> Mesh | None:
    """Read the mesh of a PLY of triangles.

    * `path`: for messages.
    * `data`: content of the file.
    * `materials`: whether a picture that the file names is needed.

    Returns None for other polygons, and where a picture is needed: trimesh reads these.

    Raises `FileError`: the file is damaged.
    """
    header = ply_header(path, data)
    if "tristrips" in {element.name for element in header.elements}:
        raise FileError(f"{path}: has triangle strips; open it in MeshLab, and export triangles")
    pictures = [comment for comment in header.comments if comment.startswith("TextureFile")]
    if materials and len(pictures) > 1:
        raise FileError(f"{path}: has {len(pictures)} pictures; open it in MeshLab, and export OBJ")
    columns = columns_of(data, header)
    if columns is None:
        _check_length(path, data, header)
        return None
    if not {"vertex", "face"} <= columns.keys():
        return None
    vertex, face = columns["vertex"], columns["face"]
    uv = _stack_columns(vertex, _UV_NAMES)
    if materials and uv is not None and pictures:
        return None
    vertices, faces = _geometry(path, vertex, face)
    normals = usable_normals(_stack_columns(vertex, _NORMAL_NAMES))
    kinds = {element.name: dict(element.fields) for element in header.elements}
    attributes = _attributes("vertex", vertex, kinds["vertex"])
    attributes |= _attributes("face", face, kinds["face"])
    color = attributes.pop("vertex_color", None)
    return Mesh(vertices, faces, normals, uv, color, None, path.stem, attributes)


def _check_length(path: Path, data: bytes, header: PlyHeader) -> None:
    """Raise `FileError` where a file has fewer bytes than its records take, with empty lists."""
    least = 0
    for element in header.elements:
        items = {f"{name}.{k}" for name in element.lists for k in range(3)}
        codes = [code for name, code in element.fields if name not in items]
        size = 2 * len(codes) if header.is_text else sum(np.dtype(code).itemsize for code in codes)
        least += element.count * size
    if least > len(data) - header.size + 1:
        raise FileError(f"{path}: declares more than its {len(data)} bytes; it is cut short")


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
    numbers = parse_numbers(data[header.size :])
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


def _geometry(path: Path, vertex: _Columns, face: _Columns) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) float32 and faces (m, 3) int64."""
    key = next((k for k in ("vertex_index", "vertex_indices") if f"{k}.count" in face), None)
    if key is None or not {"x", "y", "z"} <= vertex.keys():
        raise FileError(f"{path}: the PLY has no x, y, z or no vertex_indices; export it again")
    corners = [face[f"{key}.{k}"] for k in range(3)]
    if any(c.dtype.kind == "f" and (c != np.floor(c)).any() for c in corners):
        raise FileError(f"{path}: face indices are not whole numbers; export it again")
    with np.errstate(over="ignore"):  # beyond float32's range is infinite: refused later
        vertices = np.stack([vertex[name] for name in "xyz"], axis=1).astype(np.float32)
    return vertices, np.stack(corners, axis=1).astype(np.int64)


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
