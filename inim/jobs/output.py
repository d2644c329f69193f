"""Output folders that appear whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from pathlib import Path

from inim.errors import FileError

__all__ = ["open_staging", "publish"]

_MARKER = "report.json"


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
        return Path(tempfile.mkdtemp(prefix=prefix, suffix=".partial", dir=out.parent))
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
        if not out.exists():
            staging.replace(out)
            return
        files = [p.relative_to(staging) for p in sorted(staging.rglob("*")) if p.is_file()]
        for name in files:  # found out before anything in `out` is touched
            folders = [out / folder for folder in name.parents]
            blocked = [p for p in folders if os.path.lexists(p) and not p.is_dir()]
            if blocked or (out / name).is_dir():
                path = blocked[0] if blocked else out / name
                raise FileError(f"{path}: is in the way of the report; choose another -o")
        earlier = _files_of_earlier_run(out, marker)
        (out / marker).unlink(missing_ok=True)
        for stale in earlier - {str(f) for f in files}:
            (out / stale).unlink(missing_ok=True)
        for name in sorted(files, key=lambda f: (str(f) == marker, str(f))):
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            (staging / name).replace(out / name)
        shutil.rmtree(staging, ignore_errors=True)
    except OSError as error:
        raise FileError(f"{out}: cannot be written ({error.strerror})") from None


def _files_of_earlier_run(out: Path, marker: str) -> set[str]:
    """Files that the report in `out` lists as its own, and that lie inside `out`."""
    try:
        listed = json.loads((out / marker).read_text(encoding="utf-8"))["files"]
        names = {str(name) for name in listed}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return set()
    root = out.resolve()
    return {
        name
        for name in names
        if (root / name).is_file() and (root / name).resolve().is_relative_to(root)
    }
