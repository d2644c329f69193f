"""The report of a bench: `bench.json`, `bench.md`, `bench.html` and the plots."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.report.bench.part import Part, Table
from inim.report.files import from_strict, list_files, to_strict, write_forms

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
    from inim.report.bench.page import render_bench
    from inim.report.bench.plots import save
    from inim.report.bench.tables import render_markdown

    parts = parts_of(from_strict(to_strict(data)))
    for one in parts:
        if one.figure is not None:
            save(one.figure, folder, one.plot)
    forms = {
        "bench.md": lambda data: render_markdown(data, parts),
        "bench.html": lambda data: render_bench(data, parts, folder),
    }
    write_forms(list_files(data, folder, "bench.json", *forms), folder, "bench.json", forms)
