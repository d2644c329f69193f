"""Triangle meshes in and out: PLY, OBJ, STL and glTF read with suspicion, PLY written for Mitsuba.

Two doors. `read_mesh` gives arrays to convert; `check_mesh_file` says whether a file that a scene
names may go to Mitsuba as it is: its loaders trust counts and indices, and a PLY whose face index
is out of range ends the process. Triangle PLY is read here, in the record layout that Mitsuba
expects; every other layout goes through trimesh, after the declared counts were held against the
file's size.
"""

from __future__ import annotations

import json
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from inim.errors import FileError
from inim.formats.image import write_atomically

__all__ = ["SUFFIXES", "UNIT_MM", "Mesh", "check_mesh_file", "mesh_kind", "read_mesh", "write_ply"]

# Millimetres in one unit of length.
UNIT_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
SUFFIXES = (".ply", ".obj", ".stl", ".glb", ".gltf")

# Scans of a hundred million triangles are decimated before they are rendered.
_MOST_BYTES = 2**31
# Squares of coordinates must stay finite in float32 (largest 3.4e38).
_MOST_EXTENT = 1e15
# Area of a face against the square of the extent: below it, rounding of float64 products.
_LEAST_AREA = 1e-14
_MOST_TEXTURE_PIXELS = 2**26
# glTF accessors may share bytes (interleaved, instanced); beyond this factor it is a bomb.
_MOST_SHARING = 16
_MOST_GLTF_NODES = 100_000
_MOST_INSTANCED_FACES = 50_000_000
_HEADER_BYTES = 2**16
_BLOCK_BYTES = 2**22
# DEFLATE cannot shrink by more than this.
_MOST_DEFLATE = 1032
_SERIALIZED_MAGIC = 0x041C

# The type names that Mitsuba's PLY loader knows; trimesh knows no others.
_PLY_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "long": "i8", "ulong": "u8", "half": "f2", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float16": "f2", "float32": "f4", "float64": "f8",
}  # fmt: skip
_PLY_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_UV_NAMES = (("u", "v"), ("texture_u", "texture_v"), ("s", "t"))

# trimesh's colour for "nobody said"; a material of this colour says nothing.
_TRIMESH_GREY = (102, 102, 102)

