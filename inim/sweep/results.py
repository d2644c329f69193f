"""Finished results of a sweep: one small file for each algorithm of each unit, whole or not there.

They lie in ``OUT/units/HASH/ALGORITHM.json``. The table is made of them alone, so whatever is
killed loses what it had in work and nothing else, and whoever does the same work twice writes the
same file.
"""

from __future__ import annotations

import json
import os
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from inim.errors import FileError
from inim.report.files import from_strict, to_strict

__all__ = ["FOLDER", "SCHEMA", "Results"]

SCHEMA = "inim.unit/1"
FOLDER = "units"


@dataclass(frozen=True)
class Results:
    """The results in the folder of a sweep.

    Attributes
    ----------
    out : Path
        Of the sweep; on a cluster, a folder that all its machines share.
    """

    out: Path

    def path(self, unit: str, algorithm: str) -> Path:
        """Where a result lies, or will."""
        return self.out / FOLDER / unit / f"{algorithm}.json"

    def read(self, unit: str, algorithm: str, making: Mapping[str, Any]) -> dict[str, Any] | None:
        """A result; None where there is none of this making that can be read."""
        try:
            found = json.loads(self.path(unit, algorithm).read_text(encoding="utf-8"))
            asked = {"schema": SCHEMA, "unit": unit, "algorithm": algorithm, "making": dict(making)}
            if any(found[key] != value for key, value in asked.items()) or not found["rows"]:
                return None
            return from_strict(found)
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return None

    def write(self, unit: str, algorithm: str, content: Mapping[str, Any]) -> None:
        """Put a result there, whole: a reader sees it or does not.

        Raises
        ------
        FileError
            The folder cannot be written.
        """
        path = self.path(unit, algorithm)
        strict = to_strict({"schema": SCHEMA, "unit": unit, "algorithm": algorithm, **content})
        # A process's number is its own on one machine only, and the folder may be shared.
        temporary = path.with_name(f".{uuid.uuid4().hex}.tmp")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with temporary.open("w", encoding="utf-8") as file:
                json.dump(strict, file, indent=1, allow_nan=False, ensure_ascii=False)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        except OSError as error:
            raise FileError(
                f"{path}: cannot be written ({error.strerror}); free some space or choose another "
                "folder with -o"
            ) from None
        finally:
            temporary.unlink(missing_ok=True)
