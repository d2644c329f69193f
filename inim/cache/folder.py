"""Where the store's records lie, and what a killed process leaves there."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from inim.process import interruption

FOLDER_VARIABLE = "INIM_CACHE"
_OFF = "off"
PARTIAL = ".partial"


def store_folder() -> Path | None:
    """Where results are kept; None where they are not, or nobody knows the user's home."""
    named = os.environ.get(FOLDER_VARIABLE, "")
    if named:
        return None if named.lower() == _OFF else Path(named)
    base = os.environ.get("XDG_CACHE_HOME", "")
    if not Path(base).is_absolute():
        base = os.path.expanduser("~/.cache")  # noqa: PTH111 (stays as it is where there is none)
    return Path(base) / "inim" if Path(base).is_absolute() else None


def clear_partials(process: int) -> None:
    """Remove what a process that was killed has left half written in the user's store.

    Should the number be one on another machine, too, that shares the folder and is just writing,
    then its record is not kept.
    """
    folder = store_folder()
    if folder is not None:
        with contextlib.suppress(OSError):
            for path in list(folder.glob(f"{process}.*{PARTIAL}")):
                interruption.remove_file(path)
