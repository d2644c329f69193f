"""Output folders that appear whole or not at all."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Container, Iterator, Mapping, Sequence, Set
from pathlib import Path
from typing import BinaryIO

from inim.errors import FileError
from inim.process import interruption

_MARKER = "report.json"
#: What a report has at its top, whatever else it has: the data, which mark a whole one, first.
REPORT = (_MARKER, "report.html", "junit.xml", "summary.md", "eia/", "truth/", "views/")
SCHEMA = "inim.files/1"
_MOST_LIST_BYTES = 2**26
_BLOCK_BYTES = 2**20
_PARTIAL = ".partial"
_REMOVALS, _BETWEEN_REMOVALS_S = 5, 0.02
# The staging folders of this process, each with a descriptor that locks it: a lock ends with its
# process, however that ends.
_locks: dict[Path, int] = {}


def default_out(source: Path | None, kind: str) -> Path:
    """Where a result goes when nobody says: into the current folder, named after its source."""
    return Path(kind if source is None else f"{source.stem}-{kind}")


def open_beside(out: Path) -> Path:
    """A fresh folder beside a file that is to be made, on the same file system.

    Raises
    ------
    FileError
        Its place cannot be written.
    """
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(prefix=f".{out.stem[:32]}.", suffix=_PARTIAL, dir=out.parent))
    except OSError as error:
        raise _unwritable(out, error) from None


def publish_file(made: Path, out: Path) -> None:
    """Put a file that is whole where it belongs.

    Raises
    ------
    FileError
        Its place cannot be written.
    """
    try:
        with interruption.publishing():
            made.replace(out)
    except OSError as error:
        raise _unwritable(out, error) from None


def _unwritable(out: Path, error: OSError) -> FileError:
    return FileError(f"{out}: cannot be written ({error.strerror}); choose another place")


def open_staging(out: Path, names: Sequence[str] = REPORT) -> Path:
    """A fresh folder beside `out`, on the same file system, to build a result in.

    Parameters
    ----------
    out : Path
    names : sequence of str
        Files and folders/ that the result will have for certain, its JSON first.

    Raises
    ------
    FileError
        When `out` is a file or its place cannot be written, or when a file of other origin is in
        the way; found out before any work is done.
    """
    try:
        if os.path.lexists(out) and not out.is_dir():  # a link to nowhere is no folder either
            raise FileError(f"{out}: is a file; choose a folder with -o")
        out.parent.mkdir(parents=True, exist_ok=True)
        if out.is_dir() and not os.access(out, os.W_OK):
            raise FileError(f"{out}: the folder is read-only; choose another with -o")
        if out.is_dir():
            with _open(out) as folder:
                earlier = _read_list(folder, list_name(names[0]), out)
                for name in names:
                    _check_way(folder, name, earlier, out)
        prefix = f".{out.name[:32]}."  # a name may be as long as the file system allows
        with _alone(out.parent):
            _clear_away(out.parent, prefix)
            staging = Path(tempfile.mkdtemp(prefix=prefix, suffix=_PARTIAL, dir=out.parent))
            _lock(staging)
        return staging
    except OSError as error:
        raise FileError(
            f"{out}: cannot be written ({error.strerror}); choose another folder with -o"
        ) from None


def publish(staging: Path, out: Path, marker: str = _MARKER) -> None:
    """Move a finished result into `out`, replacing what an earlier run put there.

    Files of other origin in `out` are left alone: only what the list in `out` names is replaced,
    and only what it names, and is still what was written, is deleted. No link below `out` is
    followed. The report's JSON, `marker`, goes last and its predecessor is removed first, so that a
    killed run never leaves a report of mixed origin.

    Raises
    ------
    FileError
        When a file cannot be moved, or one of other origin is in the way.
    """
    try:
        staging.chmod(0o755)  # mkdtemp's folders are private
        digests = _digests(staging)
        with interruption.publishing(), _alone(out.parent):
            if os.path.lexists(out):
                with _open(out) as folder:
                    _move_into(staging, folder, out, digests, marker)
            else:
                _write_list(staging / list_name(marker), _each(digests))
                staging.replace(out)
        remove_folder(staging)
    except OSError as error:
        raise FileError(f"{out}: cannot be written ({error.strerror})") from None


@contextlib.contextmanager
def published(out: Path, names: Sequence[str]) -> Iterator[Path]:
    """A folder to write these files in; they are moved into `out` when the block ends well.

    Raises
    ------
    FileError
        As `open_staging` and `publish`; the first name is the list's marker.
    """
    with interruption.undone_afterwards(lambda: open_staging(out, names), remove_folder) as staging:
        yield staging
        publish(staging, out, names[0])


def remove_folder(folder: Path) -> None:
    """Remove a folder and all in it, which may be gone."""
    # A thread that still writes may put a file where it was just emptied.
    for _ in range(_REMOVALS):
        shutil.rmtree(folder, ignore_errors=True)
        if not folder.exists():
            break
        time.sleep(_BETWEEN_REMOVALS_S)


def _move_into(
    staging: Path, folder: int, out: Path, digests: Mapping[str, str], marker: str
) -> None:
    listed = list_name(marker)
    earlier = _read_list(folder, listed, out)
    for name in digests:  # found out before anything in `out` is touched
        _check_way(folder, name, earlier, out)
    new = _each(digests)
    both = {name: earlier.get(name, set()) | new.get(name, set()) for name in earlier | new}
    _write_list(staging / listed, both)  # should this run be killed meanwhile
    os.replace(staging / listed, listed, dst_dir_fd=folder)
    if marker in earlier:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(marker, dir_fd=folder)
    for name in earlier.keys() - digests.keys():
        _delete(folder, name, earlier[name])
    for name in sorted(digests, key=lambda name: (name == marker, name)):
        with _folder_of(folder, name, make=True) as place:
            os.replace(staging / name, Path(name).name, dst_dir_fd=place)
    _write_list(staging / listed, new)
    os.replace(staging / listed, listed, dst_dir_fd=folder)


# --- The list of what was put into a folder -----------------------------------------------------


def list_name(marker: str) -> str:
    """File name of the list of what was put into a folder with a report whose data are `marker`.

    One for each kind: a bench in a report's folder is no new report.
    """
    return f".{Path(marker).stem}-files.json"


def _each(digests: Mapping[str, str]) -> dict[str, set[str]]:
    return {name: {digest} for name, digest in digests.items()}


def _write_list(path: Path, digests: Mapping[str, Set[str]]) -> None:
    files = {name: sorted(digests[name]) for name in sorted(digests)}
    text = json.dumps({"schema": SCHEMA, "files": files}, indent=1)
    path.write_text(text + "\n", "utf-8")


def _read_list(folder: int, listed: str, out: Path) -> dict[str, set[str]]:
    """By name, the digests of what earlier runs put there; empty where there is no list.

    Raises
    ------
    FileError
        What lies in its place is no list.
    """
    try:
        with _open_file(listed, folder) as file:
            content = json.loads(file.read(_MOST_LIST_BYTES))
        if content["schema"] != SCHEMA:
            raise ValueError
        return {name: {*map(str, found)} for name, found in content["files"].items()}
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise _in_the_way(out / listed) from None


def _digests(staging: Path) -> dict[str, str]:
    """By name, the SHA-256 of each file of a result."""
    found = {}
    for path in sorted(staging.rglob("*")):
        if path.is_file():
            with path.open("rb") as file:
                found[str(path.relative_to(staging))] = _sha256(file)
    return found


def _sha256(file: BinaryIO) -> str:
    digest = hashlib.sha256()
    while block := file.read(_BLOCK_BYTES):
        digest.update(block)
    return digest.hexdigest()


def _delete(folder: int, name: str, digests: Set[str]) -> None:
    """Delete a file that is still what an earlier run wrote."""
    if not _stays_inside(name):
        return
    with (
        contextlib.suppress(OSError, ValueError),  # gone, or no file, or behind a link
        _folder_of(folder, name) as place,
    ):
        last = Path(name).name
        with _open_file(last, place) as file:
            same = _sha256(file) in digests
        if same:
            os.unlink(last, dir_fd=place)


def _stays_inside(name: str) -> bool:
    parts = name.split("/")
    return not {"", ".", ".."} & {*parts} and "\0" not in name


# --- Without following links --------------------------------------------------------------------


def _check_way(folder: int, name: str, earlier: Container[str], out: Path) -> None:
    """Raise the `FileError` that fits where a file of other origin would have to give way.

    Raises
    ------
    FileError
    """
    way = Path(name)
    for place in [*list(reversed(way.parents))[1:], way]:  # but `out` itself
        try:
            mode = os.stat(place, dir_fd=folder, follow_symlinks=False).st_mode
        except FileNotFoundError:
            return
        is_file = place == way and not name.endswith("/")
        if not (stat.S_ISREG(mode) and name in earlier if is_file else stat.S_ISDIR(mode)):
            raise _in_the_way(out / place)


def _in_the_way(path: Path) -> FileError:
    return FileError(
        f"{path}: is in the way, and not what an earlier run has put there; remove it, or choose "
        "another folder with -o"
    )


@contextlib.contextmanager
def _open(folder: str | Path, place: int | None = None) -> Iterator[int]:
    """A descriptor of a folder: of the user's own, by a link if need be, or of one below it."""
    way = os.O_RDONLY | os.O_DIRECTORY | (0 if place is None else os.O_NOFOLLOW)
    descriptor = os.open(folder, way, dir_fd=place)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def _folder_of(folder: int, name: str, *, make: bool = False) -> Iterator[int]:
    """A descriptor of the folder that a file lies in, or will."""
    with contextlib.ExitStack() as opened:
        for part in Path(name).parts[:-1]:
            if make:
                with contextlib.suppress(FileExistsError):
                    os.mkdir(part, dir_fd=folder)
            folder = opened.enter_context(_open(part, folder))
        yield folder


