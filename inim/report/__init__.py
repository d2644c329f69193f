"""Reports: what a validation found, as data and in the forms people and machines read."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from inim.errors import FileError
from inim.formats.image import write_atomically

__all__ = ["SCHEMA", "Report"]

SCHEMA = "inim.report/1"


@dataclass(frozen=True)
class Report:
    """A finished validation: its folder and the content of its `report.json`.

    Attributes
    ----------
    folder : Path
        Holds `report.json`, `report.html`, `junit.xml`, `summary.md` and the pictures.
    data : mapping
        Schema `inim.report/1`; see the README.
    """

    folder: Path
    data: Mapping[str, Any]

    @property
    def passed(self) -> bool:
        """Whether every check passed; False too when there is no verdict at all."""
        return self.data.get("verdict", {}).get("passed") is True

    @property
    def html_path(self) -> Path:
        """The file to open in a browser."""
        return self.folder / "report.html"

    @classmethod
    def load(cls, folder: Path | str) -> Report:
        """Read a report from its folder.

        Raises
        ------
        FileError
            No report there, or one of another schema.
        """
        path = Path(folder) / "report.json"
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise FileError(f"{path}: cannot be read ({error.strerror})") from None
        except ValueError as error:
            raise FileError(f"{path}: not a JSON report ({error})") from None
        if not isinstance(data, dict) or data.get("schema") != SCHEMA:
            raise FileError(f"{path}: not of schema {SCHEMA}; make it anew with inim validate")
        return cls(path.parent, data)

    def write(self) -> None:
        """Write all four forms into the folder, `report.json` last: it marks a whole report."""
        from inim.report.html import render_html
        from inim.report.junit import render_junit
        from inim.report.summary import render_summary

        data = dict(self.data)
        texts = {
            "report.html": render_html(data, self.folder),
            "junit.xml": render_junit(data),
            "summary.md": render_summary(data),
            "report.json": json.dumps(_plain(data), indent=1, allow_nan=False, ensure_ascii=False),
        }
        for name, text in texts.items():
            _write_text(self.folder / name, text)

    def _repr_html_(self) -> str:
        return self.html_path.read_text(encoding="utf-8")


def _write_text(path: Path, text: str) -> None:
    write_atomically(path, lambda p: _put(p, text + "\n"))


def _put(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def _plain(value: Any) -> Any:
    """JSON has no infinity and no NaN: both become null."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
