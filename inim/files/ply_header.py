"""The header of a PLY file, its declared counts held against the bytes there are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inim.errors import FileError

__all__ = ["PlyElement", "PlyHeader", "is_ply", "read_ply_header"]

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


def read_ply_header(path: Path, data: bytes) -> PlyHeader:
    """The header of a PLY file whose bytes suffice for what it declares, faces among it.

    Raises
    ------
    FileError
        The header makes no sense, declares more than the file holds, or no plain faces.
    """
    header = _parsed(path, data)
    for element in header.elements:
        if _least_bytes(element, header.is_text) > len(data) - header.size:
            raise FileError(
                f"{path}: declares {element.count} x {element.name}, but is only {len(data)} "
                "bytes long; it is cut short or damaged"
            )
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
