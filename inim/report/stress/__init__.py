"""The report of a stress run: `stress.json`, `stress.md`, `stress.html` and the figure."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from inim.report.files import list_files, write_forms

__all__ = ["SCHEMA", "write_stress"]

SCHEMA = "inim.stress/1"
# Digits of figures in the file: enough for any table, and a third of its size.
_DIGITS = 6


def write_stress(data: Mapping[str, Any], folder: Path) -> None:
    """Write all forms of a stress run into a folder, `stress.json` last: it marks a whole one.

    Parameters
    ----------
    data : mapping
        Schema `inim.stress/1`; `files` is added here.
    folder : Path
        Empty; the figure is written first, for the page shows it.
    """
    from inim.report.stress.page import render_stress
    from inim.report.stress.plots import draw_plots
    from inim.report.stress.tables import render_markdown

    draw_plots(data, folder)
    forms = {
        "stress.md": render_markdown,
        "stress.html": lambda data: render_stress(data, folder),
    }
    listed = _short(list_files(data, folder, "stress.json", *forms))
    write_forms(listed, folder, "stress.json", forms, encode=_as_text)


def _short(value: Any) -> Any:
    """Floats to so many significant digits."""
    if isinstance(value, Mapping):
        return {key: _short(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_short(one) for one in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def _as_text(strict: Mapping[str, Any]) -> str:
    """JSON with one row to a line: readable, and differences of two runs show."""
    parts = []
    for key, value in strict.items():
        if isinstance(value, list) and value and isinstance(value[0], dict):
            rows = ",\n  ".join(_compact(row) for row in value)
            parts.append(f" {_compact(key)}: [\n  {rows}\n ]")
        else:
            parts.append(f" {_compact(key)}: {_compact(value)}")
    return "{\n" + ",\n".join(parts) + "\n}"


def _compact(value: Any) -> str:
    return json.dumps(value, allow_nan=False, ensure_ascii=False)
