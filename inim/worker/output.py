"""Output folders that appear whole or not at all."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from inim.errors import FileError
from inim.regular_file import read_file

__all__ = ["default_out", "open_staging", "publish"]

_MARKER = "report.json"
# While files move: those of the run before and of this one, should it be killed meanwhile.
_MOVING = ".moving.json"
_PARTIAL = ".partial"
_MOST_MARKER_BYTES = 2**24
# The staging folders of this process, each with a descriptor that locks it: a lock ends with its
# process, however that ends.
_locks: dict[Path, int] = {}


def default_out(source: Path | None, kind: str) -> Path:
    """Where a result goes when nobody says: into the current folder, named after its source."""
    return Path(kind if source is None else f"{source.stem}-{kind}")


def open_staging(out: Path) -> Path:
    """A fresh folder beside `out`, on the same file system, to build a result in.

    Raises
    ------
    FileError
        When `out` is a file or its place cannot be written, found out before any work is done.
    """
    try:
        if os.path.lexists(out) and not out.is_dir():  # a link to nowhere is no folder either
            raise FileError(f"{out}: is a file; choose a folder with -o")
        out.parent.mkdir(parents=True, exist_ok=True)
        if out.is_dir() and not os.access(out, os.W_OK):
            raise FileError(f"{out}: the folder is read-only; choose another with -o")
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

    Files of other origin in `out` are left alone. The report's JSON, `marker`, goes last and its
    predecessor is removed first, so that a killed run never leaves a report of mixed origin.

    Raises
    ------
    FileError
        When a file cannot be moved.
    """
    try:
        staging.chmod(0o755)  # mkdtemp's folders are private
        with _alone(out.parent):
            if not out.exists():
                staging.replace(out)
                return
            _move_into(staging, out, marker)
        shutil.rmtree(staging, ignore_errors=True)
    except OSError as error:
        raise FileError(f"{out}: cannot be written ({error.strerror})") from None


def _move_into(staging: Path, out: Path, marker: str) -> None:
    files = [p.relative_to(staging) for p in sorted(staging.rglob("*")) if p.is_file()]
    for name in files:  # found out before anything in `out` is touched
        folders = [out / folder for folder in name.parents]
        blocked = [p for p in folders if os.path.lexists(p) and not p.is_dir()]
        if blocked or (out / name).is_dir():
            path = blocked[0] if blocked else out / name
            raise FileError(f"{path}: is in the way of the report; choose another -o")
    names = {str(f) for f in files}
    earlier = _files_of_earlier_run(out, marker) | _files_of_earlier_run(out, _MOVING)
    (staging / _MOVING).write_text(json.dumps({"files": sorted(earlier | names)}), "utf-8")
    (staging / _MOVING).replace(out / _MOVING)
    (out / marker).unlink(missing_ok=True)
    for stale in earlier - names:
        (out / stale).unlink(missing_ok=True)
    for name in sorted(files, key=lambda f: (str(f) == marker, str(f))):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (staging / name).replace(out / name)
    (out / _MOVING).unlink(missing_ok=True)


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


def _files_of_earlier_run(out: Path, marker: str) -> set[str]:
    """Files that the report in `out` lists as its own, and that lie inside `out`."""
    try:
        listed = json.loads(read_file(out / marker, _MOST_MARKER_BYTES))["files"]
        names = {str(name) for name in listed}
    except (FileError, ValueError, KeyError, TypeError, RecursionError):
        return set()
    root = out.resolve()
    return {name for name in names if _is_in(root, name)}


def _is_in(root: Path, name: str) -> bool:
    """Whether a name is that of a file in a folder, whatever it is made of."""
    try:
        path = (root / name).resolve()
        return path.is_file() and path.is_relative_to(root)
    except (OSError, ValueError, RuntimeError):  # too long, no text, or a circle of links
        return False
