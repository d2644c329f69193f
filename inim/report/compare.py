"""The report of a comparison of two runs: page, data, JUnit and Markdown."""

from __future__ import annotations

from pathlib import Path

import msgspec

from inim.documents.compare import CompareDocument
from inim.documents.files import folder_files, write_forms
from inim.report.images import ENCODINGS, Images
from inim.report.markup import text, text_table
from inim.report.page import Section, check_badge, data_note, render_page, timestamp
from inim.report.sections.record import check_list
from inim.report.sections.regression import regression
from inim.report.summary import render_checks, render_junit
from inim.report.wording import MISSING

_SHOWN = ("title", "created", "inim", "mitsuba", "libLLVM", "device", "threads", "seed")


def write_comparison(data: CompareDocument, folder: Path) -> None:
    """Write all forms of a comparison into a folder, `compare.json` last: it marks a whole one.

    Parameters
    ----------
    data : CompareDocument
        `files` is added here.
    folder : Path
        Its images lie there already.
    """
    forms = {
        "compare.html": lambda data: _page(data, folder),
        "junit.xml": render_junit,
        "summary.md": render_checks,
    }
    files = folder_files(folder, "compare.json", *forms)
    whole = msgspec.structs.replace(data, files=files)
    write_forms(whole, folder, "compare.json", forms)


def _page(data: CompareDocument, folder: Path) -> str:
    return render_page(
        data.title,
        [text(f"{data.after.folder} against {data.before.folder}"), timestamp(data)],
        [
            Section("regression", "What changed", regression(data, Images(folder, ENCODINGS[0]))),
            Section("checks", "Checks", check_list(data.verdict)),
            Section("runs", "The two runs", _runs(data)),
        ],
        window_title=f"{data.title}: {data.verdict.word} – inim comparison",
        footer=data_note(data, "compare.json"),
        verdict_badge=check_badge(data.verdict),
    )


def _runs(data: CompareDocument) -> str:
    sides = [msgspec.to_builtins(side.circumstances) for side in (data.before, data.after)]
    rows = [[name, *(side.get(name, MISSING) for side in sides)] for name in _SHOWN]
    return text_table("What made them", ["", "Before", "After"], rows, "facts")
