"""The report of a validation without a scene: `report.json`, `report.html` and `summary.md`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from inim.metrics import RELIC_MARGIN_PX, all_metrics
from inim.metrics.headline import MAIN
from inim.report.files import list_files, write_forms
from inim.report.images import Encoding, Images, is_wide
from inim.report.markup import bullets, element, figure, folded, table, text, text_table
from inim.report.page import (
    Section,
    check_badge,
    data_note,
    how_to_reproduce,
    render_page,
    timestamp,
)
from inim.report.sections import small_enough
from inim.report.sections.display import display
from inim.report.sections.overview import failures
from inim.report.sections.record import check_list
from inim.report.sections.virtual_display import Shown, of_algorithm, shown_display
from inim.report.summary import markdown_section, markdown_table, markdown_text
from inim.report.virtual_display import ANCHOR, LIVE, TITLE
from inim.report.wording import (
    MISSING,
    is_number,
    items,
    mm,
    number,
    part,
    per_cent,
    score,
    verdict_words,
    viewpoint_names,
)

SCHEMA = "inim.picture/1"
_STYLE = """
.remarks { max-width: 90ch; padding-left: 1.2em; }
"""
_EXACT = "Exact first hits"
_LIES = "as it lies on the lens array"
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
    forms = {
        "summary.md": _markdown,
        "report.html": lambda data: small_enough(lambda encoding: _page(data, folder, encoding)),
    }
    write_forms(list_files(data, folder, "report.json", *forms), folder, "report.json", forms)


def _rows(data: Mapping[str, Any], to: str) -> list[list[str]]:
    """An algorithm and a viewpoint each, with all scores to a reference; the exact EIA's own."""
    exact = part(data, "exact") if to == "to_picture" else {}
    rows = [["exact first hits", name, *_cells(own)] for name, own in exact.items()]
    return rows + [
        [algorithm, name, *_cells(part(view, to))]
        for algorithm, made in part(data, "algorithms").items()
        for name, view in part(made, "views").items()
    ]


def _heads() -> list[str]:
    return ["algorithm", "viewpoint", *(label for label, _ in _columns())]


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
        *(f"{note[:1].upper()}{note[1:]}." for note in items(picture, "notes")),
        f"Wrong sources: of {data['oracle_pixels']:,} panel pixels drawn at random.",
        "Of the picture's window nothing is met in "
        + ", ".join(f"{per_cent(1 - v, 1)} from {k}" for k, v in part(data, "met_fraction").items())
        + ".",
    ]
    return [*lines, *(f"Not scored. {why}" for why in items(data, "not_scored"))]


def _markdown(data: Mapping[str, Any]) -> str:
    lines = [*map(str, items(data, "warnings")), *_remarks(data)]
    known = [
        [name, per_cent(made.get("wrong_source"), 2), per_cent(made.get("hole_fraction"), 1)]
        for name, made in part(data, "algorithms").items()
    ]
    blocks = [
        f"## {markdown_text(data.get('title'))}: {verdict_words(data)}",
        markdown_table(["algorithm", "wrong source", "holes"], known),
        *(
            markdown_section(f"To {words}", _heads(), _rows(data, to))
            for to, words in _REFERENCES.items()
        ),
        "\n".join(f"* {markdown_text(line, len(line))}" for line in lines),
    ]
    return "\n\n".join(blocks)


def _page(data: Mapping[str, Any], folder: Path, encoding: Encoding) -> str:
    title = data.get("title", "Picture")
    images = Images(folder, encoding)
    best = _best(data)
    names = sorted(part(data, "algorithms"), key=lambda name: name != best)
    shown = [Shown(_EXACT, ("eia", "exact.png"), "exact"), *map(of_algorithm, names)]
    return render_page(
        title,
        [
            "Without a scene",
            f"display {text(part(data, 'display', 'given').get('name', MISSING))}",
            f"{text(data.get('lens_model', MISSING))} lenses",
            timestamp(data),
        ],
        [
            Section("overview", "Picture", _overview(data, images, best)),
            Section("warnings", "Warnings", bullets(items(data, "warnings"), "cautions")),
            Section(ANCHOR, TITLE, shown_display(data, images, shown)),
            Section("scores", "Scores", _scores(data)),
            Section("views", "Views", _views(data, images)),
            Section("display", "Display", display(data, images), is_folded=True),
            Section("checks", "Checks", check_list(data), is_folded=True),
            how_to_reproduce(data),
        ],
        window_title=f"{title}: {verdict_words(data)} – inim",
        footer=data_note(data, "report.json"),
        verdict_badge=check_badge(data),
        style=_STYLE,
        widgets=[LIVE],
    )


