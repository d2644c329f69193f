"""The report of a validation without a scene: `report.json`, `report.html` and `summary.md`."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from inim.report.files import list_files, write_forms
from inim.report.markup import bullets, element, figure, table, text, void
from inim.report.page import Section, data_note, how_to_reproduce, render_page, timestamp
from inim.report.wording import MISSING, items, number, part, per_cent, plain, score

__all__ = ["SCHEMA", "write_picture_report"]

SCHEMA = "inim.picture/1"
_STYLE = """
.seen { display: grid; grid-template-columns: repeat(auto-fill, minmax(220px, 1fr)); gap: 12px; }
.seen figure { margin: 0; } .seen img { width: 100%; image-rendering: pixelated; }
.remarks { max-width: 90ch; padding-left: 1.2em; }
"""
_REFERENCES = {"to_picture": "the picture, warped", "to_exact": "the exact EIA's view"}
_LEAD = (
    "Wrong source: panel pixels that show another pixel of the picture than the first one that "
    "their ray meets, by rational arithmetic. The picture, warped: as the eye would see it by its "
    "own depth, with no display between; every display blurs that. The exact EIA's view: what the "
    "EIA of the exact first hits, four rays a pixel, shows through the same lenses: all that an "
    "algorithm can get out of this picture."
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


# -- tables -------------------------------------------------------------------------------------


def _scores(data: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Heads and rows: an algorithm and a viewpoint each, and the exact EIA's own."""
    heads = ["algorithm", "viewpoint", "wrong source", "holes"]
    heads += [f"{metric} to {to}" for to in _REFERENCES.values() for metric in ("SSIM", "PSNR dB")]
    rows = [
        ["exact first hits", name, MISSING, MISSING, *_pair(own), MISSING, MISSING]
        for name, own in part(data, "exact").items()
    ]
    for algorithm, made in part(data, "algorithms").items():
        for name, view in part(made, "views").items():
            known = [per_cent(made.get("wrong_source"), 2), per_cent(made.get("hole_fraction"), 1)]
            cells = [cell for to in _REFERENCES for cell in _pair(part(view, to))]
            rows.append([algorithm, name, *known, *cells])
    return heads, rows


def _pair(scores: Mapping[str, Any]) -> list[str]:
    return [score(scores, "ssim"), score(scores, "psnr_db")]


def _checks(data: Mapping[str, Any]) -> list[list[str]]:
    return [
        [
            plain(check["name"]),
            number(check["value"], 4),
            f"{check['relation']} {check['limit']:g}",
            "passed" if check["passed"] is True else "FAILED",
        ]
        for check in items(part(data, "verdict"), "checks")
    ]


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
    heads, rows = _scores(data)
    passed = "passed" if part(data, "verdict").get("passed") is True else "FAILED"
    head = [heads, [":--", *["--:"] * (len(heads) - 1)]]
    lines = [f"| {' | '.join(map(_cell, row))} |" for row in [*head, *rows]]
    listed = [*map(str, items(data, "warnings")), *_remarks(data)]
    return "\n\n".join(
        [
            f"## {_cell(data.get('title'))}: {passed}",
            "\n".join(lines),
            "\n".join(f"* {_cell(line)}" for line in listed),
        ]
    )


def _cell(value: object) -> str:
    """One line that cannot break a table."""
    line = " ".join(plain(value).split())
    return line.replace("&", "&amp;").replace("<", "&lt;").replace("|", "\\|")


# -- page ---------------------------------------------------------------------------------------


def _page(data: Mapping[str, Any], folder: Path) -> str:
    heads, rows = _scores(data)
    scored = (
        element("p", text(_LEAD), class_="lead")
        + table("Scores", [text(h) for h in heads], [[text(c) for c in row] for row in rows])
        + bullets(items(data, "warnings"), "cautions")
        + bullets(_remarks(data), "remarks")
    )
    checked = [[text(cell) for cell in row] for row in _checks(data)]
    heads = ["Check", "Value", "Limit", "Verdict"]
    title = data.get("title", "Picture")
    return render_page(
        title,
        _facts(data),
        [
            Section("scores", "Scores", scored),
            Section("views", "Views", "".join(_views(data, folder))),
            Section("checks", "Checks", table("Checks", heads, checked)),
            how_to_reproduce(data),
        ],
        window_title=f"{title} – inim",
        footer=data_note(data, "report.json"),
        style=_STYLE,
    )


def _facts(data: Mapping[str, Any]) -> list[str]:
    return [
        "passed" if part(data, "verdict").get("passed") is True else "FAILED",
        "without a scene",
        f"display {text(part(data, 'display', 'given').get('name', MISSING))}",
        f"{text(data.get('lens_model', MISSING))} lenses",
        timestamp(data),
    ]


def _views(data: Mapping[str, Any], folder: Path) -> list[str]:
    """A row of images for each viewpoint: warped, exact, then each algorithm's."""
    rows = []
    for viewpoint in items(data, "viewpoints"):
        name = viewpoint["name"]
        shown = {"picture": "the picture, warped", "exact": "exact first hits"}
        shown |= {algorithm: algorithm for algorithm in part(data, "algorithms")}
        images = [_picture(folder / "views" / k / f"{name}.png", v) for k, v in shown.items()]
        rows.append(element("h3", text(name)) + element("div", *images, class_="seen"))
    return rows


def _picture(path: Path, words: str) -> str:
    try:
        code = base64.b64encode(path.read_bytes()).decode()
    except OSError:
        return ""
    return figure(void("img", src=f"data:image/png;base64,{code}", alt=words), words)
