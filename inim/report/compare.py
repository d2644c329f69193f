"""The report of a comparison of two runs: page, data, JUnit and Markdown."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from inim.files.image import write_atomically
from inim.report.junit import render_junit
from inim.report.markup import element, section, text
from inim.report.pictures import ENCODINGS, Pictures
from inim.report.sections.record import check_list
from inim.report.sections.regression import regression
from inim.report.strict_json import from_strict, to_strict
from inim.report.summary import render_checks
from inim.report.wording import MISSING, part, verdict

__all__ = ["SCHEMA", "write_comparison"]

SCHEMA = "inim.compare/1"
_POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
    "base-uri 'none'; form-action 'none'"
)
_SHOWN = ("title", "created", "inim", "mitsuba", "libLLVM", "device", "threads", "seed")


def write_comparison(data: Mapping[str, Any], folder: Path) -> None:
    """Write all forms of a comparison into a folder, `compare.json` last: it marks a whole one.

    Parameters
    ----------
    data : mapping
        Schema `inim.compare/1`; `files` is added here.
    folder : Path
        Its pictures lie there already.
    """
    pictures = [str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()]
    files = sorted([*pictures, "compare.html", "compare.json", "junit.xml", "summary.md"])
    strict = to_strict({**data, "files": files})
    data = from_strict(strict)
    texts = {
        "compare.html": _page(data, folder),
        "junit.xml": render_junit(data),
        "summary.md": render_checks(data),
        "compare.json": json.dumps(strict, indent=1, allow_nan=False, ensure_ascii=False) + "\n",
    }
    for name, content in texts.items():
        _write(folder / name, content)


def _write(path: Path, content: str) -> None:
    def put(temporary: Path) -> None:
        temporary.write_text(content, encoding="utf-8", errors="backslashreplace")

    write_atomically(path, put)


def _page(data: Mapping[str, Any], folder: Path) -> str:
    style = resources.files("inim.report").joinpath("report.css").read_text("utf-8")
    title = f"{data.get('title', MISSING)}: {verdict(data)} – inim comparison"
    head = (
        '<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{text(_POLICY)}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{text(title)}</title>\n<style>\n{style}</style>\n</head>"
    )
    folders = [part(data, side).get("folder", MISSING) for side in ("before", "after")]
    facts = element("p", text(f"{folders[1]} against {folders[0]}"), class_="facts")
    header = element("header", element("div", element("h1", text(data.get("title"))), facts))
    body = "\n".join(
        [
            section("regression", "What changed", regression(data, Pictures(folder, ENCODINGS[0]))),
            section("checks", "Checks", check_list(data)),
            section("runs", "The two runs", _runs(data)),
        ]
    )
    return (
        f'<!doctype html>\n<html lang="en">\n{head}\n<body>\n{header}\n'
        f"<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def _runs(data: Mapping[str, Any]) -> str:
    from inim.report.markup import table

    sides = [part(data, side, "circumstances") for side in ("before", "after")]
    rows = [[text(name), *(text(side.get(name, MISSING)) for side in sides)] for name in _SHOWN]
    return table("What made them", ["", "Before", "After"], rows, "facts")