def _best(data: Mapping[str, Any]) -> str | None:
    """The algorithm whose views are most like the exact EIA's, on average."""

    def mean(name: str) -> float:
        views = part(data, "algorithms", name, "views").values()
        known = [part(view, "to_exact").get(MAIN.on_relic_key) for view in views]
        numbers = [float(value) for value in known if is_number(value)]
        return sum(numbers) / len(numbers) if numbers else -math.inf

    return max(part(data, "algorithms"), key=mean, default=None)


def _first_view(data: Mapping[str, Any]) -> str | None:
    names = viewpoint_names(data)
    return "centre" if "centre" in names else next(iter(names), None)


def _overview(data: Mapping[str, Any], images: Images, best: str | None) -> str:
    """The picture on the array, its depth, and what the display shows of it."""
    color, depth = (_on_array(data, images.read(f"rgbd_{k}.png")) for k in ("color", "depth"))
    derived = part(data, "display", "derived")
    far, near = mm(derived.get("depth_min_mm")), mm(derived.get("depth_max_mm"))
    shots = [
        figure(images.embed(color, "The picture as it lies on the lens array"), "Picture", _LIES),
        figure(
            images.embed(depth, "Its depth"),
            "Depth",
            f"lighter is nearer to the viewer, from {far} to {near}; black shows nothing",
        ),
    ]
    view = _first_view(data)
    if best is not None and view is not None:
        made = images.read("views", best, f"{view}.png")
        scores = part(data, "algorithms", best, "views", view, "to_exact")
        words = (
            f"from {view}, by {best}: {MAIN.label} {score(scores, MAIN.on_relic_key)} to the exact "
            "EIA's view, where the picture covers"
        )
        shots.append(
            figure(images.embed(made, f"View of the display from {view}"), "Display", words)
        )
    wide = "hero wide" if is_wide(color) else "hero"
    return failures(data) + element("div", *shots, class_=wide)


def _on_array(data: Mapping[str, Any], pixels: np.ndarray | None) -> np.ndarray | None:
    """The part of the fitted picture that lies on the lens array: oblique rays see beyond it."""
    derived, pixel = part(data, "display", "derived"), part(data, "picture").get("pixel_mm")
    size = [derived.get(key) for key in ("height_mm", "width_mm")]
    if pixels is None or not is_number(pixel):
        return pixels
    cut = [
        max(0, round((n - length / pixel) / 2)) if is_number(length) else 0
        for n, length in zip(pixels.shape[:2], size, strict=True)
    ]
    return pixels[cut[0] : pixels.shape[0] - cut[0], cut[1] : pixels.shape[1] - cut[1]]


def _scores(data: Mapping[str, Any]) -> str:
    names = viewpoint_names(data)
    rows = [
        _row(data, name, [part(made, "views", view) for view in names])
        for name, made in part(data, "algorithms").items()
    ]
    exact = [score(part(data, "exact", view), MAIN.on_relic_key) for view in names]
    head = element("em", text(_EXACT)) + " " + element("span", "to the picture", class_="aside")
    rows.append([head, *(element("span", text(one)) for one in exact), "", "", ""])
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


def _row(data: Mapping[str, Any], name: str, views: Sequence[Mapping[str, Any]]) -> list[str]:
    made = part(data, "algorithms", name)
    cells = [
        element("span", text(score(part(view, "to_exact"), MAIN.on_relic_key)))
        + element("small", text(f"{score(part(view, 'to_picture'), MAIN.on_relic_key)} to picture"))
        for view in views
    ]
    last = [per_cent(made.get("wrong_source"), 2), per_cent(made.get("hole_fraction"), 1)]
    return [text(name), *cells, *map(text, [*last, number(made.get("seconds"), 2)])]


def _views(data: Mapping[str, Any], images: Images) -> str:
    """A row of images for each viewpoint: warped, exact, then each algorithm's."""
    shown = {"picture": "The picture, warped", "exact": _EXACT}
    shown |= {algorithm: algorithm for algorithm in part(data, "algorithms")}
    rows = []
    for name in viewpoint_names(data):
        pictures = [images.read("views", place, f"{name}.png") for place in shown]
        figures = [
            figure(images.embed(picture, f"{words} from {name}"), words)
            for picture, words in zip(pictures, shown.values(), strict=True)
        ]
        kind = "views wide" if is_wide(pictures[0]) else "views"
        row = element("div", *figures, class_=kind, style=f"--count:{len(figures)}")
        rows.append(folded(element("h3", text(name)), row, is_open=name == _first_view(data)))
    return "".join(rows)
