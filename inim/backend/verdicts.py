"""Verdicts on backends, remembered from one process to the next."""

from __future__ import annotations

import contextlib
import os
import re
import sys
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from inim.backend import machine
from inim.backend.trial import Verdict, probe

__all__ = ["REMEMBERED", "cache_file", "verdict_on"]

REMEMBERED = 64
_METADATA = r"(?:drjit|mitsuba)-.*\.(?:dist|egg)-info"


def verdict_on(
    variant: str, library: Path, variables: dict[str, str], extra: Sequence[str] = ()
) -> Verdict:
    """The remembered verdict on a backend, or else that of a trial now.

    Parameters
    ----------
    variant : str
        The Mitsuba variant to start.
    library : Path
        What it stands on: a libLLVM, or CUDA's driver.
    variables : dict
        Environment variables to add for the trial.
    extra : sequence of str
        Whatever else the verdict depends on.
    """
    # Where dependencies are looked for is part of what was tried.
    key = _fingerprint(variant, library, [variables.get("LD_LIBRARY_PATH", ""), *extra])
    known = _from_cache(_read_cache().get(key))
    if known:
        return known
    verdict = probe(variant, variables)
    if key and verdict.lasting:
        # Re-read: another process may have added its own meanwhile.
        _write_cache({**_read_cache(), key: verdict._asdict()})
    return verdict


def cache_file() -> Path | None:
    """Where verdicts are remembered, or None where the user has no home."""
    folder = machine.user_folder("XDG_CACHE_HOME", ".cache")
    return folder / "backends.json" if folder else None


def _fingerprint(variant: str, library: Path, extra: Sequence[str]) -> str:
    """All that the verdict depends on; empty when the file cannot be looked at."""
    try:
        stat = library.stat()
    except OSError:
        return ""
    parts = [variant, f"{library.resolve()}:{stat.st_size}:{stat.st_mtime_ns}", sys.version]
    parts += [*_renderer(), f"{zlib.crc32(machine.cpu_text().encode()):x}"]
    return "|".join([*parts, *extra])


def _renderer() -> list[str]:
    """Names and times of the metadata folders of Dr.Jit and Mitsuba: each installation's own.

    importlib.metadata says the version, but takes longer to load than all else here takes to run.
    """
    found = []
    for folder in sys.path:
        with contextlib.suppress(OSError), os.scandir(folder or ".") as entries:
            found += [
                f"{entry.name}:{entry.stat().st_mtime_ns}"
                for entry in entries
                if re.fullmatch(_METADATA, entry.name)
            ]
    return sorted(found)


def _from_cache(entry: object) -> Verdict | None:
    """The remembered verdict, or None for an entry that another hand has written."""
    if not isinstance(entry, dict) or not isinstance(entry.get("usable"), bool):
        return None
    try:
        return Verdict(**entry)
    except TypeError:
        return None


def _read_cache() -> dict[str, Any]:
    import json

    path = cache_file()
    try:
        content = json.loads(path.read_text("utf-8")) if path else {}
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _write_cache(entries: dict[str, Any]) -> None:
    import json

    path = cache_file()
    if path is None:
        return
    newest = dict(list(entries.items())[-REMEMBERED:])
    partial = path.with_name(f"{path.name}.{os.getpid()}")
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(json.dumps(newest, indent=1), "utf-8")
        partial.replace(path)
