"""A store of results, by what decides them: found again, a result need not be made again.

A record's address is the digest of all that decides it (`inim.cache.digest`): scene and mesh bytes,
display, viewpoint, seed, samples, versions; no file names and no times. So there is nothing to
invalidate. Records are npz files, written beside their place and moved there, so that a run that
is killed leaves none half written, and read against their checksums and the address that they hold,
so that a damaged one, or one under another's name, is found out, removed and made again. Any number
of processes may share a folder.

The folder is `inim` in the user's cache, or what the variable INIM_CACHE names; "off" is none.
Beyond a size, 8 GiB or INIM_CACHE_GIB, what was not used for longest goes first.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from inim.errors import UsageError
from inim.process.atomic_file import atomic_file

FOLDER_VARIABLE = "INIM_CACHE"
SIZE_VARIABLE = "INIM_CACHE_GIB"
_OFF = "off"
_DEFAULT_GIB = 8.0
_RECORD = ".npz"
_REASONS = ".json"
_FACTS = "facts"


@dataclass(frozen=True)
class Record:
    """What is stored: arrays, and facts that JSON can hold."""

    arrays: Mapping[str, np.ndarray]
    facts: Any = None


@dataclass(frozen=True)
class StoreInfo:
    """What a store holds."""

    folder: Path
    records: int
    size_bytes: int
    limit_bytes: int


def store_folder() -> Path | None:
    """Where results are kept; None where they are not, or nobody knows the user's home."""
    named = os.environ.get(FOLDER_VARIABLE, "")
    if named:
        return None if named.lower() == _OFF else Path(named)
    base = os.environ.get("XDG_CACHE_HOME", "")
    if not Path(base).is_absolute():
        base = os.path.expanduser("~/.cache")  # noqa: PTH111 (stays as it is where there is none)
    return Path(base) / "inim" if Path(base).is_absolute() else None


def open_store() -> Store | None:
    """The store to use, if any.

    Raises
    ------
    UsageError
        INIM_CACHE_GIB is no size.
    """
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
    """Results in a folder.

    Parameters
    ----------
    folder : Path
        Made when something is first kept.
    limit_bytes : int
        What all records together may take.
    """

    def __init__(self, folder: Path, limit_bytes: int) -> None:
        self.folder = folder
        self._limit = limit_bytes
        self._held: int | None = None

    def load(self, address: str) -> Record | None:
        """The record at an address, if it is there and whole."""
        path = self.folder / (address + _RECORD)
        try:
            with zipfile.ZipFile(path) as archive:
                arrays = {
                    name.removesuffix(".npy"): _array(archive.read(name))  # checks its CRC-32
                    for name in archive.namelist()
                }
            own, facts = json.loads(bytes(arrays.pop(_FACTS)))
            if own != address:
                raise ValueError(f"the record of {own}")
            os.utime(path)  # when it was last of use
        except FileNotFoundError:
            return None
        except Exception:  # readers of archives raise of all kinds, whatever bytes they meet
            with contextlib.suppress(OSError):
                path.unlink()
            return None
        return Record(arrays, facts)

    def holds(self, address: str) -> bool:
        """Whether there is a record, whole or not."""
        return (self.folder / (address + _RECORD)).is_file()

    def keep(self, address: str, record: Record) -> bool:
        """Keep a record; False where the folder takes none: a store is a help, not a need."""
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
        """What decided the result that was last asked for under a topic."""
        try:
            parts = json.loads((self.folder / (topic + _REASONS)).read_text("utf-8"))
        except (OSError, ValueError):
            return None
        return {str(k): str(v) for k, v in parts.items()} if isinstance(parts, dict) else None

    def remember_parts(self, topic: str, parts: Mapping[str, str]) -> None:
        """Keep what decided a result, to tell next time what has changed."""
        path = self.folder / (topic + _REASONS)
        with contextlib.suppress(OSError), atomic_file(path) as temporary:
            temporary.write_text(json.dumps(dict(parts)), "utf-8")

    def info(self) -> StoreInfo:
        """How much there is."""
        sizes = [size for _, size, _ in self._files()]
        records = sum(path.suffix == _RECORD for path, _, _ in self._files())
        return StoreInfo(self.folder, records, sum(sizes), self._limit)

    def clear(self) -> StoreInfo:
        """Remove everything the store has put there, and say what it was."""
        held = self.info()
        for path, _, _ in self._files():
            with contextlib.suppress(OSError):
                path.unlink()
        return held

    def _make_room(self, needed: int) -> None:
        """Remove what was not used for longest until so much fits."""
        if self._held is None:
            self._held = sum(size for _, size, _ in self._files())
        if self._held + needed <= self._limit:
            return
        files = sorted(self._files(), key=lambda file: file[2])
        held = sum(size for _, size, _ in files)
        for path, size, _ in files:
            # Room for more than this one, so that not every record looks through the folder.
            if held + needed <= 0.9 * self._limit:
                break
            with contextlib.suppress(OSError):
                path.unlink()
                held -= size
        self._held = held

    def _files(self) -> list[tuple[Path, int, float]]:
        """The store's own files: path, size, time of last use; others' are left alone."""
        found = []
        with contextlib.suppress(OSError):
            for path in self.folder.iterdir():
                with contextlib.suppress(OSError):  # it may go at any time
                    status = path.stat()
                    if path.suffix in (_RECORD, _REASONS):
                        found.append((path, status.st_size, status.st_mtime))
        return found


def _array(data: bytes) -> np.ndarray:
    """The array of an npy file, which cannot be written to: its bytes are not copied."""
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    if version != (1, 0):  # what numpy writes where field names are ASCII
        raise ValueError(f"npy version {version}")
    shape, by_columns, dtype = np.lib.format.read_array_header_1_0(stream)
    if dtype.hasobject:
        raise ValueError("Python objects")
    values = np.frombuffer(data, dtype, offset=stream.tell())
    return values.reshape(shape, order="F" if by_columns else "C")
