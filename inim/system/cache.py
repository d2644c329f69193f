"""Result cache: results stored under the digest of their inputs.

A record's address is the digest of its inputs: scene and mesh bytes, display, viewpoint, seed,
samples, the program's own code and the versions of all `PACKAGES`; no file names and no times.
Equal inputs give equal results, bit for bit, so no record is ever invalidated. Records are npz
files. They are written to a temporary file and renamed, so a killed run leaves no half-written
record. They are read against their checksums and their address; a damaged record is removed and its
result is computed again. Any number of processes may share a folder.

The folder is `inim` in the user's cache folder, or the folder in the variable INIM_CACHE; "off"
disables the cache. Beyond a size, 8 GiB or INIM_CACHE_GIB, the least recently used records are
deleted first.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import io
import json
import os
import platform
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from inim.system.errors import UsageError
from inim.system.process.atomic_file import atomic_file
from inim.system.process.machine import user_cache_folder

_PACKAGE = Path(__file__).resolve().parents[1]
_SOURCES = (".py", ".html", ".css", ".js", ".glsl")


def input_digests(parts: Mapping[str, Any]) -> dict[str, str]:
    """Digests of a result's inputs, and of the packages that every result depends on."""
    return {name: value_digest(value) for name, value in {"packages": versions(), **parts}.items()}


def cache_address(product: str, parts: Mapping[str, str]) -> str:
    """Address of the result of a product with these digests of its inputs."""
    return value_digest([product, sorted(parts.items())])


