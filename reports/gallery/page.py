"""The gallery's page, of what `reports.gallery.run` kept."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from inim.metrics.headline import HEADLINE, HEADLINE_TO_SCENE

_LINE = 76
_GALLERY_HEAD = """\
# Gallery

What the bench shows of each relic, of the display's modes, and of arrays that lie wrong. Each entry
has the command that made it. All was made by `python -m reports.gallery.run`; reports and pictures
are in `reports/gallery`.

SSIM to the scene is what the viewer gets. SSIM to the reference is what the algorithm keeps of what
the display can show; the reference is the ground-truth EIA through the same lenses. Both are on
the relic, from the centre.
"""


def gallery_page(root: Path) -> str:
    """The gallery, of the entries below `root`/reports/gallery, as MyST Markdown for docs/."""
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
        shown = f"::::{{grid}} {columns}\n:gutter: 2\n\n{rows}\n::::"
        scores = [_scores_by_algorithm(reports[""]) if is_one_run else _scores_by_run(reports)]
    else:  # a film, of no view that is scored
        shown, scores = pictures[0], []
    parts = [
        f"({folder.name.replace('_', '-')})=\n## {entry['title']}",
        entry["text"],
        shown,
        *scores,
        f"```text\n{commands}\n```" if is_one_run else _folded(commands),
    ]
    return "\n\n".join(parts) + "\n"


def _in_lines(command: str) -> str:
    """A command in lines that fit a page, broken before options only."""
    first, *options = re.split(r" (?=-[oD-])", command)
    lines = [first]
    for option in options:
        if len(lines[-1]) + len(option) < _LINE:
            lines[-1] += f" {option}"
        else:
            lines.append(f"    {option}")
    return " \\\n".join(lines)


def _figure(name: str, title: str, picture: Mapping[str, str]) -> str:
    place, caption = f"../reports/gallery/{name}/{picture['file']}", picture["caption"]
    return f"```{{figure}} {place}\n:alt: {title}, {caption}\n\n{caption}\n```"


def _folded(commands: str) -> str:
    return f":::{{dropdown}} Commands\n```text\n{commands}\n```\n:::"


def _scores_by_algorithm(report: Mapping[str, Any]) -> str:
    """The worst first; the reference last."""
    views = [(name, found["views"]["centre"]) for name, found in report["algorithms"].items()]
    views.sort(key=lambda each: each[1][HEADLINE])
    rows = [(f"`{n}`", _ssim(v[HEADLINE_TO_SCENE]), _ssim(v[HEADLINE])) for n, v in views]
    own = report["reference"]["views"]["centre"][HEADLINE_TO_SCENE]
    rows.append(("reference", _ssim(own), ""))
    return _table(("SSIM on the relic", "to the scene", "to the reference"), rows)


def _scores_by_run(reports: Mapping[str, Mapping[str, Any]]) -> str:
    """In the order of the runs, which is that of what was changed."""
    rows = []
    for label, report in reports.items():
        view = report["algorithms"]["template"]["views"]["centre"]
        reference = report["reference"]["views"]["centre"][HEADLINE_TO_SCENE]
        rows.append((label, *map(_ssim, (view[HEADLINE_TO_SCENE], view[HEADLINE], reference))))
    heads = (
        "SSIM on the relic",
        "`template` to the scene",
        "to the reference",
        "reference to the scene",
    )
    return _table(heads, rows)


def _ssim(value: float) -> str:
    return f"{value:.3f}"


def _table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table, numbers to the right."""
    heads = tuple(heads)
    rule = ["---", *["---:"] * (len(heads) - 1)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (heads, rule, *rows))
