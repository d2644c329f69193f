"""The report of a stress run: `stress.json`, `stress.md`, `stress.html` and the figure."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from inim.files.image import write_atomically
from inim.report.strict_json import from_strict, to_strict

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
    from inim.report.stress.page import render_page
    from inim.report.stress.plots import draw_plots
    from inim.report.stress.tables import render_markdown

    plots = draw_plots(data, folder)
    files = sorted([*plots, "stress.html", "stress.json", "stress.md"])
    strict = to_strict(_short({**data, "files": files}))
    data = from_strict(strict)
    texts = {
        "stress.md": render_markdown(data),
        "stress.html": render_page(data, folder),
        "stress.json": _as_text(strict),
    }
    for name, text in texts.items():
        _write(folder / name, text + "\n")


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


def _write(path: Path, text: str) -> None:
    write_atomically(path, lambda p: _put(p, text))


def _put(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", errors="backslashreplace")
