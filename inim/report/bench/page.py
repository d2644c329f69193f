"""The page of a bench: one HTML file in the report's dress, plots and tables."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from inim.report.bench.part import Part, Table
from inim.report.bench.tables import remarks, thread_words
from inim.report.markup import element, section, table, text
from inim.report.wording import MISSING, items, part, plain

__all__ = ["render_page"]

_POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
    "base-uri 'none'; form-action 'none'"
)
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


def render_page(data: Mapping[str, Any], parts: Sequence[Part], folder: Path) -> str:
    """The whole bench as one HTML page.

    Parameters
    ----------
    data : mapping
        The contents of bench.json, schema ``inim.bench/1``.
    parts : sequence of Part
    folder : Path
        Where the plots lie; they are embedded.
    """
    sections = [("conditions", "Conditions", _conditions(data, parts))]
    for one in parts:
        body = element("p", text(one.lead), class_="lead") + _plot(folder, one.plot, one.title)
        body += _claims(*one.claims) + "".join(map(_table, one.tables))
        sections.append((one.name, one.title, body))
    sections.append(("reproduce", "How to reproduce", _reproduce(data)))
    links = [f'<a href="#{anchor}">{text(title)}</a>' for anchor, title, _ in sections]
    header = element(
        "header",
        element("div", element("h1", text(data.get("title", "Bench"))), _facts(data)),
        element("nav", *links, aria_label="Sections"),
    )
    main = "\n".join(section(*one) for one in sections)
    return (
        f'<!doctype html>\n<html lang="en">\n{_head(data)}\n<body>\n{header}\n'
        f"<main>\n{main}\n</main>\n{_footer(data)}\n</body>\n</html>"
    )


def _head(data: Mapping[str, Any]) -> str:
    style = resources.files("inim.report").joinpath("report.css").read_text("utf-8")
    return (
        '<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{text(_POLICY)}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{text(data.get('title', 'Bench'))} – inim</title>\n"
        f"<style>\n{style}{_STYLE}</style>\n</head>"
    )


def _facts(data: Mapping[str, Any]) -> str:
    display = part(data, "display", "given").get("name")
    facts = [f"Display {text(display)}"] if display else []
    facts += [
        text(thread_words(data)),
        text(part(data, "backend").get("device", MISSING)),
        f"inim {text(data.get('inim_version', MISSING))}",
        element("time", text(plain(data.get("created", MISSING)).replace("+00:00", " UTC"))),
    ]
    return element("p", " · ".join(facts), class_="facts")


def _conditions(data: Mapping[str, Any], parts: Sequence[Part]) -> str:
    warned = [element("li", text(w)) for w in items(data, "warnings")]
    cautions = element("ul", *warned, class_="cautions") if warned else ""
    return cautions + element(
        "ul", *(element("li", text(r)) for r in remarks(data, parts)), class_="remarks"
    )


def _plot(folder: Path, name: str, title: str) -> str:
    """A plot as an embedded SVG picture: it scales, and its styles stay its own."""
    try:
        drawn = base64.b64encode((folder / f"{name}.svg").read_bytes()).decode()
    except OSError:
        return ""
    picture = element("img", src=f"data:image/svg+xml;base64,{drawn}", alt=title)
    return element("figure", picture.replace("</img>", ""), class_="plot")


def _table(found: Table) -> str:
    rows = [[text(cell) for cell in row] for row in found.rows]
    return table(found.caption, [text(h) for h in found.heads], rows, "bench")


def _claims(heading: str, lines: Sequence[str]) -> str:
    shown = element("ul", *(element("li", text(line)) for line in lines), class_="claims")
    return element("h3", text(heading)) + shown if lines else ""


def _reproduce(data: Mapping[str, Any]) -> str:
    command = element("pre", element("code", text(data.get("command", MISSING))))
    found = part(data, "versions")
    rows = [[text(name), text(value)] for name, value in found.items()]
    return command + table("Versions", ["Package", "Version"], rows, "facts")


def _footer(data: Mapping[str, Any]) -> str:
    version, schema = text(data.get("inim_version", MISSING)), text(data.get("schema", MISSING))
    return element("footer", element("p", f"inim {version} · data in bench.json ({schema})"))
