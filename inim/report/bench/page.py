"""The page of a bench: plots and tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.report.bench.part import Part, Table
from inim.report.bench.tables import remarks, thread_words
from inim.report.markup import bullets, element, plot, table, text
from inim.report.page import Section, data_note, how_to_reproduce, render_page, timestamp
from inim.report.wording import MISSING, items, part

__all__ = ["render_bench"]

_STYLE = """
.plot img { max-width: 1160px; }
.bench th, .bench td { white-space: nowrap; }
.bench th:not(:first-child), .bench td { text-align: right; }
.bench thead th { white-space: normal; vertical-align: bottom; overflow-wrap: normal; }
.bench table { font-size: 13px; width: auto; min-width: min(100%, 700px); }
.bench th, .bench td { padding-left: 5px; padding-right: 5px; }
.bench { margin-bottom: 24px; }
.claims { padding-left: 1.2em; max-width: 90ch; }
.claims li { margin-bottom: 8px; }
.remarks { max-width: 90ch; padding-left: 1.2em; }
"""


def render_bench(data: Mapping[str, Any], parts: Sequence[Part], folder: Path) -> str:
    """The whole bench as one HTML page.

    Parameters
    ----------
    data : mapping
        The contents of bench.json, schema ``inim.bench/1``.
    parts : sequence of Part
    folder : Path
        Where the plots lie; they are embedded.
    """
    sections = [Section("conditions", "Conditions", _conditions(data, parts))]
    for one in parts:
        body = element("p", text(one.lead), class_="lead") + _plot(folder, one.plot, one.title)
        body += _claims(*one.claims) + "".join(map(_table, one.tables))
        sections.append(Section(one.name, one.title, body))
    title = data.get("title", "Bench")
    return render_page(
        title,
        _facts(data),
        [*sections, how_to_reproduce(data)],
        window_title=f"{title} – inim",
        footer=data_note(data, "bench.json"),
        style=_STYLE,
    )


def _facts(data: Mapping[str, Any]) -> list[str]:
    display = part(data, "display", "given").get("name")
    return [
        *([f"Display {text(display)}"] if display else []),
        text(thread_words(data)),
        text(part(data, "backend").get("device", MISSING)),
        f"inim {text(data.get('inim_version', MISSING))}",
        timestamp(data),
    ]


def _conditions(data: Mapping[str, Any], parts: Sequence[Part]) -> str:
    return bullets(items(data, "warnings"), "cautions") + bullets(remarks(data, parts), "remarks")


def _plot(folder: Path, name: str, title: str) -> str:
    try:
        return plot((folder / f"{name}.svg").read_bytes(), title)
    except OSError:
        return ""


def _table(found: Table) -> str:
    rows = [[text(cell) for cell in row] for row in found.rows]
    return table(found.caption, [text(h) for h in found.heads], rows, "bench")


def _claims(heading: str, lines: Sequence[str]) -> str:
    return element("h3", text(heading)) + bullets(lines, "claims") if lines else ""
