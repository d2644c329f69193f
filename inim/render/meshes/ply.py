"""Reader and writer of PLY files.

trimesh needs one line per record of a text, drops attributes, and trusts that all lists are as long
as the first. Importing it takes a third of a second, which scenes with PLY meshes need not pay.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from inim.image.color import linear_from_srgb
from inim.render.meshes.companions import Companions
from inim.render.meshes.polygons import triangulate
from inim.render.meshes.triangle_mesh import (
    Mesh,
    check_indices,
    parse_numbers,
    usable_normals,
)
from inim.system.errors import FileError
from inim.system.process.atomic_file import write_atomically

_HEADER_BYTES = 2**20
# Largest whole numbers that all fit in float64.
_MOST_CORNER = 2**53
# Items of one list.
_MOST_ITEMS = 2**16
_END = b"\nend_header"
_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "long": "i8", "ulong": "u8", "half": "f2", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float16": "f2", "float32": "f4", "float64": "f8",
}  # fmt: skip


class PlyProperty(NamedTuple):
    """Property of an element, by NumPy types; a list has a type of its counts."""

    name: str
    type: str
    count_type: str = ""


@dataclass(frozen=True)
class PlyElement:
    """Element of a PLY file."""

    name: str
    count: int  #: Records declared.
    properties: list[PlyProperty] = field(default_factory=list)

    @property
    def fields(self) -> list[tuple[str, str]]:
        """Names and NumPy types."""
        return [(own.name, own.type) for own in self.properties]

    @property
    def lists(self) -> list[PlyProperty]:
        """Properties that are lists."""
        return [own for own in self.properties if own.count_type]


class Ragged(NamedTuple):
    """Lists of a property: their lengths, (records,), and all of their items, (items,)."""

    counts: np.ndarray
    items: np.ndarray


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
                own = PlyProperty(name.lower(), _TYPES[item], _TYPES[count])
                elements[-1].properties.append(own)
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append(PlyProperty(_property_name(name), _TYPES[kind]))
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


def _property_name(name: str) -> str:
    """A usual name in lower case; some programs write colours as ``diffuse_red``."""
    usual = name.lower().removeprefix("diffuse_")
    return usual if usual in _USUAL else name


_NORMAL_NAMES = (("nx", "ny", "nz"),)
_UV_NAMES = (("u", "v"), ("texture_u", "texture_v"), ("s", "t"))
_COLOR_NAMES = (("r", "g", "b"), ("red", "green", "blue"))

_USUAL = {"x", "y", "z", *sum((*_NORMAL_NAMES, *_UV_NAMES, *_COLOR_NAMES), ())}
_Columns = dict[str, Any]
_Names = tuple[tuple[str, ...], ...]
# Last letters of the columns that make an attribute, and the end of its name, as Mitsuba has them.
_CHANNELS = {"xyz": "", "rgb": "_color", "012": "", "123": ""}


def read_ply(
    path: Path, data: bytes, warn: Callable[[str], object], *, materials: bool = True
) -> Mesh:
    """Read the mesh of a PLY of polygons.

    * `path`: path of the file, next to its companions.
    * `data`: content of the file.
    * `warn`: called with a line on content that is not read, if materials are needed.
    * `materials`: whether colours and a picture that the file names are needed.

    Raises `FileError`: the file is damaged, or has no faces.
    """
    header = ply_header(path, data)
    kinds = {element.name: dict(element.fields) for element in header.elements}
    if "tristrips" in kinds:
        raise FileError(f"{path}: has triangle strips; open it in MeshLab, and export triangles")
    comments = [comment.split(None, 1) for comment in header.comments if comment.strip()]
    pictures = [words[1:] for words in comments if words[0].lower() == "texturefile"]
    if materials and len(pictures) > 1:
        raise FileError(f"{path}: has {len(pictures)} pictures; open it in MeshLab, and export OBJ")
    columns = columns_of(data, header)
    if columns is None:
        raise FileError(f"{path}: its length does not match its header; it is cut short or damaged")
    vertex, face = columns.get("vertex", {}), columns.get("face", {})
    vertices, corners, counts = _geometry(path, vertex, face)
    if (counts == 3).all():
        triangles, polygon = np.arange(len(corners)).reshape(-1, 3), np.arange(len(counts))
    else:
        triangles, polygon = triangulate(vertices[corners], counts)
    faces = corners[triangles]
    normals = usable_normals(_stack_columns(vertex, _NORMAL_NAMES))
    uv = _stack_columns(vertex, _UV_NAMES)
    attributes = _attributes("vertex", vertex, kinds.get("vertex", {}))
    of_faces = _attributes("face", face, kinds["face"])
    attributes |= {name: values[polygon] for name, values in of_faces.items()}
    color, texture, name = attributes.pop("vertex_color", None), None, path.stem
    if not materials:
        return Mesh(vertices, faces, normals, uv, color, None, name, attributes)
    of_face = attributes.pop("face_color", None)
    lost = _unread(header, vertex, face)
    lost += ["colours of faces"] * (of_face is not None and color is not None)
    wedges = _wedges(face, counts)
    if pictures:
        companions = Companions(path)
        texture = companions.picture("".join(pictures[0]))
        if texture is not None and uv is None and wedges is None:
            texture, lost = None, [*lost, "the picture, for lack of texture coordinates"]
        if texture is not None and (color is not None or of_face is not None):
            color, of_face, lost = None, None, [*lost, "colours next to the picture"]
        for text in companions.losses():
            warn(f"{path}: {text}")
    if lost:
        warn(f"{path}: not read: {', '.join(lost)}")
    if texture is not None and wedges is not None:  # every corner has coordinates of its own
        return Mesh(vertices[corners], triangles, None, wedges, None, texture, name)
    if color is None and of_face is not None:
        color = np.repeat(_unit(of_face), 3, axis=0)
        own = np.arange(faces.size).reshape(-1, 3)
        return Mesh(vertices[faces.ravel()], own, None, None, color, None, name)
    if color is not None:
        color = _unit(color)
    return Mesh(vertices, faces, normals, uv, color, texture, name)


def _unit(color: np.ndarray) -> np.ndarray:
    """Colours from 0 to 1; some programs write whole numbers up to 255 as floats."""
    return color if color.max(initial=0) <= 1 else linear_from_srgb(np.clip(color / 255, 0, 1))


def _wedges(face: _Columns, counts: np.ndarray) -> np.ndarray | None:
    """Texture coordinates of corners, (corners, 2) float32."""
    own = face.get("texcoord")
    if not isinstance(own, Ragged) or not np.array_equal(own.counts, 2 * counts):
        return None
    return np.nan_to_num(own.items.astype(np.float32)).reshape(-1, 2)


def _unread(header: PlyHeader, vertex: _Columns, face: _Columns) -> list[str]:
    """Elements and properties that no mesh has, except opacities of one."""
    used_names = _USUAL | {"vertex_index", "vertex_indices", "flags", "texcoord", "texnumber"}
    unread = [
        f"{e.count} of {e.name}"
        for e in header.elements
        if e.name not in ("vertex", "face") and e.count
    ]
    for element, columns in (("vertex", vertex), ("face", face)):
        for name, values in columns.items():
            is_opaque = name in ("alpha", "a") and np.min(values, initial=255) in (1, 255)
            if name not in used_names and not is_opaque:
                unread.append(f"{name} of each {element}")
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
    """Columns by element and property, lists as `Ragged`; None where the length is another.

    Numbers of a text are float64.
    """
    is_text = header.order == "="
    body: Any = _numbers_of(data, header) if is_text else memoryview(data)[header.size :]
    if body is None:
        return None
    tables, start = {}, 0
    for element in header.elements:
        read_records = _text_records if is_text else _binary_records
        if element.count > len(body):  # a record takes a number at least
            return None
        result = read_records(body, start, element, header.order)
        if result is None:
            return None
        tables[element.name], start = result
    return tables if start == len(body) else None


def _numbers_of(data: bytes, header: PlyHeader) -> np.ndarray | None:
    """Numbers of a text body, without its comments."""
    body = data[header.size :]
    if b"comment" in body:
        lines = body.replace(b"\r", b"\n").split(b"\n")
        body = b"\n".join(line for line in lines if not line.startswith(b"comment"))
    return parse_numbers(body)


def _text_records(
    numbers: np.ndarray, start: int, element: PlyElement, _: str
) -> tuple[_Columns, int] | None:
    """Columns of an element from the numbers of a text, and where the next element starts."""
    lengths = _lengths(element, lambda place: numbers[start + place : start + place + 1])
    width = sum(lengths) if lengths is not None else 0
    if lengths is None or start + element.count * width > len(numbers):
        return _walk_text(numbers, start, element)
    rows = numbers[start : start + element.count * width].reshape(element.count, width)
    columns, place = {}, 0
    for own, length in zip(element.properties, lengths, strict=True):
        values = rows[:, place : place + length]
        if own.count_type and (values[:, 0] != length - 1).any():
            return _walk_text(numbers, start, element)
        columns[own.name] = _column(own, values)
        place += length
    return columns, start + rows.size


def _lengths(element: PlyElement, at: Callable[[int], Any]) -> list[int] | None:
    """Numbers that each property takes in the first record; `at`: returns a number at a place."""
    lengths: list[int] = []
    for own in element.properties:
        length = 1
        if own.count_type and element.count:
            count = at(sum(lengths))
            if not len(count) or not 0 <= count[0] < _MOST_ITEMS:
                return None
            length += int(count[0])
        lengths.append(length)
    return lengths


def _column(own: PlyProperty, values: np.ndarray) -> Any:
    """Column of a property from its numbers in each record, (records, length)."""
    if not own.count_type:
        return values[:, 0]
    counts = np.full(len(values), values.shape[1] - 1, np.int64)
    return Ragged(counts, values[:, 1:].reshape(-1))


def _walk_text(numbers: np.ndarray, start: int, element: PlyElement) -> tuple[_Columns, int] | None:
    """Columns of an element of a text whose lists have different lengths; see `_text_records`."""
    places: dict[str, list[int]] = {own.name: [] for own in element.properties}
    counts: dict[str, list[int]] = {own.name: [] for own in element.lists}
    for _ in range(element.count):
        for own in element.properties:
            if start >= len(numbers):
                return None
            if own.count_type:
                count = numbers[start]
                start += 1
                if not 0 <= count <= len(numbers) - start:
                    return None
                counts[own.name].append(int(count))
                places[own.name].extend(range(start, start + int(count)))
                start += int(count)
            else:
                places[own.name].append(start)
                start += 1
    columns: _Columns = {}
    for name, own_places in places.items():
        values = numbers[np.array(own_places, np.int64)]
        columns[name] = Ragged(np.array(counts[name]), values) if name in counts else values
    return columns, start


def _binary_records(
    body: memoryview, start: int, element: PlyElement, order: str
) -> tuple[_Columns, int] | None:
    """Columns of an element from a binary body, and where the next element starts."""
    fields: list[Any] = []
    size = 0
    for own in element.properties:
        if not own.count_type:
            fields.append((own.name, order + own.type))
        else:
            count_type = np.dtype(order + own.count_type)
            first = body[start + size : start + size + count_type.itemsize]
            if element.count and len(first) < count_type.itemsize:
                return None
            count = int(np.frombuffer(first, count_type)[0]) if element.count else 0
            if not 0 <= count < _MOST_ITEMS:
                return _walk_binary(body, start, element, order)
            fields += [(f"{own.name}.count", count_type)]
            fields += [(own.name, order + own.type, (count,))]
        size = np.dtype(fields).itemsize
    part = body[start : start + element.count * size]
    if len(part) < element.count * size:
        return _walk_binary(body, start, element, order) if element.lists else None
    table = np.frombuffer(part, fields, element.count)
    columns: _Columns = {}
    for own in element.properties:
        columns[own.name] = table[own.name]
        if own.count_type:
            counts = table[f"{own.name}.count"].astype(np.int64)
            width = table[own.name].shape[1]
            if (counts != width).any():
                return _walk_binary(body, start, element, order)
            columns[own.name] = Ragged(counts, table[own.name].reshape(-1))
    return columns, start + len(part)


def _walk_binary(
    body: memoryview, start: int, element: PlyElement, order: str
) -> tuple[_Columns, int] | None:
    """Columns of a binary element whose lists have different lengths; see `_binary_records`."""
    places: dict[str, list[int]] = {own.name: [] for own in element.properties}
    counts: dict[str, list[int]] = {own.name: [] for own in element.lists}
    sizes = {own.name: np.dtype(own.type).itemsize for own in element.properties}
    byte_order: Any = "big" if order == ">" else "little"
    for _ in range(element.count):
        for own in element.properties:
            size, count = sizes[own.name], 1
            if own.count_type:
                width = np.dtype(own.count_type).itemsize
                count = int.from_bytes(body[start : start + width], byte_order)
                start += width
                if count * size > len(body) - start:
                    return None
                counts[own.name].append(count)
            places[own.name].extend(range(start, start + count * size, size))
            start += count * size
            if start > len(body):
                return None
    octets = np.frombuffer(body, np.uint8)
    columns: _Columns = {}
    for own in element.properties:
        index = np.array(places[own.name], np.int64)[:, None] + np.arange(sizes[own.name])
        values = np.ascontiguousarray(octets[index]).view(order + own.type).reshape(-1)
        is_list = own.name in counts
        columns[own.name] = Ragged(np.array(counts[own.name]), values) if is_list else values
    return columns, start


def _geometry(
    path: Path, vertex: _Columns, face: _Columns
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (n, 3), float32 or float64; corners of all faces int64; corners of each face."""
    if not vertex or not len(next(iter(vertex.values()))):
        raise FileError(f"{path}: holds no vertices and no faces; inim needs a triangle mesh")
    own = next((face[k] for k in ("vertex_index", "vertex_indices") if k in face), None)
    if own is None or not len(own.counts):
        raise FileError(f"{path}: holds points or lines but no faces; inim needs a triangle mesh")
    if not isinstance(own, Ragged) or not {"x", "y", "z"} <= vertex.keys():
        raise FileError(f"{path}: the PLY has no x, y, z or no vertex_indices; export it again")
    corners = own.items
    if corners.dtype.kind == "f" and (corners != np.floor(corners)).any():
        raise FileError(f"{path}: face indices are not whole numbers; export it again")
    if corners.dtype.kind == "f" and (np.abs(corners) > _MOST_CORNER).any():
        raise FileError(f"{path}: a face refers to vertex {corners.max():.3g}; export it again")
    vertices = np.stack([vertex[name] for name in "xyz"], axis=1)
    kind = np.float64 if vertices.dtype.itemsize > 4 else np.float32
    corners = corners.astype(np.int64)
    check_indices(path, corners, len(vertices))
    return vertices.astype(kind), corners, own.counts


def _present(columns: _Columns, groups: _Names) -> tuple[str, ...] | None:
    """The first group of names that is wholly there."""
    return next((names for names in groups if set(names) <= columns.keys()), None)


def _stack_columns(columns: _Columns, groups: _Names) -> np.ndarray | None:
    scalars = {name: own for name, own in columns.items() if not isinstance(own, Ragged)}
    names = _present(scalars, groups)
    if names is None:
        return None
    return np.nan_to_num(np.stack([columns[n] for n in names], axis=1).astype(np.float32))


def _attributes(owner: str, columns: _Columns, kinds: dict[str, str]) -> dict[str, np.ndarray]:
    """Colours and other attributes by the names that Mitsuba gives them, (n, 3) or (n, 1) float32.

    Floats are linear; integers are sRGB.
    """
    groups = {f"{owner}_color": names} if (names := _present(columns, _COLOR_NAMES)) else {}
    stems: dict[str, str] = {}
    for name in (name for name, values in columns.items() if not isinstance(values, Ragged)):
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
