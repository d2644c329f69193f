"""The page of a stress run: figure and tables."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from inim.report.markup import bullets, plot, table, text
from inim.report.page import Section, data_note, how_to_reproduce, render_page, timestamp
from inim.report.stress.tables import Table, summary_lines, tables_of
from inim.report.wording import MISSING, number, part

__all__ = ["render_stress"]

_STYLE = """
.plot img { max-width: 1240px; }
.stress table { font-size: 13px; width: auto; min-width: min(100%, 700px); }
.stress th, .stress td { text-align: left; vertical-align: top; padding: 3px 8px; }
.stress thead th { vertical-align: bottom; }
.stress { margin-bottom: 24px; }
.remarks { max-width: 95ch; padding-left: 1.2em; }
"""
_PARTS = {
    "verdict": "Verdict",
    "trust": "Where numbers can be trusted",
    "generators": "Generators",
    "lenses": "Lens models",
    "relations": "Relations",
    "jitter": "Jitter",
    "guarded": "Violations and their warnings",
    "refused": "Refused",
}


def render_stress(data: Mapping[str, Any], folder: Path) -> str:
    """The whole run as one HTML page.

    Parameters
    ----------
    data : mapping
        The contents of stress.json, schema ``inim.stress/1``.
    folder : Path
        Where the figure lies; it is embedded.
    """
    by_part: dict[str, list[Table]] = {}
    for one in tables_of(data):
        if one.rows:
            by_part.setdefault(one.part, []).append(one)
    sections = []
    for name, found in by_part.items():
        body = "".join(map(_table, found))
        if name == "verdict":
            body = bullets(summary_lines(data), "remarks") + body
        if name == "trust":
            body = _figure(folder) + body
        sections.append(Section(name, _PARTS[name], body))
    title = data.get("title", "Stress")
    return render_page(
        title,
        _facts(data),
        [*sections, how_to_reproduce(data)],
        window_title=f"{title} – inim",
        footer=data_note(data, "stress.json"),
        style=_STYLE,
    )


def _facts(data: Mapping[str, Any]) -> list[str]:
    return [
        "passed" if data.get("passed") is True else "FAILED",
        f"{text(data.get('mode', MISSING))} run",
        f"{number(data.get('seconds'), 0)} s",
        text(part(data, "backend").get("device", MISSING)),
        timestamp(data),
    ]


def _figure(folder: Path) -> str:
    words = "Error against parameter, float32 solid, float64 dashed"
    caption = f"{words}. Generators at the foot of an axis: no pixel at all."
    try:
        return plot((folder / "stress.svg").read_bytes(), words, caption)
    except OSError:
        return ""


def _table(found: Table) -> str:
    rows = [[text(cell) for cell in row] for row in found.rows]
    return table(found.caption, [text(h) for h in found.heads], rows, "stress")
