"""The page of a stress run: one HTML file in the report's dress, figure and tables."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from inim.report.markup import element, section, table, text
from inim.report.stress.tables import Table
from inim.report.wording import MISSING, number, part, plain

__all__ = ["render_page"]

_POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
    "base-uri 'none'; form-action 'none'"
)
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
    "hits": "First hits",
    "limits": "Accuracy limits",
    "generators": "Generators",
    "lenses": "Lens models",
    "relations": "Relations",
    "jitter": "Jitter",
    "guarded": "Violations and their warnings",
    "refused": "Refused",
}


def render_page(
    data: Mapping[str, Any], folder: Path, tables: Sequence[Table], lines: Sequence[str]
) -> str:
    """The whole run as one HTML page.

    Parameters
    ----------
    data : mapping
        The contents of stress.json.
    folder : Path
        Where the figure lies, if there is one; it is embedded.
    tables : sequence of Table
        Each goes to the section of its `part`; empty ones are left out.
    lines : sequence of str
        Sentences above the verdict.
    """
    by_part: dict[str, list[Table]] = {}
    for one in tables:
        if one.rows:
            by_part.setdefault(one.part, []).append(one)
    sections = []
    for name, found in by_part.items():
        body = "".join(map(_table, found))
        if name == "verdict":
            remarks = (element("li", text(line)) for line in lines)
            body = element("ul", *remarks, class_="remarks") + body
        if name == "limits":
            body = _figure(folder) + body
        sections.append((name, _PARTS[name], body))
    sections.append(("reproduce", "How to reproduce", _reproduce(data)))
    links = [f'<a href="#{anchor}">{text(title)}</a>' for anchor, title, _ in sections]
    header = element(
        "header",
        element("div", element("h1", text(data.get("title", "Stress"))), _facts(data)),
        element("nav", *links, aria_label="Sections"),
    )
    main = "\n".join(section(*one) for one in sections)
    return (
        f'<!doctype html>\n<html lang="en">\n{_head(data)}\n<body>\n{header}\n'
        f"<main>\n{main}\n</main>\n{_footer(data)}\n</body>\n</html>"
    )


def _head(data: Mapping[str, Any]) -> str:
    sheet = resources.files("inim.report").joinpath("report.css").read_text("utf-8")
    return (
        '<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{text(_POLICY)}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{text(data.get('title', 'Stress'))} – inim</title>\n"
        f"<style>\n{sheet}{_STYLE}</style>\n</head>"
    )


def _facts(data: Mapping[str, Any]) -> str:
    facts = [
        "passed" if data.get("passed") is True else "FAILED",
        f"{text(data.get('mode', MISSING))} run",
        f"{number(data.get('seconds'), 0)} s",
        text(part(data, "backend").get("device", MISSING)),
        element("time", text(plain(data.get("created", MISSING)).replace("+00:00", " UTC"))),
    ]
    return element("p", " · ".join(facts), class_="facts")


def _figure(folder: Path) -> str:
    """The figure as an embedded SVG picture: it scales, and its styles stay its own."""
    try:
        drawn = base64.b64encode((folder / "stress.svg").read_bytes()).decode()
    except OSError:
        return ""
    words = "Error against parameter, float32 solid, float64 dashed"
    picture = element("img", src=f"data:image/svg+xml;base64,{drawn}", alt=words)
    caption = element(
        "figcaption", text(f"{words}. Generators at the foot of an axis: no pixel at all.")
    )
    return element("figure", picture.replace("</img>", ""), caption, class_="plot")


def _table(found: Table) -> str:
    rows = [[text(cell) for cell in row] for row in found.rows]
    return table(found.caption, [text(h) for h in found.heads], rows, "stress")


def _reproduce(data: Mapping[str, Any]) -> str:
    command = element("pre", element("code", text(data.get("command", MISSING))))
    rows = [[text(name), text(value)] for name, value in part(data, "versions").items()]
    return command + table("Versions", ["Package", "Version"], rows, "facts")


def _footer(data: Mapping[str, Any]) -> str:
    version, schema = text(data.get("inim_version", MISSING)), text(data.get("schema", MISSING))
    return element("footer", element("p", f"inim {version} · data in stress.json ({schema})"))