_Columns = dict[str, np.ndarray]


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh in the unit and axes of the file it came from.

    Attributes
    ----------
    vertices : (n, 3) float32
    faces : (m, 3) uint32, counter-clockwise from outside
    normals : (n, 3) float32, unit length, or None
    uv : (n, 2) float32 or None; v grows upwards, row 0 of the texture is at v = 1
    color : (n, 3) float32 or None; **linear** RGB in 0..1 (8-bit PLY, OBJ and STL colours are
        sRGB and decoded, glTF's are linear already)
    texture : (h, w, 3) uint8 or None; sRGB, base colour
    name : str
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None = None
    uv: np.ndarray | None = None
    color: np.ndarray | None = None
    texture: np.ndarray | None = None
    name: str = ""


def read_mesh(path: Path) -> list[Mesh]:
    """Read every triangle mesh of a PLY, OBJ, STL, GLB or glTF file, node transforms applied.

    Raises
    ------
    FileError
        Missing, of another kind, damaged, without faces, or with declared sizes that the file
        cannot hold; one line naming the file and the cause.
    """
    path = Path(path)
    data = _bytes_of(path)
    kind = mesh_kind(path, data)
    meshes = _read_triangle_ply(path, data) if kind == "ply" else None
    if meshes is None:
        _GUARDS[kind](path, data)
        meshes = _read_with_trimesh(path, kind)
    for mesh in meshes:
        _check_indices(path, mesh.vertices, mesh.faces)
    if not any(_has_area(mesh.vertices, mesh.faces) for mesh in meshes):
        raise FileError(f"{path}: all faces have zero area; export the surface again")
    return meshes


def check_mesh_file(path: Path, plugin: str | None = None) -> None:
    """Refuse a mesh file that Mitsuba's `ply`, `obj` or `serialized` shape cannot take safely.

    Parameters
    ----------
    plugin : str or None
        The shape plugin that will read the file; None goes by the file's content.

    Raises
    ------
    FileError
        One line naming the file, the fault and the way out.
    """
    path = Path(path)
    data = _bytes_of(path)
    if plugin is None:
        plugin = "serialized" if data[:2] == struct.pack("<H", _SERIALIZED_MAGIC) else ""
        plugin = plugin or mesh_kind(path, data)
    if plugin not in _CHECKS:
        raise FileError(
            f"{path}: {plugin} is no mesh format of Mitsuba; convert it with `inim new-scene`"
        )
    for vertices, faces in _CHECKS[plugin](path, data):
        _check_indices(path, vertices, faces)
        if not _has_area(vertices, faces):
            raise FileError(f"{path}: all faces have zero area; export the surface again")


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


def mesh_kind(path: Path, data: bytes) -> str:
    """`ply`, `obj`, `stl`, `glb` or `gltf`: by the content first, by the suffix where text."""
    suffix = path.suffix.lower()
    start = data[:1024].lstrip()
    if _is_ply(data):
        return "ply"
    if start.startswith(b"glTF"):
        return "glb"
    if suffix == ".stl" or start[:5].lower() == b"solid" or _stl_fits(data):
        return "stl"
    if start.startswith(b"{") and b'"asset"' in data:
        return "gltf"
    if suffix == ".obj":
        return "obj"
    if suffix in SUFFIXES:
        raise FileError(f"{path}: is named {suffix} but its content is not; export it again")
    raise FileError(
        f"{path}: not a mesh that inim reads ({', '.join(SUFFIXES)}); convert it in Blender or "
        "MeshLab first"
    )


def _bytes_of(path: Path) -> bytes:
    try:
        if not path.is_file():
            raise FileError(f"{path}: no such file")
        size = path.stat().st_size
        if size > _MOST_BYTES:
            raise FileError(f"{path}: {size / 2**30:.1f} GiB; decimate the mesh below 2 GiB first")
        data = path.read_bytes()
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error.strerror or error})") from error
    if not data.strip(b" \t\r\n\0"):
        raise FileError(f"{path}: the file is empty; export the mesh again")
    return data


# --- What every mesh must satisfy ---------------------------------------------------------------


