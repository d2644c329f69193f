"""The report of a stress run: `stress.json`, `stress.md` and `stress.html`."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.files.image import write_atomically
from inim.report.stress.page import render_page
from inim.report.stress.tables import Table, render_markdown, summary_lines, tables_of
from inim.report.strict_json import from_strict, to_strict

__all__ = ["SCHEMA", "write_stress"]

SCHEMA = "inim.stress/2"
# Digits of figures in the file: enough for any table, and a third of its size.
_DIGITS = 6


def write_stress(
    data: Mapping[str, Any],
    folder: Path,
    *,
    tables: Callable[[Mapping[str, Any]], Sequence[Table]] = tables_of,
    lines: Callable[[Mapping[str, Any]], Sequence[str]] = summary_lines,
) -> None:
    """Write all forms of a stress run into a folder, `stress.json` last: it marks a whole one.

    Parameters
    ----------
    data : mapping
        Schema `inim.stress/2`, or another that `tables` and `lines` know; `files` is added here.
    folder : Path
        Empty but for figures; the page shows `stress.svg`.
    tables, lines : callable
        Tables and sentences of the page and of the Markdown, made from what was written.
    """
    figures = [p.name for p in folder.iterdir() if p.suffix in (".png", ".svg")]
    files = sorted([*figures, "stress.html", "stress.json", "stress.md"])
    strict = to_strict(_short({**data, "files": files}))
    data = from_strict(strict)
    made, said = tables(data), lines(data)
    texts = {
        "stress.md": render_markdown(data, made, said),
        "stress.html": render_page(data, folder, made, said),
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
