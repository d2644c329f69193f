"""The page of a bench: plots and tables."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from inim.report.bench.cells import Table
from inim.report.bench.tables import claim_lines, remarks, tables_of, thread_words
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


def render_bench(data: Mapping[str, Any], folder: Path) -> str:
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
    sections = [Section("conditions", "Conditions", _conditions(data))]
    for name, found in by_part.items():
        title, drawing, words = _PARTS[name]
        body = element("p", text(words), class_="lead") + _plot(folder, drawing, title)
        body += _claims(part(data, "paper")) if name == "paper" else ""
        sections.append(Section(name, title, body + "".join(map(_table, found))))
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


def _conditions(data: Mapping[str, Any]) -> str:
    return bullets(items(data, "warnings"), "cautions") + bullets(remarks(data), "remarks")


def _plot(folder: Path, name: str, title: str) -> str:
    try:
        return plot((folder / f"{name}.svg").read_bytes(), title)
    except OSError:
        return ""


def _table(found: Table) -> str:
    rows = [[text(cell) for cell in row] for row in found.rows]
    return table(found.caption, [text(h) for h in found.heads], rows, "bench")


def _claims(paper: Mapping[str, Any]) -> str:
    lines = bullets(claim_lines(paper), "claims")
    return element("h3", "The paper's claims") + lines if lines else ""
