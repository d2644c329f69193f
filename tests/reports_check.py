"""Committed results whose code has changed since, and the sentences that quote them.

A JSON result below `reports` has digests of the code that decides it (`code`). A paragraph or a row
of a table that names a result, as `reports/NAME` or `reports.NAME.run`, also in a comment, quotes
its numbers. If a paragraph ends with a colon, so does the block below it. A comment in the first
line of a table holds for all its rows, and a comment by itself up to the next heading. A sentence
without a number quotes nothing.

`python -m tests.reports_check` prints the list. It fails if a sentence quotes a stale result.
"""

import json
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from inim.system.cache import computation_digests
from tests.documents import ROOT, pages

# Results of another commit never become stale.
_NAMED = re.compile(r"\breports[/.](\w[\w/-]*(?:\.\w+)*)(?![\w/-])(?![^\s\w]* of\s+commit)")
_COMMENT = re.compile(r"<!--.*?-->", re.S)
_NO_NUMBERS = re.compile(r"```.*?```|`[^`\n]*`|\]\([^)]*\)|<!--.*?-->", re.S)
_SENTENCE_END = re.compile(r"(?<=[.!?])\s+(?=[A-Z`*\[])")


@dataclass(frozen=True)
class Result:
    """A committed result: `name` is its folder below `reports`.

    `changed` are the files and folders whose code has changed; None without digests.
    """

    name: str
    changed: list[str] | None

    @property
    def state(self) -> str:
        """State in one word."""
        return "unknown" if self.changed is None else "stale" if self.changed else "fresh"


def results(root: Path = ROOT) -> list[Result]:
    """All committed results, by name; those in the folder of another belong to it."""
    reports = root / "reports"
    folders = {path.parent for kind in ("*.json", "*.md") for path in reports.rglob(kind)}
    tops = {f for f in folders - {reports} if not folders & {*f.parents} - {reports}}
    return [Result(str(f.relative_to(reports)), _changed(f, root)) for f in sorted(tops)]


def _changed(folder: Path, root: Path) -> list[str] | None:
    recorded: dict[str, str] = {}
    for path in folder.glob("*.json"):
        document = json.loads(path.read_text("utf-8"))
        recorded |= document.get("code", {}) if isinstance(document, dict) else {}
    if not recorded:
        return None
    return [place for place, digest in recorded.items() if _digest(place, root) != digest]


def _digest(place: str, root: Path) -> str:
    try:
        return computation_digests([place], root)[place]
    except FileNotFoundError:
        return "removed"


def quotes(root: Path = ROOT) -> Iterator[tuple[str, str]]:
    """Results with the sentences that quote their numbers, as ``PAGE:LINE: SENTENCE``."""
    for page in pages():
        section: set[str] = set()
        introduced: set[str] = set()
        line = 1
        for block in re.split(r"(\n(?: *\n)+)", (root / page).read_text("utf-8")):
            names = set(_NAMED.findall(block))
            if block.startswith("#"):
                section = set()
            elif block and not _COMMENT.sub("", block).strip():
                section |= names
            inherited = section | introduced
            introduced = (
                names if block.endswith(":") else introduced if not block.strip() else set()
            )
            rows = block.splitlines() if "\n|" in f"\n{block}" else [block]
            inherited |= set(_NAMED.findall(rows[0])) if rows and _COMMENT.match(rows[0]) else set()
            for row in rows:
                for sentence in _SENTENCE_END.split(row):
                    if re.search(r"\d", _NO_NUMBERS.sub("", sentence)):
                        at = line + block.count("\n", 0, block.index(sentence))
                        text = f"{page}:{at}: {' '.join(_COMMENT.sub('', sentence).split())}"
                        yield from ((name, text) for name in inherited | {*_NAMED.findall(row)})
            line += block.count("\n")


def report(root: Path = ROOT) -> tuple[list[str], bool]:
    """Lines on all results, and whether no sentence quotes a stale one."""
    lines, is_clean = [], True
    sentences = list(dict.fromkeys(quotes(root)))
    for result in results(root):
        reason = f": changed {', '.join(result.changed)}" if result.changed else ""
        lines.append(f"{result.state:7} reports/{result.name}{reason}")
        if result.state != "stale":
            continue
        # What is in its folder belongs to a result.
        folder = f"{result.name}/"
        quoting = [
            text for name, text in sentences if f"{name}/".replace(".", "/").startswith(folder)
        ]
        lines += [f"        {sentence}" for sentence in quoting]
        is_clean &= not quoting
    return lines, is_clean


if __name__ == "__main__":
    report_lines, is_clean = report()
    print(*report_lines, sep="\n")
    sys.exit(not is_clean)
