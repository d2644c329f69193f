"""The report of a comparison of two runs: page, data, JUnit and Markdown."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from inim.report.files import list_files, write_forms
from inim.report.images import ENCODINGS, Images
from inim.report.markup import text, text_table
from inim.report.page import Section, check_badge, data_note, render_page, timestamp
from inim.report.sections.record import check_list
from inim.report.sections.regression import regression
from inim.report.summary import render_checks, render_junit
from inim.report.wording import MISSING, part, verdict

SCHEMA = "inim.compare/1"
_SHOWN = ("title", "created", "inim", "mitsuba", "libLLVM", "device", "threads", "seed")
_SIDES = ("before", "after")


def write_comparison(data: Mapping[str, Any], folder: Path) -> None:
    """Write all forms of a comparison into a folder, `compare.json` last: it marks a whole one.

    Parameters
    ----------
    data : mapping
        Schema `inim.compare/1`; `files` is added here.
    folder : Path
        Its images lie there already.
    """
    forms = {
        "compare.html": lambda data: _page(data, folder),
        "junit.xml": render_junit,
        "summary.md": render_checks,
    }
    write_forms(list_files(data, folder, "compare.json", *forms), folder, "compare.json", forms)


def _page(data: Mapping[str, Any], folder: Path) -> str:
    before, after = (part(data, side).get("folder", MISSING) for side in _SIDES)
    return render_page(
        data.get("title"),
        [text(f"{after} against {before}"), timestamp(data)],
        [
            Section("regression", "What changed", regression(data, Images(folder, ENCODINGS[0]))),
            Section("checks", "Checks", check_list(data)),
            Section("runs", "The two runs", _runs(data)),
        ],
        window_title=f"{data.get('title', MISSING)}: {verdict(data)} – inim comparison",
        footer=data_note(data, "compare.json"),
        verdict_badge=check_badge(data),
    )


def _runs(data: Mapping[str, Any]) -> str:
    sides = [part(data, side, "circumstances") for side in _SIDES]
    rows = [[name, *(side.get(name, MISSING) for side in sides)] for name in _SHOWN]
    return text_table("What made them", ["", "Before", "After"], rows, "facts")