@contextlib.contextmanager
def _open_file(name: str, place: int) -> Iterator[BinaryIO]:
    """A regular file to read; a FIFO would wait for its writer."""
    way = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK
    with os.fdopen(os.open(name, way, dir_fd=place), "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise ValueError("no file")
        yield file


# --- One at a time ------------------------------------------------------------------------------


@contextlib.contextmanager
def undisturbed(out: Path) -> Iterator[None]:
    """Let no run publish into a folder while several of its files are read."""
    with contextlib.ExitStack() as opened:
        with contextlib.suppress(OSError):  # no such folder: whoever reads it says so
            opened.enter_context(_alone(out.parent))
        yield


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """One run at a time moves files below a folder; two would mix theirs."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # a file system without locks has to do without
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _lock(staging: Path) -> None:
    """Mark a staging folder as one whose process lives; forget those that are gone."""
    for path in [path for path in _locks if not path.exists()]:
        os.close(_locks.pop(path))
    descriptor = os.open(staging, os.O_RDONLY)
    with contextlib.suppress(OSError):
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    _locks[staging] = descriptor


def _clear_away(folder: Path, prefix: str) -> None:
    """Remove what runs that were killed have left: staging folders that nobody holds."""
    for path in folder.glob(f"{_escaped(prefix)}*{_PARTIAL}"):
        with contextlib.suppress(OSError):
            descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_DIRECTORY)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(path, ignore_errors=True)
            finally:
                os.close(descriptor)


def _escaped(text: str) -> str:
    """A name as a pattern that only matches itself."""
    return "".join(f"[{c}]" if c in "*?[" else c for c in text)
