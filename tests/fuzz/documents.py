"""Mutations of documents by their structure: what slips and malice make of keys and values.

JSON, TOML and XML are read, changed as trees, and written again; an .npz is changed array by array.
So most of them stay well formed, and what is wrong with them lies behind the reader's first look.
"""

import copy
import io
import json
import random
import sys
import zipfile
from collections.abc import Callable, Iterator
from typing import Any
from xml.etree import ElementTree

import numpy as np

from tests.fuzz.mutations import mutated

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_NUMBERS: tuple[Any, ...] = (
    0, 1, -1, 2, 3, 7, 0.5, -0.0, 1.0, 1e308, -1e308, 1e-308, 5e-324, 1e9, 1e-9, 10**6, 10**9,
    2**31, -(2**31), 2**53, 2**63, 2**64, -(2**63), 10**18,
)  # fmt: skip
_NO_NUMBERS: tuple[Any, ...] = (
    float("nan"), float("inf"), -float("inf"), 10**30, 10**400, None, True, False,
)  # fmt: skip
_TEXTS = (
    "", " ", "0", "nan", "-1", "1e999", "text", "None", "../../etc/passwd", "/dev/zero", "..", ".",
    "a/b", "a\\b", "CON", "\0", "\n", "\x1b[31m", "\ud800", "\u202e", "\u00e9" * 40, "<script>",
    "&amp;", "$HOME", "%s%n", "{0}", "x" * 300, "y" * 100_000, "1 " * 5000, ",", "=", ":",
    "centre", "template", "wang2024", "truth", "eia", "ssim", "left=0 0 1e9", "pinhole", "scene",
)  # fmt: skip
_HOLDERS: tuple[Any, ...] = (
    [], {}, [[]], [{}], {"": 0}, [None], [0] * 1000, ["a"] * 50, {"a": {"a": {}}},
)  # fmt: skip
_VALUES = (*_NUMBERS, *_NO_NUMBERS, *_TEXTS, *_HOLDERS)


def mutated_document(kind: str, specimens: tuple[bytes, ...], seed: str) -> bytes:
    """One of the specimens, changed in one to four places; a sixth of them byte by byte.

    Parameters
    ----------
    kind : str
        "json", "toml", "xml" or "npz".
    specimens : tuple of bytes
    seed : str
        Says everything: equal seeds give equal documents.
    """
    rng = random.Random(seed)
    data = rng.choice(specimens)
    if rng.random() < 1 / 6:
        return mutated((data,), seed, kind)
    try:
        return _changed_document(rng, data, kind, rng.choice((1, 1, 1, 2, 4)))
    except RecursionError:  # too deep for whoever writes it
        return mutated((data,), seed, kind)


def _changed_document(rng: random.Random, data: bytes, kind: str, times: int) -> bytes:
    if kind == "xml":
        return _mutated_xml(rng, data, times)
    if kind == "npz":
        return _mutated_npz(rng, data)
    tree = json.loads(data) if kind == "json" else tomllib.loads(data.decode())
    for _ in range(times):
        tree = _changed(rng, tree)
    text = json.dumps(tree, indent=1) if kind == "json" else _toml(tree)
    if rng.random() < 0.1:
        text = _doubled_line(rng, text)
    return text.encode(errors="surrogatepass")


