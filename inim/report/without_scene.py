"""The report of a validation without a scene: `report.json`, `report.html` and `summary.md`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from inim.metrics import RELIC_MARGIN_PX, all_metrics
from inim.report.files import list_files, write_forms
from inim.report.images import ENCODINGS, Images
from inim.report.markup import bullets, element, figure, text, text_table
from inim.report.page import (
    Section,
    check_badge,
    data_note,
    how_to_reproduce,
    render_page,
    timestamp,
)
from inim.report.sections.record import check_list
from inim.report.summary import markdown_table, markdown_text
from inim.report.wording import (
    MISSING,
    items,
    number,
    part,
    per_cent,
    score,
    verdict_words,
    viewpoint_names,
)

__all__ = ["SCHEMA", "write_picture_report"]

SCHEMA = "inim.picture/1"
_STYLE = """
.remarks { max-width: 90ch; padding-left: 1.2em; }
"""
_REFERENCES = {"to_picture": "the picture, warped", "to_exact": "the exact EIA's view"}
_LEAD = (
    "Wrong source: panel pixels that show another pixel of the picture than the first one that "
    "their ray meets, by rational arithmetic. The picture, warped: as the eye would see it by its "
    "own depth, with no display between; every display blurs that. The exact EIA's view: what the "
    "EIA of the exact first hits, four rays a pixel, shows through the same lenses: all that an "
    "algorithm can get out of this picture. Covered: of the pixels that the picture, warped, meets "
    f"and those within {RELIC_MARGIN_PX} pixels of one."
)


def write_picture_report(data: Mapping[str, Any], folder: Path) -> None:
    """Write all forms into a folder that holds the images, `report.json` last.

    Parameters
    ----------
    data : mapping
        Schema `inim.picture/1`; `files` is added here.
    folder : Path
    """
    forms = {"summary.md": _markdown, "report.html": lambda data: _page(data, folder)}
    write_forms(list_files(data, folder, "report.json", *forms), folder, "report.json", forms)


def _scores(data: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Heads and rows: an algorithm and a viewpoint each, and the exact EIA's own."""
    heads = ["algorithm", "viewpoint", "wrong source", "holes"]
    heads += [f"{label} to {to}" for to in _REFERENCES.values() for label, _ in _columns()]
    rows = [
        ["exact first hits", name, MISSING, MISSING, *_cells(own), *_cells({})]
        for name, own in part(data, "exact").items()
    ]
    for algorithm, made in part(data, "algorithms").items():
        for name, view in part(made, "views").items():
            known = [per_cent(made.get("wrong_source"), 2), per_cent(made.get("hole_fraction"), 1)]
            cells = [cell for to in _REFERENCES for cell in _cells(part(view, to))]
            rows.append([algorithm, name, *known, *cells])
    return heads, rows


def _columns() -> list[tuple[str, str]]:
    """Label and name of every score: on what the picture covers, then of the whole view."""
    found = []
    for on_relic in (True, False):
        for metric in all_metrics():
            if metric.on_relic or not on_relic:
                label = " ".join(filter(None, (metric.label, metric.unit)))
                own = (f"{label}, covered", metric.on_relic_key)
                found.append(own if on_relic else (label, metric.key))
    return found


def _cells(scores: Mapping[str, Any]) -> list[str]:
    return [score(scores, key) for _, key in _columns()]


def _remarks(data: Mapping[str, Any]) -> list[str]:
    picture = part(data, "picture")
    lines = [
        f"Picture: {picture['columns']} × {picture['rows']} pixels of "
        f"{number(picture['pixel_mm'], 4)} mm, {per_cent(picture['covered_fraction'], 1)} covered, "
        f"{number(picture['depth_min_mm'], 2)} to {number(picture['depth_max_mm'], 2)} mm deep.",
        f"Wrong sources: of {data['oracle_pixels']:,} panel pixels drawn at random.",
        *(
            f"From {name}: {per_cent(1 - share, 1)} of the picture's window meets nothing."
            for name, share in part(data, "met_fraction").items()
        ),
    ]
    return [*lines, *(f"Not scored. {why}" for why in items(data, "not_scored"))]


def _markdown(data: Mapping[str, Any]) -> str:
    lines = [*map(str, items(data, "warnings")), *_remarks(data)]
    blocks = [
        f"## {markdown_text(data.get('title'))}: {verdict_words(data)}",
        markdown_table(*_scores(data)),
        "\n".join(f"* {markdown_text(line, len(line))}" for line in lines),
    ]
    return "\n\n".join(blocks)


def _page(data: Mapping[str, Any], folder: Path) -> str:
    heads, rows = _scores(data)
    scored = (
        element("p", text(_LEAD), class_="lead")
        + text_table("Scores", heads, rows, "scores")
        + bullets(_remarks(data), "remarks")
    )
    title = data.get("title", "Picture")
    return render_page(
        title,
        [
            "Without a scene",
            f"display {text(part(data, 'display', 'given').get('name', MISSING))}",
            f"{text(data.get('lens_model', MISSING))} lenses",
            timestamp(data),
        ],
        [
            Section("scores", "Scores", scored),
            Section("views", "Views", _views(data, Images(folder, ENCODINGS[0]))),
            Section("checks", "Checks", check_list(data)),
            Section("warnings", "Warnings", bullets(items(data, "warnings"), "cautions")),
            how_to_reproduce(data),
        ],
        window_title=f"{title}: {verdict_words(data)} – inim",
        footer=data_note(data, "report.json"),
        verdict_badge=check_badge(data),
        style=_STYLE,
    )


def _views(data: Mapping[str, Any], images: Images) -> str:
    """A row of images for each viewpoint: warped, exact, then each algorithm's."""
    shown = {"picture": "the picture, warped", "exact": "exact first hits"}
    shown |= {algorithm: algorithm for algorithm in part(data, "algorithms")}
    rows = []
    for name in viewpoint_names(data):
        figures = [
            figure(images.embed(images.read("views", place, f"{name}.png"), words), words)
            for place, words in shown.items()
        ]
        heading = element("h3", text(name))
        count = f"--count:{len(figures)}"
        rows.append(heading + element("div", *figures, class_="views", style=count))
    return "".join(rows)
