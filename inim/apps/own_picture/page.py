"""The report of a validation without a scene: `report.json`, `report.html` and `summary.md`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from inim.display.pixels import exact_ratio
from inim.report.images import Encoding, ReportImages, is_wide
from inim.report.labels import mm, number, per_cent, score, score_keys, verdict_words
from inim.report.page import (
    Section,
    bullets,
    check_badge,
    document_page,
    element,
    figure,
    folded,
    how_to_reproduce,
    table,
    text,
    text_table,
)
from inim.report.picture_document import PictureAlgorithm, PictureDocument
from inim.report.sections import small_enough
from inim.report.sections.display import display
from inim.report.sections.overview import failures
from inim.report.sections.run import check_list
from inim.report.sections.virtual_display import Shown, of_algorithm, shown_display
from inim.report.summary import markdown_section, markdown_table, markdown_text
from inim.report.virtual_display import ANCHOR, LIVE, TITLE
from inim.scores.metrics import MAIN, RELIC_MARGIN_PX, all_metrics
from inim.system.document import write_listed

_EXACT = "Exact first hits"
_LIES = "on the lens array"
_REFERENCES = {"to_picture": "the picture, warped", "to_exact": "the exact EIA's view"}
_LEAD = (
    "Wrong source: panel pixels whose source is not the first pixel on their ray, by rational "
    "arithmetic. The picture, warped: the view from the eye by the picture's own depth, without a "
    "display and its blur. The exact EIA's view: the EIA of the exact first hits, with four rays "
    "per pixel, through the same lenses. Covered: restricted to the pixels that the warped picture "
    f"covers, plus a margin of {RELIC_MARGIN_PX} pixels."
)


def write_picture_report(data: PictureDocument, folder: Path) -> None:
    """Write all forms into a folder that holds the images, `report.json` last."""
    forms = {
        "summary.md": _markdown,
        "report.html": lambda data: small_enough(lambda encoding: _page(data, folder, encoding)),
    }
    write_listed(data, folder, "report.json", forms)


def _rows(data: PictureDocument, to: str) -> list[list[str]]:
    """An algorithm and a viewpoint each, with all scores to a reference; the exact EIA's own."""
    exact = data.exact if to == "to_picture" else {}
    rows = [["exact first hits", name, *_cells(own)] for name, own in exact.items()]
    return rows + [
        [algorithm, name, *_cells(getattr(view, to))]
        for algorithm, result in data.algorithms.items()
        for name, view in result.views.items()
    ]


def _heads() -> list[str]:
    return ["algorithm", "viewpoint", *(label for label, _ in _columns())]


def _columns() -> list[tuple[str, str]]:
    """Label and name of every score: first on the picture's region, then of the whole view."""
    labelled = [(f"{m.label} {m.unit}".rstrip(), score_keys(m)) for m in all_metrics()]
    relic = [(f"{label}, covered", keys["relic"]) for label, keys in labelled if "relic" in keys]
    return relic + [(label, keys["scene"]) for label, keys in labelled]


def _cells(scores: Mapping[str, Any]) -> list[str]:
    return [score(scores, key) for _, key in _columns()]


def _remarks(data: PictureDocument) -> list[str]:
    picture = data.picture
    lines = [
        f"Picture: {picture.columns} × {picture.rows} pixels of "
        f"{number(picture.pixel_mm, 4)} mm, {per_cent(picture.covered_fraction, 1)} covered, "
        f"{number(picture.depth_min_mm, 2)} to {number(picture.depth_max_mm, 2)} mm deep.",
        *(f"{note[:1].upper()}{note[1:]}." for note in picture.notes),
        f"Wrong sources: of {data.oracle_pixels:,} panel pixels drawn at random.",
        "Of the picture's window nothing is met in "
        + ", ".join(f"{per_cent(1 - v, 1)} from {k}" for k, v in data.met_fraction.items())
        + ".",
    ]
    return [*lines, *(f"Not scored. {why}" for why in data.not_scored)]


def _markdown(data: PictureDocument) -> str:
    lines = [*data.warnings, *_remarks(data)]
    paragraphs = [
        [name, per_cent(result.wrong_source, 2), per_cent(result.hole_fraction, 1)]
        for name, result in data.algorithms.items()
    ]
    blocks = [
        f"## {markdown_text(data.title)}: {verdict_words(data)}",
        markdown_table(["algorithm", "wrong source", "holes"], paragraphs),
        *(
            markdown_section(f"To {words}", _heads(), _rows(data, to))
            for to, words in _REFERENCES.items()
        ),
        "\n".join(f"* {markdown_text(line, len(line))}" for line in lines),
    ]
    return "\n\n".join(blocks)