def _check_indices(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Finite, sane coordinates and 0 <= index < n, or a FileError."""
    if len(faces) == 0:
        what = "points or lines but no faces" if len(vertices) else "no vertices and no faces"
        raise FileError(f"{path}: holds {what}; inim needs a triangle mesh")
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise FileError(
            f"{path}: vertex {int(bad.argmax())} is not finite; clean the mesh and export it again"
        )
    low, high = int(faces.min()), int(faces.max())
    if low < 0 or high >= len(vertices):
        raise FileError(
            f"{path}: a face refers to vertex {low if low < 0 else high}, but there are "
            f"{len(vertices)} (0 to {len(vertices) - 1}); the file is damaged, export it again"
        )
    if np.abs(vertices).max() > _MOST_EXTENT:
        raise FileError(
            f"{path}: coordinates reach {np.abs(vertices).max():.3g}; the file is damaged, or "
            "scale it down first"
        )


def _has_area(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Whether any face is more than a line; stops at the first block that has one."""
    extent = float(np.ptp(vertices.astype(np.float64), axis=0).max())
    for start in range(0, len(faces), 65536):
        a, b, c = (vertices[faces[start : start + 65536, k]].astype(np.float64) for k in range(3))
        doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        if bool((doubled > _LEAST_AREA * extent**2).any()):
            return True
    return False


# --- PLY ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Element:
    """One PLY element as Mitsuba sees it: fixed records, each list being a count and 3 items."""

    name: str
    count: int
    fields: tuple[tuple[str, str], ...]
    lists: tuple[str, ...]

    def least_bytes(self, ascii_text: bool) -> int:
        """Fewest bytes that `count` records can take, lists being empty."""
        scalars = [f for f in self.fields if not f[0].partition(".")[2] or f[0].endswith(".count")]
        if ascii_text:
            return self.count * max(2 * len(scalars), 1) - 1
        return self.count * max(sum(np.dtype(code).itemsize for _, code in scalars), 1)


def _is_ply(data: bytes) -> bool:
    """Mitsuba skips blank lines and comments before the `ply` line, so this does too."""
    lines = (line.split() for line in data[:_HEADER_BYTES].split(b"\n", 256))
    first = next((words[0] for words in lines if words and words[0] != b"comment"), b"")
    return first == b"ply"


def _ply_header(path: Path, data: bytes) -> tuple[str, list[_Element], list[str], int]:
    """Format, elements, comments and the offset of the body."""
    order, elements, comments, offset = "", [], [], 0
    while True:
        end = data.find(b"\n", offset, offset + _HEADER_BYTES)
        if end < 0 or end > 16 * _HEADER_BYTES:
            raise FileError(f"{path}: the PLY header has no end; the file is damaged")
        words = data[offset:end].decode("latin-1").split()
        offset = end + 1
        match words:
            case ["end_header"]:
                break
            case ["format", name, "1.0"] if name in _PLY_ORDERS:
                order = name
            case ["element", name, count] if count.isdecimal() and len(count) < 20:
                elements.append(_Element(name, int(count), (), ()))
            case ["property", *rest] if elements:
                elements[-1] = _with_property(path, elements[-1], rest)
            case [] | ["ply"] | ["obj_info", *_]:
                pass
            case ["comment", *rest]:
                comments.append(" ".join(rest))
            case _:
                raise FileError(
                    f"{path}: PLY header line {' '.join(words)[:60]!r} makes no sense; export it "
                    "again"
                )
    names = [element.name for element in elements]
    if not order or len(set(names)) < len(names):
        raise FileError(f"{path}: the PLY header lacks a format or repeats an element; damaged")
    return order, elements, comments, offset


def _with_property(path: Path, element: _Element, words: list[str]) -> _Element:
    match words:
        case ["list", count, item, name] if count in _PLY_TYPES and item in _PLY_TYPES:
            fields = [(f"{name}.count", _PLY_TYPES[count])]
            fields += [(f"{name}.{k}", _PLY_TYPES[item]) for k in range(3)]
            lists = (*element.lists, name)
        case [kind, name] if kind in _PLY_TYPES:
            fields, lists = [(name, _PLY_TYPES[kind])], element.lists
        case _:
            raise FileError(f"{path}: PLY property {' '.join(words)[:60]!r} is unknown; damaged")
    known = {name for name, _ in element.fields}
    if known & {name for name, _ in fields}:
        raise FileError(f"{path}: PLY property {words[-1][:40]!r} is there twice; damaged")
    return _Element(element.name, element.count, (*element.fields, *fields), lists)


def _guard_ply(path: Path, data: bytes) -> None:
    """Refuse declared counts that the file has no bytes for, and files without faces."""
    order, elements, _, offset = _ply_header(path, data)
    for element in elements:
        if element.least_bytes(order == "ascii") > len(data) - offset:
            raise FileError(
                f"{path}: declares {element.count} x {element.name}, but is only {len(data)} "
                "bytes long; it is cut short or damaged"
            )
    names = {element.name for element in elements if element.count}
    if "tristrips" in names:
        raise FileError(f"{path}: holds triangle strips; export it as plain triangles")
    if "vertex" not in names or "face" not in names:
        what = "points but no faces" if "vertex" in names else "no vertices"
        raise FileError(f"{path}: holds {what}; inim needs a triangle mesh")


def _ply_columns(path: Path, data: bytes) -> tuple[dict[str, _Columns], list[str]] | None:
    """Columns by element and property; None where the body is not triangles record by record."""
    _guard_ply(path, data)
    order, elements, comments, offset = _ply_header(path, data)
    records = (
        _ascii_columns(data[offset:], elements)
        if order == "ascii"
        else _binary_columns(data, offset, elements, _PLY_ORDERS[order])
    )
    if records is None:
        return None
    for element in elements:
        columns = records[element.name]
        if any((columns[f"{name}.count"] != 3).any() for name in element.lists):
            return None
    return records, comments


def _binary_columns(
    data: bytes, offset: int, elements: list[_Element], order: str
) -> dict[str, _Columns] | None:
    tables = {}
    for element in elements:
        dtype = np.dtype([(name, order + code) for name, code in element.fields])
        if offset + dtype.itemsize * element.count > len(data):
            return None
        table = np.frombuffer(data, dtype, element.count, offset)
        tables[element.name] = {name: table[name] for name, _ in element.fields}
        offset += table.nbytes
    return tables if offset == len(data) else None


def _ascii_columns(text: bytes, elements: list[_Element]) -> dict[str, _Columns] | None:
    numbers = _numbers(text)
    if numbers is None or numbers.size != sum(e.count * len(e.fields) for e in elements):
        return None
    tables, start = {}, 0
    for element in elements:
        width = len(element.fields)
        table = numbers[start : start + element.count * width].reshape(element.count, width)
        tables[element.name] = {
            name: table[:, k].astype(code) if code[0] == "f" else table[:, k]
            for k, (name, code) in enumerate(element.fields)
        }
        start += table.size
    return tables


def _numbers(text: bytes) -> np.ndarray | None:
    """All whitespace-separated numbers of a text as float64; None if anything else is there."""
    import warnings

    try:
        with warnings.catch_warnings():
            # Older NumPy warns at the first token that is no number, newer NumPy raises.
            warnings.simplefilter("error", DeprecationWarning)
            numbers: np.ndarray = np.fromstring(text.decode("ascii"), np.float64, sep=" ")
            return numbers
    except (ValueError, DeprecationWarning):
        return None


def _ply_geometry(path: Path, columns: dict[str, _Columns]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) float32 and faces (m, 3), checked to be floats and integers."""
    vertex, face = columns["vertex"], columns["face"]
    key = next((k for k in ("vertex_index", "vertex_indices") if f"{k}.count" in face), None)
    if key is None or not {"x", "y", "z"} <= vertex.keys():
        raise FileError(f"{path}: the PLY has no x, y, z or no vertex_indices; export it again")
    if any(vertex[name].dtype.kind != "f" for name in "xyz"):
        raise FileError(f"{path}: x, y, z are integers, which Mitsuba misreads; export as float")
    corners = [face[f"{key}.{k}"] for k in range(3)]
    if any(c.dtype.kind == "f" and (c != np.floor(c)).any() for c in corners):
        raise FileError(f"{path}: face indices are not whole numbers; export it again")
    vertices = np.stack([vertex[name] for name in "xyz"], axis=1)
    if vertices.dtype.itemsize > 4:  # float64 beyond float32's range becomes infinite: refused
        with np.errstate(over="ignore"):
            vertices = vertices.astype(np.float32)
    return vertices.astype(np.float32), np.stack(corners, axis=1).astype(np.int64)


def _check_ply(path: Path, data: bytes) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    read = _ply_columns(path, data)
    if read is None or any(len(e.lists) > 1 for e in _ply_header(path, data)[1]):
        raise FileError(
            f"{path}: not plain triangles, or its length does not match its header; Mitsuba "
            "cannot read it, convert it with `inim new-scene`"
        )
    columns = read[0]
    for name, values in columns["vertex"].items():
        if name not in "xyz" and values.dtype.kind == "f" and not np.isfinite(values).all():
            raise FileError(f"{path}: vertex property {name!r} is not finite; export it again")
    yield _ply_geometry(path, columns)


def _read_triangle_ply(path: Path, data: bytes) -> list[Mesh] | None:
    """The mesh of a PLY in plain triangles; None leaves the file to trimesh."""
    read = _ply_columns(path, data)
    if read is None:
        return None
    columns, comments = read
    vertices, faces = _ply_geometry(path, columns)
    _check_indices(path, vertices, faces)
    vertex = columns["vertex"]
    uv = next((_stacked(vertex, names) for names in _UV_NAMES if set(names) <= vertex.keys()), None)
    if uv is not None and any(c.startswith("TextureFile") for c in comments):
        return None  # trimesh finds the picture
    normals = _usable_normals(_stacked(vertex, ("nx", "ny", "nz")))
    color = _ply_color(path, data, vertex)
    return [Mesh(vertices, faces.astype(np.uint32), normals, uv, color, None, path.stem)]


def _stacked(columns: _Columns, names: tuple[str, ...]) -> np.ndarray | None:
    if not set(names) <= columns.keys():
        return None
    return np.nan_to_num(np.stack([columns[n] for n in names], axis=1).astype(np.float32))


def _ply_color(path: Path, data: bytes, vertex: _Columns) -> np.ndarray | None:
    """Linear vertex colours: floats are linear, as Mitsuba takes them; integers are sRGB."""
    names = next((n for n in (("r", "g", "b"), ("red", "green", "blue")) if n[0] in vertex), None)
    color = None if names is None else _stacked(vertex, names)
    if color is None or names is None:
        return None
    elements = _ply_header(path, data)[1]
    code = dict(next(e.fields for e in elements if e.name == "vertex"))[names[0]]
    if code[0] == "f":
        return color.clip(0, 1)
    return _linear_from_srgb(color / np.iinfo(code).max)


# --- OBJ, STL, serialized, glTF: sizes and indices before anyone allocates ----------------------


def _check_obj(path: Path, data: bytes) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Vertices and corners of an OBJ that Mitsuba reads: absolute indices, one corner layout."""
    vertices, corners, layouts = _scan_obj(path, data)
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


def _guard_obj(path: Path, data: bytes) -> None:
    _scan_obj(path, data)


def _scan_obj(path: Path, data: bytes) -> tuple[np.ndarray, np.ndarray, set[str]]:
    """Positions (n, 3), all vertex indices as written, and the corner layouts met."""
    positions, corners, layouts, start = [], [], set(), 0
    while start < len(data):
        end = data.find(b"\n", min(start + _BLOCK_BYTES, len(data)))
        end = len(data) if end < 0 else end + 1
        block, start = data[start:end], end
        lines = re.findall(rb"^[ \t\r]*v[ \t]+(\S+(?:[ \t]+\S+){0,2})", block, re.M)
        numbers = _numbers(b" ".join(lines))
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
    numbers = _numbers(text)
    if numbers is None or not (np.abs(numbers) < 2**53).all() or (numbers % 1).any():
        raise FileError(f"{path}: a face line is not made of indices; the file is damaged")
    return numbers.astype(np.int64)


def _check_corners(path: Path, vertices: np.ndarray, corners: np.ndarray) -> None:
    """Refuse indices that no vertex answers to; OBJ counts from 1, negative ones from the end."""
    _check_indices(path, vertices, np.zeros((len(corners) // 3, 3), np.int64))
    worst = int(corners[np.abs(corners).argmax()])
    if abs(worst) > len(vertices) or (corners == 0).any():
        raise FileError(
            f"{path}: a face refers to vertex {worst if abs(worst) > len(vertices) else 0}, but "
            f"there are {len(vertices)} (1 to {len(vertices)}); the file is damaged"
        )


def _stl_fits(data: bytes) -> bool:
    return len(data) >= 84 and 84 + 50 * struct.unpack_from("<I", data, 80)[0] == len(data)


def _guard_stl(path: Path, data: bytes) -> None:
    """A binary STL is exactly as long as its count says; a text one has facets."""
    if _stl_fits(data):
        if len(data) == 84:
            raise FileError(f"{path}: holds no triangles; export the mesh again")
        return
    if data[:5].lower() == b"solid" and b"\0" not in data:
        if b"vertex" not in data.lower():
            raise FileError(f"{path}: holds no triangles; export the mesh again")
        return
    count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else 0
    raise FileError(
        f"{path}: an STL of {count} triangles is {84 + 50 * count} bytes long, this one is "
        f"{len(data)}; it is cut short or damaged"
    )


def _check_serialized(path: Path, data: bytes) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Every mesh of a `.serialized` file, versions 3 and 4, inflated no further than declared."""
    try:
        count = struct.unpack_from("<I", data, len(data) - 4)[0]
        version = struct.unpack_from("<HH", data)[1]
        code, width = ("<Q", 8) if version == 4 else ("<I", 4)
        table = len(data) - 4 - width * count
        if version not in (3, 4) or not 1 <= count <= len(data) // width or table < 4:
            raise ValueError("version or table of meshes is wrong")
        for k in range(count):
            offset = struct.unpack_from(code, data, table + width * k)[0]
            yield _inflate_mesh(data[offset + 4 : table], version)
    except (struct.error, zlib.error, ValueError) as error:
        raise FileError(
            f"{path}: not a sound .serialized mesh ({error}); export it as PLY"
        ) from error


def _inflate_mesh(data: bytes, version: int) -> tuple[np.ndarray, np.ndarray]:
    stream = zlib.decompressobj()
    head = stream.decompress(data, 4096)
    flags = struct.unpack_from("<I", head)[0]
    start = head.index(b"\0", 4) + 1 if version == 4 else 4
    n, m = struct.unpack_from("<QQ", head, start)
    start += 16
    size = 8 if flags & 0x2000 else 4
    floats = 3 + 3 * bool(flags & 1) + 2 * bool(flags & 2) + 3 * bool(flags & 8)
    total = start + n * floats * size + m * 12
    if total > _MOST_DEFLATE * len(data) or total > _MOST_BYTES:
        raise ValueError(f"declares {n} vertices and {m} faces in {len(data)} bytes")
    if total > len(head):
        head += stream.decompress(stream.unconsumed_tail, total - len(head))
    if len(head) < total:
        raise ValueError("it is cut short")
    vertices = np.frombuffer(head, f"<f{size}", 3 * n, start).reshape(-1, 3)
    faces = np.frombuffer(head, "<u4", 3 * m, start + n * floats * size).reshape(-1, 3)
    return vertices.astype(np.float32), faces.astype(np.int64)


def _guard_gltf(path: Path, data: bytes) -> None:
    """Hold the accessors of a glTF against the bytes there are: trimesh allocates what they say."""
    text = data
    try:
        if data.lstrip().startswith(b"glTF"):
            length = struct.unpack_from("<I", data, 12)[0]
            if length > len(data) - 20:
                raise ValueError("its JSON part is cut short")
            text = data[20 : 20 + length]
        tree = json.loads(text)
        bytes_there = len(data) + sum(_outside_bytes(path, b) for b in tree.get("buffers", []))
        declared = sum(_accessor_bytes(a) for a in tree.get("accessors", []))
        nodes = len(tree.get("nodes", []))
    except (struct.error, ValueError, KeyError, AttributeError, TypeError, RecursionError) as error:
        raise FileError(f"{path}: not a sound glTF file ({_first_line(error)})") from error
    if declared > _MOST_SHARING * bytes_there or nodes > _MOST_GLTF_NODES:
        raise FileError(
            f"{path}: declares {declared} bytes of data in {nodes} nodes, but has {bytes_there}; "
            "it is cut short or damaged"
        )


def _accessor_bytes(accessor: dict[str, Any]) -> int:
    sizes = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
    count = int(accessor["count"])
    if count < 0:
        raise ValueError(f"an accessor has {count} items")
    return count * sizes[accessor["componentType"]] * width[accessor["type"]]


def _outside_bytes(path: Path, buffer: dict[str, Any]) -> int:
    """Size of a buffer's own file, if it lies in the glTF's folder."""
    uri = str(buffer.get("uri", ""))
    if not uri or uri.startswith("data:"):
        return 0
    folder = path.parent.resolve()
    target = (folder / uri).resolve()
    if not target.is_relative_to(folder) or not target.is_file():
        raise ValueError(f"its buffer {uri[:60]!r} is not a file in the same folder")
    return target.stat().st_size


_GUARDS = {"ply": _guard_ply, "obj": _guard_obj, "stl": _guard_stl, "glb": _guard_gltf}
_GUARDS["gltf"] = _guard_gltf
_CHECKS = {"ply": _check_ply, "obj": _check_obj, "serialized": _check_serialized}


# --- Through trimesh ----------------------------------------------------------------------------


def _read_with_trimesh(path: Path, kind: str) -> list[Mesh]:
    """Every surface of the *transformed* scene; whatever trimesh throws is a FileError."""
    import trimesh

    try:
        # No processing: merging vertices drops texture seams, and NaN must be seen, not mended.
        with path.open("rb") as file:
            resolver = trimesh.resolvers.FilePathResolver(str(path))
            scene = trimesh.load_scene(file, file_type=kind, resolver=resolver, process=False)
        _check_instances(path, scene)
        parts = scene.dump()
        surfaces = [p for p in parts if isinstance(p, trimesh.Trimesh) and len(p.faces)]
        if not surfaces:
            kinds = sorted({type(p).__name__ for p in parts}) or ["nothing"]
            raise FileError(
                f"{path}: holds no faces ({', '.join(kinds)}); inim needs a triangle mesh"
            )
        linear = kind in ("glb", "gltf")
        return [_from_trimesh(path, part, linear_colors=linear) for part in surfaces]
    except FileError:
        raise
    except MemoryError as error:
        raise FileError(f"{path}: does not fit into memory; decimate the mesh first") from error
    except Exception as error:
        raise FileError(f"{path}: not a readable {kind} mesh ({_first_line(error)})") from error


def _check_instances(path: Path, scene: Any) -> None:
    """A small file may place one mesh a million times; count before copying."""
    total = 0
    for node in scene.graph.nodes_geometry:
        geometry = scene.geometry[scene.graph[node][1]]
        total += len(getattr(geometry, "faces", ()))
    if total > _MOST_INSTANCED_FACES:
        raise FileError(f"{path}: unfolds to {total} faces; decimate the mesh first")


def _from_trimesh(path: Path, part: Any, *, linear_colors: bool) -> Mesh:
    vertices = np.asarray(part.vertices, np.float64)
    with np.errstate(over="ignore"):
        vertices = vertices.astype(np.float32)
    faces = np.asarray(part.faces, np.int64)
    if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,):
        raise FileError(f"{path}: vertices of {vertices.shape[1:]} numbers; the file is damaged")
    _check_indices(path, vertices, faces)
    # Normals that trimesh would compute are not the file's; it keeps the file's in this cache.
    given = part.vertex_normals if "vertex_normals" in part._cache else None
    normals = _usable_normals(None if given is None else np.asarray(given, np.float32))
    color, uv, texture = _appearance(path, part, linear_colors)
    if part.visual.kind == "face":  # one colour a face: give every face its own corners
        color = np.repeat(_color(part.visual.face_colors, linear_colors), 3, axis=0)
        vertices, faces = vertices[faces.ravel()], np.arange(faces.size).reshape(-1, 3)
        normals = None
    name = str(part.metadata.get("name") or path.stem)
    return Mesh(vertices, faces.astype(np.uint32), normals, uv, color, texture, name)


def _appearance(
    path: Path, part: Any, linear: bool
) -> tuple[np.ndarray | None, np.ndarray | None, np.ndarray | None]:
    """Vertex colour, texture coordinates and base-colour texture, each where there is one."""
    visual, count = part.visual, len(part.vertices)
    if visual.kind == "vertex":
        return _color(visual.vertex_colors, linear), None, None
    material = getattr(visual, "material", None)
    if material is None:
        return None, None, None
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if image is not None and image.size == (2, 2):  # where trimesh found no picture
        grey = np.asarray(image.convert("RGB")).reshape(-1, 3) == _TRIMESH_GREY
        image = None if grey.all() else image
    factor = getattr(material, "baseColorFactor", None) if linear else material.main_color
    tint = np.ones(3, np.float32) if factor is None else _color(np.array([factor]), linear)[0]
    uv = None if visual.uv is None else np.nan_to_num(np.asarray(visual.uv, np.float32))
    if image is not None and uv is not None and uv.shape == (count, 2):
        return None, uv, _tinted(_pixels(path, image), tint if linear else np.ones(3))
    spoken = getattr(visual, "vertex_attributes", {}).get("color")
    if spoken is not None and len(spoken) == count:
        return _color(spoken, linear) * tint, None, None
    if factor is None or tuple(factor[:3]) == _TRIMESH_GREY or bool((tint == 1).all()):
        return None, None, None
    return np.tile(tint, (count, 1)).astype(np.float32), None, None


def _pixels(path: Path, image: Any) -> np.ndarray:
    if image.width * image.height > _MOST_TEXTURE_PIXELS:
        raise FileError(
            f"{path}: texture of {image.width} x {image.height} pixels; scale it below 8192 x 8192"
        )
    return np.asarray(image.convert("RGB"), np.uint8)


def _tinted(pixels: np.ndarray, tint: np.ndarray) -> np.ndarray:
    """Texture times base-colour factor: glTF multiplies in linear light."""
    if (tint == 1).all():
        return pixels
    from inim.color import srgb_from_linear, srgb_to_uint8

    curve = _linear_from_srgb(np.arange(256) / 255.0)
    table = np.stack([srgb_to_uint8(srgb_from_linear(curve * t)) for t in tint])
    return np.stack([table[c][pixels[..., c]] for c in range(3)], axis=-1)


def _color(values: Any, linear: bool) -> np.ndarray:
    """(n, 3) linear float32 from trimesh's 8-bit or float colours."""
    array = np.asarray(values)[:, :3]
    scale = np.iinfo(array.dtype).max if array.dtype.kind in "ui" else 1.0
    share = np.clip(np.nan_to_num(array / scale), 0, 1).astype(np.float32)
    return share if linear else _linear_from_srgb(share)


def _linear_from_srgb(srgb: np.ndarray) -> np.ndarray:
    """Inverse of `inim.color.srgb_from_linear` (IEC 61966-2-1)."""
    srgb = np.asarray(srgb, np.float32)
    curve = np.power((np.maximum(srgb, 0.04045) + 0.055) / 1.055, 2.4)
    return np.where(srgb <= 0.04045, srgb / 12.92, curve).astype(np.float32)


def _usable_normals(normals: np.ndarray | None) -> np.ndarray | None:
    """Unit normals; None where any is missing, zero or not finite, so that they are made anew."""
    if normals is None:
        return None
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    if not np.isfinite(length).all() or (length < 1e-6).any():
        return None
    unit: np.ndarray = (normals / length).astype(np.float32)
    return unit


def _first_line(error: BaseException) -> str:
    """The first line of a foreign message, printable and short."""
    text = next(iter(str(error).splitlines()), "") or type(error).__name__
    return "".join(c if c.isprintable() else "?" for c in text)[:120]
