"""The page of a bench: one HTML file in the report's dress, plots and tables."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from inim.report.bench.cells import Table
from inim.report.bench.tables import claim_lines, remarks, tables_of, thread_words
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
_PARTS = {
    "scene": (
        "Time against error",
        "pareto",
        "Down and left is better. Coloured: no other is as fast and as good. Grey: another is "
        "both. The picture scored is the very one that was timed, display-ready 8-bit sRGB. "
        "A point's whisker ends at its fastest run.",
    ),
    "scaling": (
        "How time grows",
        "scaling",
        "Two spheres in closed form, 17 × 17 pixels to the lens. Left: more and more lenses, two "
        "picture pixels per pitch. Right: the same display, finer and finer pictures, of which "
        "each ray crosses more pixels: as many times more as there are along a side, a power of "
        "0.5. Powers are those of the fastest runs (left: of the larger half).",
    ),
    "paper": (
        "The paper's experiments",
        "paper",
        "Wang et al., Heritage Science 2024, timed plain Python on one thread; so do the dashed "
        "lines. Solid: the same lines compiled, on all threads. Two synthetic spheres, not the "
        "paper's scenes.",
    ),
    "views": (
        "Views",
        "views",
        "One look at the two spheres on 64 × 64 lenses. The rectangle has the same picture for "
        "its texture, and is rendered by the stock camera, integrator and film. The noise of a "
        "sample is what it adds to a view pixel, root mean square.",
    ),
    "layers": (
        "Layers",
        "layers",
        "One RGB-D picture knows nothing behind its front surface; a picture with its layers does. "
        "Left: how near the EIA comes to the noise of its ground truth, one half of whose samples "
        "scores the floor against the other. Right: the time of both at equal samples. Where a "
        "pixel's four rays meet the same thing there is nothing to average: 'rays differ' is the "
        "share of the panel where they do not.",
    ),
    "commands": (
        "Whole commands",
        "commands",
        "What a validation costs when nothing is known, and when something is found again. Each "
        "mark is a run; lines are the medians of those compared with.",
    ),
}


def render_page(data: Mapping[str, Any], folder: Path) -> str:
    """The whole bench as one HTML page.

    Parameters
    ----------
    data : mapping
        The contents of bench.json, schema ``inim.bench/1``.
    folder : Path
        Where the plots lie; they are embedded.
    """
    by_part: dict[str, list[Table]] = {}
    for one in tables_of(data):
        by_part.setdefault(one.part, []).append(one)
    sections = [("conditions", "Conditions", _conditions(data))]
    for name, found in by_part.items():
        title, plot, words = _PARTS[name]
        body = element("p", text(words), class_="lead") + _plot(folder, plot, title)
        body += _claims(part(data, "paper")) if name == "paper" else ""
        sections.append((name, title, body + "".join(map(_table, found))))
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


def _conditions(data: Mapping[str, Any]) -> str:
    warned = [element("li", text(w)) for w in items(data, "warnings")]
    cautions = element("ul", *warned, class_="cautions") if warned else ""
    return cautions + element(
        "ul", *(element("li", text(r)) for r in remarks(data)), class_="remarks"
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


def _claims(paper: Mapping[str, Any]) -> str:
    lines = [element("li", text(line)) for line in claim_lines(paper)]
    heading = element("h3", "The paper's claims")
    return heading + element("ul", *lines, class_="claims") if lines else ""


def _reproduce(data: Mapping[str, Any]) -> str:
    command = element("pre", element("code", text(data.get("command", MISSING))))
    found = part(data, "versions")
    rows = [[text(name), text(value)] for name, value in found.items()]
    return command + table("Versions", ["Package", "Version"], rows, "facts")


def _footer(data: Mapping[str, Any]) -> str:
    version, schema = text(data.get("inim_version", MISSING)), text(data.get("schema", MISSING))
    return element("footer", element("p", f"inim {version} · data in bench.json ({schema})"))