def value_digest(value: Any) -> str:
    """Digest of JSON values, and of arrays, dataclasses and documents in them; 40 hex digits."""
    text = json.dumps(value, sort_keys=True, default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()[:40]


def array_digest(*arrays: np.ndarray | None) -> str:
    """Digest of the shapes, types and bytes of arrays."""
    digest = hashlib.sha256()
    for array in arrays:
        if array is None:
            digest.update(b"none")
            continue
        digest.update(f"{array.shape} {array.dtype.str} ".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()[:40]


@cache
def code_digest(*places: str) -> str:
    """Digest of the source of modules and packages of this program, which changes with every edit.

    `places` are paths below the package, such as ``"render"`` or ``"scores/metrics/base.py"``;
    ``""`` is the whole package.
    """
    digest = hashlib.sha256()
    for place in places:
        path = _PACKAGE / place
        files = [path] if path.is_file() else sorted(_source_files(path))
        if not files:
            raise FileNotFoundError(place)
        for file in files:
            digest.update(str(file.relative_to(_PACKAGE)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:40]


def computation_digests(places: Iterable[str], root: Path = _PACKAGE.parent) -> dict[str, str]:
    """Digests of what modules and folders compute, by place below the root of the project.

    Comments, docstrings and layout decide nothing: a module counts as its syntax tree. Raises
    `FileNotFoundError` for a place without source.
    """
    digests = {}
    for place in places:
        path = root / place
        files = [path] if path.is_file() else sorted(_source_files(path))
        if not files:
            raise FileNotFoundError(place)
        texts = {str(file.relative_to(root)): file.read_text("utf-8") for file in files}
        digests[place] = value_digest(
            {name: _tree(ast.parse(t)) if name.endswith(".py") else t for name, t in texts.items()}
        )
    return digests


def _tree(node: Any) -> Any:
    """A syntax tree as JSON values, without docstrings; equal for all versions of Python."""
    if isinstance(node, list):
        return [_tree(entry) for entry in node if not _is_text(entry)]
    if not isinstance(node, ast.AST):
        return repr(node)
    parts = [(k, _tree(v)) for k, v in ast.iter_fields(node) if v is not None and v != []]
    return [type(node).__name__, *parts]


def _is_text(node: Any) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


#: Packages that the program computes with: their versions affect every result.
PACKAGES = (
    "DracoPy", "drjit", "llvmlite", "matplotlib", "mitsuba", "msgspec", "numba", "numpy", "OpenEXR",
    "pillow", "scikit-image", "scipy", "trimesh",
)  # fmt: skip


def versions(packages: Iterable[str] = PACKAGES) -> dict[str, str]:
    """Versions of Python and of installed packages; "unknown" if not installed."""
    return {"python": platform.python_version(), **{name: _version(name) for name in packages}}


@cache
def _version(package: str) -> str:
    from importlib import metadata  # slow to load

    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "unknown"


def _source_files(folder: Path) -> Iterator[Path]:
    """Modules, and the pages, styles, scripts and shaders next to them."""
    return (path for path in folder.rglob("*.*") if path.suffix in _SOURCES)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return array_digest(value)
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: getattr(value, f.name) for f in fields(value)}
    if isinstance(value, msgspec.Struct):
        return msgspec.structs.asdict(value)
    if isinstance(value, Path):
        raise TypeError("paths decide nothing")
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} has no digest")


FOLDER_VARIABLE = "INIM_CACHE"
SIZE_VARIABLE = "INIM_CACHE_GIB"
_OFF = "off"
_DEFAULT_GIB = 8.0
_RECORD = ".npz"
_REASONS = ".json"
_FACTS = "facts"


@dataclass(frozen=True)
class Record:
    """Stored result: arrays, and facts as JSON values."""

    arrays: Mapping[str, np.ndarray]
    facts: Any = None


@dataclass(frozen=True)
class StoreInfo:
    """Size of a store."""

    folder: Path
    records: int
    size_bytes: int
    limit_bytes: int


def store_folder() -> Path | None:
    """Folder of the result cache; None if it is disabled or the user has no home folder."""
    named = os.environ.get(FOLDER_VARIABLE, "")
    if named:
        return None if named.lower() == _OFF else Path(named)
    return user_cache_folder()


def open_store() -> Store | None:
    """The store to use, if any; raises `UsageError` if INIM_CACHE_GIB is not a size."""
    folder = store_folder()
    return None if folder is None else Store(folder, _limit_bytes())


def _limit_bytes() -> int:
    text = os.environ.get(SIZE_VARIABLE, "")
    try:
        size = float(text) if text else _DEFAULT_GIB
        if 0 < size < 1e9:
            return int(size * 2**30)
    except ValueError:
        pass
    raise UsageError(f"{SIZE_VARIABLE} = {text!r}: a size in GiB, such as 8")


class Store:
    """Stored results in a folder, which is created for the first record.

    `limit_bytes` is the maximum size of all records.
    """

    def __init__(self, folder: Path, limit_bytes: int) -> None:
        self.folder = folder
        self._limit = limit_bytes
        self._held: int | None = None

    def load(self, address: str) -> Record | None:
        """The record at an address; None if it is missing or damaged."""
        path = self.folder / (address + _RECORD)
        if not path.is_file():  # nor a pipe, which would never end
            return None
        try:
            with zipfile.ZipFile(path) as archive:
                arrays = {
                    name.removesuffix(".npy"): _array(archive.read(name))  # checks its CRC-32
                    for name in archive.namelist()
                }
            own, facts = json.loads(bytes(arrays.pop(_FACTS)))
            if own != address:
                raise ValueError(f"the record of {own}")
            os.utime(path)  # the time of its last use
        except FileNotFoundError:
            return None
        except Exception:  # a damaged archive may raise any exception
            with contextlib.suppress(OSError):
                path.unlink()
            return None
        return Record(arrays, facts)

    def holds(self, address: str) -> bool:
        """True if a record exists, damaged or not."""
        return (self.folder / (address + _RECORD)).is_file()

    def keep(self, address: str, record: Record) -> bool:
        """Store a record; False if the folder cannot be written, which is not an error."""
        facts = np.frombuffer(json.dumps([address, record.facts]).encode(), np.uint8)
        path = self.folder / (address + _RECORD)
        try:
            self._make_room(sum(a.nbytes for a in record.arrays.values()))
            with atomic_file(path) as temporary:
                np.savez(temporary, **{_FACTS: facts, **record.arrays})  # type: ignore[arg-type]
        except OSError:
            return False
        self._held = None if self._held is None else self._held + path.stat().st_size
        return True

    def last_parts(self, topic: str) -> dict[str, str] | None:
        """Inputs of the last result requested under a topic."""
        path = self.folder / (topic + _REASONS)
        try:
            parts = json.loads(path.read_text("utf-8")) if path.is_file() else None
        except (OSError, ValueError):
            return None
        return {str(k): str(v) for k, v in parts.items()} if isinstance(parts, dict) else None

    def remember_parts(self, topic: str, parts: Mapping[str, str]) -> None:
        """Store the inputs of a result, to report changes in the next run."""
        path = self.folder / (topic + _REASONS)
        with contextlib.suppress(OSError), atomic_file(path) as temporary:
            temporary.write_text(json.dumps(dict(parts)), "utf-8")

    def info(self) -> StoreInfo:
        """Number and size of the records."""
        sizes = [size for _, size, _ in self._files()]
        records = sum(path.suffix == _RECORD for path, _, _ in self._files())
        return StoreInfo(self.folder, records, sum(sizes), self._limit)

    def clear(self) -> StoreInfo:
        """Remove all records, and return their number and size."""
        removed = self.info()
        for path, _, _ in self._files():
            with contextlib.suppress(OSError):
                path.unlink()
        return removed

    def _make_room(self, needed: int) -> None:
        """Remove the least recently used records until `needed` bytes fit."""
        if self._held is None:
            self._held = sum(size for _, size, _ in self._files())
        if self._held + needed <= self._limit:
            return
        files = sorted(self._files(), key=lambda file: file[2])
        total_bytes = sum(size for _, size, _ in files)
        for path, size, _ in files:
            # Make room for more than one record, so that not every record lists the folder.
            if total_bytes + needed <= 0.9 * self._limit:
                break
            with contextlib.suppress(OSError):
                path.unlink()
                total_bytes -= size
        self._held = total_bytes

    def _files(self) -> list[tuple[Path, int, float]]:
        """Path, size and time of last use of the store's own files."""
        files = []
        with contextlib.suppress(OSError):
            for path in self.folder.iterdir():
                with contextlib.suppress(OSError):  # another process may remove it at any time
                    status = path.stat()
                    if path.suffix in (_RECORD, _REASONS):
                        files.append((path, status.st_size, status.st_mtime))
        return files


def _array(data: bytes) -> np.ndarray:
    """The array of an npy file, read-only, without a copy of its bytes."""
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    if version != (1, 0):  # as NumPy writes arrays of numbers
        raise ValueError(f"npy version {version}")
    shape, by_columns, dtype = np.lib.format.read_array_header_1_0(stream)
    if dtype.hasobject:
        raise ValueError("Python objects")
    values = np.frombuffer(data, dtype, offset=stream.tell())
    return values.reshape(shape, order="F" if by_columns else "C")


class ResultCache:
    """Store together with the history of successive runs.

    Without a store, no result is looked up or kept. `topic`, such as the scene's path, identifies
    the last run, to report changes since then.
    """

    def __init__(self, store: Store | None = None, topic: str = "") -> None:
        self._store = store
        self._topic = topic

    def holds(self, product: str, parts: Mapping[str, Any]) -> bool:
        """True if `find_or_make` would find a result."""
        return self._store is not None and self._store.holds(
            cache_address(product, input_digests(parts))
        )

    def find_or_make(
        self,
        product: str,
        parts: Callable[[], Mapping[str, Any]],
        make: Callable[[], Any],
        kinds: Iterable[type] = (),
        *,
        explain: bool = True,
    ) -> tuple[Any, str | None]:
        """Look up a result or compute it; also return the reason for computing.

        `product` is the readable name of the result, `parts` returns all inputs by readable names,
        and `kinds` are the dataclasses in the result. With `explain`, the inputs are stored, to
        report changes in the next run. The reason is such as "changed: seed"; None if the result
        was stored, "" if unknown.
        """
        if self._store is None:
            return make(), ""
        digests = input_digests(parts())
        address, topic = cache_address(product, digests), value_digest([self._topic, product])
        record, why = self._store.load(address), None
        try:
            result = None if record is None else _unpack(record, kinds)
        except (AttributeError, KeyError, TypeError, ValueError):
            record = None  # a whole file, but not of this result
        if record is None:
            result = make()
            self._store.keep(address, _pack(result))
            why = _change(self._store.last_parts(topic), digests) if explain else ""
        if explain:
            self._store.remember_parts(topic, digests)
        return result, why


def _change(before: Mapping[str, str] | None, now: Mapping[str, str]) -> str:
    if before is None:
        return "not made before"
    changed = [name for name in now if before.get(name) != now[name]]
    changed += [name for name in before if name not in now]
    return f"changed: {', '.join(changed)}" if changed else "the store had dropped it"


def _pack(value: Any) -> Record:
    """Record of the arrays, each once, and of the tree of all other values for JSON."""
    arrays: dict[str, np.ndarray] = {}
    names: dict[int, str] = {}

    def tree(part: Any) -> Any:
        if isinstance(part, np.ndarray):
            name = names.setdefault(id(part), f"a{len(names)}")
            arrays[name] = part
            return {"array": name}
        if is_dataclass(part) and not isinstance(part, type):
            return {
                type(part).__name__: {f.name: tree(getattr(part, f.name)) for f in fields(part)}
            }
        if isinstance(part, tuple | list):
            return {"list": [tree(item) for item in part]}
        if isinstance(part, dict):
            return {"dict": {name: tree(item) for name, item in part.items()}}
        return part

    return Record(arrays, tree(value))


def _unpack(record: Record, kinds: Iterable[type]) -> Any:
    classes = {kind.__name__: kind for kind in kinds}

    def value(part: Any) -> Any:
        if not isinstance(part, dict):
            return part
        ((kind, content),) = part.items()
        if kind == "array":
            return record.arrays[content]
        if kind == "list":
            return tuple(value(item) for item in content)
        whole = {name: value(item) for name, item in content.items()}
        return whole if kind == "dict" else classes[kind](**whole)

    return value(record.facts)
