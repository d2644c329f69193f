"""The report of a bench: `bench.json`, `bench.md`, `bench.html` and the plots."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from inim.files.image import write_atomically
from inim.report.strict_json import from_strict, to_strict

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
    from inim.report.bench.page import render_page
    from inim.report.bench.plots import draw_plots
    from inim.report.bench.tables import render_markdown

    plots = draw_plots(data, folder)
    files = sorted([*plots, "bench.html", "bench.json", "bench.md"])
    strict = to_strict({**data, "files": files})
    data = from_strict(strict)
    texts = {
        "bench.md": render_markdown(data),
        "bench.html": render_page(data, folder),
        "bench.json": json.dumps(strict, indent=1, allow_nan=False, ensure_ascii=False),
    }
    for name, text in texts.items():
        _write(folder / name, text + "\n")


def _write(path: Path, text: str) -> None:
    write_atomically(path, lambda p: _put(p, text))


def _put(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", errors="backslashreplace")
