"""The report of a bench: `bench.json`, `bench.md`, `bench.html` and the plots."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from inim.report.files import list_files, write_forms

__all__ = ["SCHEMA", "write_bench"]

SCHEMA = "inim.bench/1"


def write_bench(data: Mapping[str, Any], folder: Path) -> None:
    """Write all forms of a bench into a folder, `bench.json` last: it marks a whole one.

    Parameters
    ----------
    data : mapping
        Schema `inim.bench/1`; `files` is added here.
    folder : Path
        Empty; the plots are written first, for the page shows them.
    """
    from inim.report.bench.page import render_bench
    from inim.report.bench.plots import draw_plots
    from inim.report.bench.tables import render_markdown

    draw_plots(data, folder)
    forms = {"bench.md": render_markdown, "bench.html": lambda data: render_bench(data, folder)}
    write_forms(list_files(data, folder, "bench.json", *forms), folder, "bench.json", forms)
