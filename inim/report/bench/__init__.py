"""The report of a bench: `bench.json`, `bench.md`, `bench.html` and the plots."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.files.image import write_atomically
from inim.report.bench.part import Part, Table
from inim.report.strict_json import from_strict, to_strict

__all__ = ["SCHEMA", "Part", "Table", "scene_parts", "write_bench"]

SCHEMA = "inim.bench/1"

#: What a bench shows, from the contents of bench.json.
PartsOf = Callable[[Mapping[str, Any]], Sequence[Part]]


def scene_parts(data: Mapping[str, Any]) -> list[Part]:
    """Time against error, where methods were timed on a scene."""
    from inim.report.bench.plots import draw_scene
    from inim.report.bench.tables import scene_table

    if not data.get("contenders"):
        return []
    lead = (
        "Down and left is better. Coloured: no other is as fast and as good. Grey: another is "
        "both. The picture scored is the very one that was timed, display-ready 8-bit sRGB. "
        "A point's whisker ends at its fastest run."
    )
    tables = [scene_table(data)]
    return [Part("scene", "Time against error", lead, tables, "pareto", draw_scene(data))]


def write_bench(data: Mapping[str, Any], folder: Path, parts_of: PartsOf = scene_parts) -> None:
    """Write all forms of a bench into a folder, `bench.json` last: it marks a whole one.

    Parameters
    ----------
    data : mapping
        Schema `inim.bench/1`; `files` is added here.
    folder : Path
        Empty; the plots are written first, for the page shows them.
    parts_of : callable
        What is shown of the data, which are as they are read from `bench.json`.
    """
    from inim.report.bench.page import render_page
    from inim.report.bench.plots import save
    from inim.report.bench.tables import render_markdown

    shown = from_strict(to_strict(data))
    parts = parts_of(shown)
    plots = [name for one in parts if one.figure for name in save(one.figure, folder, one.plot)]
    files = sorted([*plots, "bench.html", "bench.json", "bench.md"])
    strict = to_strict({**data, "files": files})
    texts = {
        "bench.md": render_markdown(shown, parts),
        "bench.html": render_page(shown, parts, folder),
        "bench.json": json.dumps(strict, indent=1, allow_nan=False, ensure_ascii=False),
    }
    for name, text in texts.items():
        _write(folder / name, text + "\n")


def _write(path: Path, text: str) -> None:
    write_atomically(path, lambda p: _put(p, text))


def _put(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", errors="backslashreplace")
