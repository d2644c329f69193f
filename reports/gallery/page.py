"""Page of the gallery, from the files that `reports.gallery.run` wrote."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from inim.report.summary import markdown_table
from inim.scores.metrics import HEADLINE, HEADLINE_TO_SCENE

_LINE = 76
_GALLERY_HEAD = """\
# Gallery

Relics on a simulated display, the display's modes, lens models, and misaligned lens arrays. Each
entry gives the command that produced it. `python -m reports.gallery.run` produces all of them; the
reports and pictures are in `reports/gallery`.

SSIM to the ground truth compares the view with the scene itself: the result for a viewer. SSIM to
the reference compares it with the view of the ground-truth EIA through the same lenses: the quality
of the algorithm alone. Both are restricted to the relic and seen from the centre.

These runs used one ray per panel pixel for `template` and nearest colours for both algorithms. With
the present defaults, the commands give higher scores.
"""


def gallery_page(root: Path) -> str:
    """MyST Markdown of the gallery, from the entries in `root`/reports/gallery, for docs/."""
    folder = root / "reports" / "gallery"
    order = json.loads((folder / "gallery.json").read_text("utf-8"))
    return "\n".join([_GALLERY_HEAD, *(_gallery_entry(folder / name) for name in order)])


def _gallery_entry(folder: Path) -> str:
    entry = json.loads((folder / "entry.json").read_text("utf-8"))
    files = entry["reports"].items()
    reports = {label: json.loads((folder / file).read_text("utf-8")) for label, file in files}
    pictures = [_figure(folder.name, entry["title"], picture) for picture in entry["pictures"]]
    commands = "\n".join(_in_lines(report["command"]) for report in reports.values())
    listing = f"```text\n{commands}\n```"
    figures, scores = pictures, []  # a film without scores
    if len(pictures) > 1:
        columns = "2 2 3 3" if "" in reports else "2 2 4 4"
        rows = "\n".join(f":::{{grid-item}}\n{picture}\n:::" for picture in pictures)
        figures = [f"::::{{grid}} {columns}\n:gutter: 2\n\n{rows}\n::::"]
        scores = [_scores(reports)]
    return "\n\n".join([
        f"({folder.name.replace('_', '-')})=\n## {entry['title']}",
        entry["text"],
        *figures,
        *scores,
        listing if "" in reports else f":::{{dropdown}} Commands\n{listing}\n:::",
    ]) + "\n"  # fmt: skip


def _in_lines(command: str) -> str:
    """Command in lines that fit on the page, broken before options only."""
    first, *options = re.split(r" (?=-[oD-])", command)
    lines = [first]
    for option in options:
        if len(lines[-1]) + len(option) < _LINE:
            lines[-1] += f" {option}"
        else:
            lines.append(f"    {option}")
    return " \\\n".join(lines)


def _figure(name: str, title: str, picture: Mapping[str, str]) -> str:
    path, caption = f"../reports/gallery/{name}/{picture['file']}", picture["caption"]
    return f"```{{figure}} {path}\n:alt: {title}, {caption}\n\n{caption}\n```"


def _scores(reports: Mapping[str, Mapping[str, Any]]) -> str:
    """Scores of one run's algorithms, the worst first, and of the reference; or of several runs."""
    heads = ["SSIM on the relic", "to the ground truth", "to the reference"]
    if "" in reports:
        (report,) = reports.values()
        views = [(f"`{n}`", r["views"]["centre"]) for n, r in report["algorithms"].items()]
        views.sort(key=lambda view: view[1][HEADLINE])
        rows = [[name, *_to_scene_and_reference(view)] for name, view in views]
        return markdown_table(heads, [*rows, ["reference", _reference(report), ""]])
    rows = [
        [
            label,
            *_to_scene_and_reference(report["algorithms"]["template"]["views"]["centre"]),
            _reference(report),
        ]
        for label, report in reports.items()
    ]
    heads[1] = "`template` to the ground truth"
    return markdown_table([*heads, "reference to the ground truth"], rows)


def _to_scene_and_reference(view: Mapping[str, float]) -> list[str]:
    return [f"{view[key]:.3f}" for key in (HEADLINE_TO_SCENE, HEADLINE)]


def _reference(report: Mapping[str, Any]) -> str:
    return f"{report['reference']['views']['centre'][HEADLINE_TO_SCENE]:.3f}"