def _places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The ways to all values in a tree."""
    items: Any = ()
    if isinstance(value, dict):
        items = value.items()
    elif isinstance(value, list):
        items = enumerate(value)
    for key, item in items:
        yield (*at, key)
        yield from _places(item, (*at, key))


def _changed(rng: random.Random, tree: Any) -> Any:
    """A tree with one thing about it changed."""
    places = list(_places(tree)) if isinstance(tree, (dict, list)) else []
    if not places:
        return copy.deepcopy(rng.choice(_VALUES))
    # Shallow places are few and far from dull.
    most = rng.choice((1, 2, 3, 99))
    at = rng.choice([p for p in places if len(p) <= most])
    holder = tree
    for key in at[:-1]:
        holder = holder[key]
    rng.choice(_CHANGES)(rng, holder, at[-1], tree)
    return tree


def _replace(rng: random.Random, holder: Any, key: Any, _: Any) -> None:
    holder[key] = copy.deepcopy(rng.choice(_VALUES))


def _alike(rng: random.Random, holder: Any, key: Any, _: Any) -> None:
    """Another value of the same type, which a schema may allow."""
    value = holder[key]
    if isinstance(value, bool):
        holder[key] = not value
    elif isinstance(value, (int, float)):
        kind = type(value)
        holder[key] = rng.choice([v for v in _NUMBERS if isinstance(v, kind)])
    elif isinstance(value, str):
        holder[key] = rng.choice(_TEXTS)
    elif isinstance(value, list):
        rng.shuffle(value)
    elif value:
        _drop(rng, value, rng.choice(list(value)), None)


def _scale(rng: random.Random, holder: Any, key: Any, _: Any) -> None:
    """A number stays one."""
    if isinstance(holder[key], (int, float)):
        factor = rng.choice((0, -1, 2, 1e-3, 1e3, 1e9, 1e300))
        number = holder[key] * factor
        holder[key] = int(number) if isinstance(holder[key], int) and abs(number) < 1e18 else number
    else:
        _replace(rng, holder, key, _)


def _drop(_: random.Random, holder: Any, key: Any, __: Any) -> None:
    del holder[key]


def _rename(rng: random.Random, holder: Any, key: Any, _: Any) -> None:
    """A list keeps its length; the value moves."""
    value = holder.pop(key)
    if isinstance(holder, list):
        holder.insert(rng.randrange(len(holder) + 1), value)
    else:
        other = rng.choice((f"{key}x", f" {key}", key.upper(), *rng.sample(_TEXTS, 3)))
        holder[other] = value


def _repeat(rng: random.Random, holder: Any, key: Any, _: Any) -> None:
    """A value again, under a key or place of its own."""
    value = copy.deepcopy(holder[key])
    if isinstance(holder, list):
        holder[key:key] = [copy.deepcopy(value) for _ in range(rng.choice((1, 2, 300)))]
    else:
        holder[f"{key}2"] = value


def _nest(rng: random.Random, holder: Any, key: Any, _: Any) -> None:
    for _level in range(rng.choice((1, 3, 50, 200))):
        holder[key] = [holder[key]] if rng.random() < 0.5 else {str(key): holder[key]}


def _move(rng: random.Random, holder: Any, key: Any, tree: Any) -> None:
    """The value from anywhere else: references break, and types."""
    value = tree
    for step in rng.choice(list(_places(tree))):
        value = value[step]
    holder[key] = copy.deepcopy(value)


def _empty(_: random.Random, holder: Any, key: Any, __: Any) -> None:
    holder[key] = type(holder[key])() if holder[key] is not None else 0


# Other values of the same type are the likeliest: a schema may allow them.
_CHANGES: tuple[Callable[[random.Random, Any, Any, Any], None], ...] = (
    _replace, _alike, _alike, _alike, _scale, _drop, _rename, _repeat, _nest, _move, _empty,
)  # fmt: skip


def _doubled_line(rng: random.Random, text: str) -> str:
    """A line twice: a key given twice, or no document any more."""
    lines = text.splitlines()
    at = rng.randrange(len(lines))
    lines.insert(at, lines[at])
    return "\n".join(lines)


def _toml(tree: Any) -> str:
    """A tree as TOML, tables inline."""
    root = tree if isinstance(tree, dict) else {"value": tree}
    return "".join(f"{_name(key)} = {_inline(value)}\n" for key, value in root.items())


def _name(key: object) -> str:
    text = str(key)
    return text if text.isidentifier() and text.isascii() else json.dumps(text)


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_name(k)} = {_inline(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    if isinstance(value, float):
        return repr(value)
    return '""' if value is None else json.dumps(value, ensure_ascii=False)


def _mutated_xml(rng: random.Random, data: bytes, times: int) -> bytes:
    root = ElementTree.fromstring(data)
    for _ in range(times):
        elements = list(root.iter())
        parents = {child: parent for parent in elements for child in parent}
        _change_element(rng, rng.choice(elements), parents, elements)
    try:
        return ElementTree.tostring(root)
    except (TypeError, ValueError):  # a name that cannot be written
        return data


def _change_element(
    rng: random.Random, element: Any, parents: dict[Any, Any], elements: list[Any]
) -> None:
    other, parent = rng.choice(elements), parents.get(element)
    kind = rng.randrange(8)
    if kind < 3 and element.attrib:
        key = rng.choice(list(element.attrib))
        values = [str(v) for v in _VALUES if not isinstance(v, (dict, list))]
        borrowed = [v for e in elements for v in e.attrib.values()]
        element.attrib[key] = _xml_safe(rng.choice([*values, *borrowed, f"${key}", "$mesh", "$"]))
    elif kind == 3 and element.attrib:
        key = rng.choice(list(element.attrib))
        value = element.attrib.pop(key)
        if rng.random() < 0.5:
            element.attrib[rng.choice(("id", "name", "type", "value", "filename"))] = value
    elif kind == 4:
        element.tag = rng.choice(
            (other.tag, "scene", "include", "path", "default", "ref", "nobody")
        )
    elif kind == 5 and parent is not None:
        parent.remove(element)
    elif kind == 6 and parent is not None:
        for _ in range(rng.choice((1, 1, 30))):
            parent.append(copy.deepcopy(element))
    else:
        inner = element
        for _ in range(rng.choice((1, 5, 70, 500))):
            inner = ElementTree.SubElement(inner, rng.choice((element.tag, other.tag)))
        inner.attrib.update(other.attrib)


def _xml_safe(text: str) -> str:
    """Text that an XML writer accepts and a reader may refuse."""
    return text.encode("utf-8", "replace").decode().replace("\0", "\x01")


def _mutated_npz(rng: random.Random, data: bytes) -> bytes:
    """Members dropped, renamed, doubled, of other types, shapes and values, or lying headers."""
    with np.load(io.BytesIO(data)) as stored:
        arrays = {name: stored[name] for name in stored.files}
    members = {f"{name}.npy": _npy(array) for name, array in arrays.items()}
    for _ in range(rng.choice((1, 1, 2))):
        name = rng.choice(list(arrays))
        array = arrays[name]
        kind = rng.randrange(10)
        member = f"{name}.npy"
        if kind == 0:
            members.pop(member, None)
        elif kind == 1:
            members[rng.choice(("x", "../x.npy", member[:-4], "a" * 300))] = _npy(array)
        elif kind == 2:
            types = ("f8", "f2", "i4", "u1", "c8", "S3", "U2", "?", "M8[s]", "O")
            with np.errstate(all="ignore"):
                members[member] = _npy(array.astype(rng.choice(types)))
        elif kind == 3:
            shapes = ((0,), (), (1, *array.shape), array.shape[::-1], (array.size,))
            shape = rng.choice(shapes)
            members[member] = _npy(np.resize(array, shape))
        elif kind < 7:
            wrong = array.astype(np.float64)
            values = (np.nan, np.inf, -np.inf, -1, 0, 1e38, 1e-45, 1e300)
            mask = np.array([rng.random() < rng.choice((0.01, 1)) for _ in range(array.size)])
            wrong[mask.reshape(array.shape)] = rng.choice(values)
            with np.errstate(all="ignore"):
                members[member] = _npy(wrong.astype(array.dtype))
        elif kind == 7:
            shape = rng.choice(
                ((10**12,), (10**6, 10**6), (2**62, 4), (-1, 3), (-2, -3), (10**400,))
            )
            members[member] = _lying(array, shape)
        elif kind == 8:
            members[member] = _npy(array)[: rng.randrange(200)]
        else:
            members[member] = mutated((_npy(array),), str(rng.random()), "npy")
    packed = io.BytesIO()
    method = rng.choice((zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED, zipfile.ZIP_BZIP2))
    with zipfile.ZipFile(packed, "w", method) as out:
        for name, content in members.items():
            out.writestr(name, content)
    return packed.getvalue()


def _npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()


def _lying(array: np.ndarray, shape: tuple[int, ...]) -> bytes:
    """A header that declares another shape than there are values."""
    stream = io.BytesIO()
    about = {"descr": array.dtype.str, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_2_0(stream, about)  # type: ignore[arg-type]
    return stream.getvalue() + array.tobytes()