def _page(data: PictureDocument, folder: Path, encoding: Encoding) -> str:
    images = ReportImages(folder, encoding)
    best = data.best_algorithm
    names = sorted(data.algorithms, key=lambda name: name != best)
    candidates = [Shown(_EXACT, ("eia", "exact.png"), "exact"), *map(of_algorithm, names)]
    return document_page(
        data,
        "report.json",
        [
            "Without a scene",
            f"display {text(data.display.parameters.name)}",
            f"{text(data.lens_model)} lenses",
        ],
        [
            Section("overview", "Picture", _overview(data, images, best)),
            Section("warnings", "Warnings", bullets(data.warnings, "cautions")),
            Section(ANCHOR, TITLE, shown_display(data, images, candidates)),
            Section("scores", "Scores", _scores(data)),
            Section("views", "Views", _views(data, images)),
            Section("display", "Display", display(data, images), is_folded=True),
            Section("checks", "Checks", check_list(data.verdict), is_folded=True),
            how_to_reproduce(data),
        ],
        words=f": {verdict_words(data)}",
        verdict_badge=check_badge(data.verdict, data.warnings),
        widgets=[LIVE],
    )


def _overview(data: PictureDocument, images: ReportImages, best: str | None) -> str:
    """Overview: the picture on the array, its depth, and its reconstructed view."""
    color, depth = (_on_array(data, images.read(f"rgbd_{k}.png")) for k in ("color", "depth"))
    far, near = map(mm, data.display.parameters.depth_range_mm)
    shots = [
        figure(images.embed(color, "The picture on the lens array"), "Picture", _LIES),
        figure(
            images.embed(depth, "Its depth"),
            "Depth",
            f"lighter is nearer to the viewer, from {far} to {near}; black shows nothing",
        ),
    ]
    view = data.main_viewpoint
    if best is not None and view is not None:
        best_view = images.read("views", best, f"{view}.png")
        scores = data.algorithms[best].views[view].to_exact
        words = (
            f"from {view}, by {best}: {MAIN.label} {score(scores, MAIN.on_relic_key)} to the exact "
            "EIA's view, where the picture covers"
        )
        shots.append(
            figure(images.embed(best_view, f"View of the display from {view}"), "Display", words)
        )
    wide = "hero wide" if is_wide(color) else "hero"
    return failures(data) + element("div", *shots, class_=wide)


def _on_array(data: PictureDocument, pixels: np.ndarray | None) -> np.ndarray | None:
    """Part of the fitted picture on the lens array; oblique rays reach beyond it."""
    if pixels is None:
        return None
    display, pixel_mm = data.display.parameters, data.picture.pixel_mm
    cut = [
        max(0, round(exact_ratio((n - length / pixel_mm) / 2)))
        for n, length in zip(pixels.shape, (display.height_mm, display.width_mm), strict=False)
    ]
    return pixels[cut[0] : pixels.shape[0] - cut[0], cut[1] : pixels.shape[1] - cut[1]]


def _scores(data: PictureDocument) -> str:
    names = data.viewpoint_names
    rows = [_row(name, result, names) for name, result in data.algorithms.items()]
    exact = [score(data.exact[view], MAIN.on_relic_key) for view in names]
    head = element("em", text(_EXACT)) + " " + element("span", "to the picture", class_="aside")
    rows.append([head, *(element("span", text(value)) for value in exact), "", "", ""])
    heads = ["Algorithm", *names, "Wrong source", "Holes", "Seconds"]
    caption = (
        f"{MAIN.label} where the picture covers: to the exact EIA's view; small: to the picture"
    )
    full = [
        text_table(f"All scores, to {words}", _heads(), _rows(data, to), "all-scores")
        for to, words in _REFERENCES.items()
    ]
    return (
        table(caption, [text(h) for h in heads], rows, "scores")
        + element("p", text(_LEAD), class_="lead note")
        + bullets(_remarks(data), "remarks note")
        + folded(element("h3", "All scores"), *full)
    )


def _row(name: str, result: PictureAlgorithm, viewpoints: list[str]) -> list[str]:
    views = [result.views[viewpoint] for viewpoint in viewpoints]
    cells = [
        element("span", text(score(view.to_exact, MAIN.on_relic_key)))
        + element("small", text(f"{score(view.to_picture, MAIN.on_relic_key)} to picture"))
        for view in views
    ]
    last = [per_cent(result.wrong_source, 2), per_cent(result.hole_fraction, 1)]
    return [text(name), *cells, *map(text, [*last, number(result.seconds, 2)])]


def _views(data: PictureDocument, images: ReportImages) -> str:
    """A row of images for each viewpoint: warped, exact, then each algorithm's."""
    labels = {"picture": "The picture, warped", "exact": _EXACT}
    labels |= {algorithm: algorithm for algorithm in data.algorithms}
    rows = []
    for name in data.viewpoint_names:
        pictures = [images.read("views", place, f"{name}.png") for place in labels]
        figures = [
            figure(images.embed(picture, f"{words} from {name}"), words)
            for picture, words in zip(pictures, labels.values(), strict=True)
        ]
        kind = "views wide" if is_wide(pictures[0]) else "views"
        row = element("div", *figures, class_=kind, style=f"--count:{len(figures)}")
        rows.append(folded(element("h3", text(name)), row, is_open=name == data.main_viewpoint))
    return "".join(rows)
