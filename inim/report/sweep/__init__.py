"""The report of a sweep: one page over all rows of its table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.files.image import write_atomically

__all__ = ["PAGE", "write_page"]

PAGE = "sweep.html"


def write_page(path: Path, rows: Sequence[Mapping[str, Any]], about: Mapping[str, str]) -> None:
    """Write the page, whole or not at all.

    Parameters
    ----------
    path : Path
    rows : sequence of mapping
        Of the table; see README, Sweeps.
    about : mapping of str to str
        `title`, `command`, `created`, `inim_version`.
    """
    from inim.report.sweep.page import render_page

    page = render_page(rows, about)

    def put(temporary: Path) -> None:
        temporary.write_text(page, encoding="utf-8", errors="backslashreplace")

    write_atomically(path, put)
