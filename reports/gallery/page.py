"""Page of the gallery, from the files that `reports.gallery.run` wrote."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

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
    reports = {
        label: json.loads((folder / file).read_text("utf-8"))
        for label, file in entry["reports"].items()
    }
    pictures = [_figure(folder.name, entry["title"], picture) for picture in entry["pictures"]]
    is_one_run = "" in reports
    columns = "2 2 3 3" if is_one_run else "2 2 4 4"
    commands = "\n".join(_in_lines(report["command"]) for report in reports.values())
    if len(pictures) > 1:
        rows = "\n".join(f":::{{grid-item}}\n{picture}\n:::" for picture in pictures)
        figures = f"::::{{grid}} {columns}\n:gutter: 2\n\n{rows}\n::::"
        scores = [_scores_by_algorithm(reports[""]) if is_one_run else _scores_by_run(reports)]
    else:  # a film without scores
        figures, scores = pictures[0], []
    parts = [
        f"({folder.name.replace('_', '-')})=\n## {entry['title']}",
        entry["text"],
        figures,
        *scores,
        f"```text\n{commands}\n```" if is_one_run else _folded(commands),
    ]
    return "\n\n".join(parts) + "\n"


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


def _folded(commands: str) -> str:
    return f":::{{dropdown}} Commands\n```text\n{commands}\n```\n:::"


def _scores_by_algorithm(report: Mapping[str, Any]) -> str:
    """Scores of one run's algorithms, the worst first, and of the reference."""
    views = [(name, result["views"]["centre"]) for name, result in report["algorithms"].items()]
    views.sort(key=lambda view: view[1][HEADLINE])
    rows = [(f"`{n}`", _ssim(v[HEADLINE_TO_SCENE]), _ssim(v[HEADLINE])) for n, v in views]
    reference = report["reference"]["views"]["centre"][HEADLINE_TO_SCENE]
    rows.append(("reference", _ssim(reference), ""))
    return _table(("SSIM on the relic", "to the ground truth", "to the reference"), rows)


def _scores_by_run(reports: Mapping[str, Mapping[str, Any]]) -> str:
    """Scores of several runs, in the order of the changed parameter."""
    rows = []
    for label, report in reports.items():
        view = report["algorithms"]["template"]["views"]["centre"]
        reference = report["reference"]["views"]["centre"][HEADLINE_TO_SCENE]
        rows.append((label, *map(_ssim, (view[HEADLINE_TO_SCENE], view[HEADLINE], reference))))
    heads = (
        "SSIM on the relic",
        "`template` to the ground truth",
        "to the reference",
        "reference to the ground truth",
    )
    return _table(heads, rows)


def _ssim(value: float) -> str:
    return f"{value:.3f}"


def _table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Markdown table with numbers aligned to the right."""
    heads = tuple(heads)
    rule = ["---", *["---:"] * (len(heads) - 1)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (heads, rule, *rows))
