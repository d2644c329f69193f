"""The report as one HTML file that needs nothing else: no network, no other files.

Pictures are embedded. Should they make the page too large, it is built again with smaller ones;
what is shown smaller or compressed is in full in the folder beside the page. It reads whole with
scripts off: they only move what stands there anyway.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from inim.parallel import threads
from inim.report import virtual_display, wipe
from inim.report.markup import element, mark, section, text
from inim.report.pictures import ENCODINGS, Pictures
from inim.report.scripts import script_element, script_policy
from inim.report.sections import SECTIONS
from inim.report.wording import MISSING, check_passed, checks, items, part, plain, verdict

__all__ = ["LARGEST_PAGE_BYTES", "render_html"]

#: A page above this is built again with smaller pictures.
LARGEST_PAGE_BYTES = 10_000_000

# Everything is refused but embedded pictures, the page's own style sheets and its scripts.
_POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; {scripts}; "
    "base-uri 'none'; form-action 'none'"
)


def render_html(data: Mapping[str, Any], folder: Path) -> str:
    """The whole report as one HTML page.

    Parameters
    ----------
    data : mapping
        The contents of report.json, schema ``inim.report/1``, with NaN where it lists one.
    folder : Path
        Where the report's PNG files lie. One that is missing or unreadable shows as a box.

    Returns
    -------
    str
        The page, below `LARGEST_PAGE_BYTES` unless the data without pictures is above it.
    """
    page = ""
    for encoding in ENCODINGS:
        page = _page(data, Pictures(Path(folder), encoding))
        if len(page.encode()) < LARGEST_PAGE_BYTES:
            break
    return page


def _page(data: Mapping[str, Any], pictures: Pictures) -> str:
    with threads() as submit:  # packing and comparing pictures takes the longest
        begun = [submit(s.body, data, pictures) for s in SECTIONS]
        bodies = [one.result() for one in begun]
    shown = [(s.anchor, s.title, body) for s, body in zip(SECTIONS, bodies, strict=True) if body]
    header = _header(data, _navigation((anchor, title) for anchor, title, _ in shown))
    main = "\n".join(section(*one) for one in shown)
    scripts = _scripts([body for _, _, body in shown])
    script = "".join(f"{script_element(one)}\n" for one in scripts)
    return (
        f'<!doctype html>\n<html lang="en">\n{_head(data, scripts)}\n<body>\n'
        f'<a class="skip" href="#overview">Skip to the scores</a>\n{header}\n'
        f"<main>\n{main}\n</main>\n{_footer(data)}\n{script}</body>\n</html>\n"
    )


def _scripts(bodies: Sequence[str]) -> list[str]:
    """The scripts that any of the sections needs."""
    needed = ((virtual_display.is_live, virtual_display.script), (wipe.is_wiped, wipe.script))
    return [script() for needs, script in needed if any(map(needs, bodies))]


def _head(data: Mapping[str, Any], scripts: Sequence[str]) -> str:
    style = resources.files("inim.report").joinpath("report.css").read_text("utf-8")
    style += virtual_display.style() + wipe.style()
    policy = _POLICY.format(scripts=script_policy(scripts))
    title = f"{data.get('title') or 'Untitled'}: {verdict(data)} – inim report"
    return (
        '<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{text(policy)}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{text(title)}</title>\n<style>\n{style}</style>\n</head>"
    )


def _header(data: Mapping[str, Any], navigation: str) -> str:
    display = part(data, "display", "given").get("name", MISSING)
    facts = [
        f"Display {text(display)}",
        f"lens model {text(data.get('lens_model', MISSING))}",
        text(part(data, "backend").get("variant", MISSING)),
        f"inim {text(data.get('inim_version', MISSING))}",
        element("time", text(_when(data.get("created")))),
    ]
    title = element("h1", text(data.get("title") or "Untitled"))
    left = element("div", title, element("p", " · ".join(facts), class_="facts"))
    return element("header", left, _verdict_badge(data), navigation)


def _when(created: object) -> str:
    words = plain(created or MISSING).replace("T", " ")
    return words.replace("+00:00", " UTC").replace("Z", " UTC")


def _verdict_badge(data: Mapping[str, Any]) -> str:
    """The verdict in a word and a sign, and only then a colour."""
    passed, total = sum(map(check_passed, checks(data))), len(checks(data))
    word = element("strong", mark(verdict(data)), text(verdict(data).capitalize()))
    lines = [f'<a href="#checks">{passed} of {total} checks passed</a>']
    warnings = len(items(data, "warnings"))
    if warnings:
        lines.append(f'<a href="#warnings">{warnings} warning{"s" * (warnings > 1)}</a>')
    kind = verdict(data).replace(" ", "-")
    return element("p", word, element("span", " · ".join(lines)), class_=f"verdict {kind}")


def _navigation(contents: Iterable[tuple[str, str]]) -> str:
    links = [f'<a href="#{anchor}">{text(title)}</a>' for anchor, title in contents]
    return element("nav", *links, aria_label="Sections")


def _footer(data: Mapping[str, Any]) -> str:
    version = text(data.get("inim_version", MISSING))
    schema = text(data.get("schema", MISSING))
    return element("footer", element("p", f"inim {version} · data in report.json ({schema})"))
