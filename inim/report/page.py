"""The page of every report: one HTML file that needs no network and no other file.

A page is a header, a list of sections and a footer. Everything but embedded images, the page's own
style sheets and its own scripts is refused by its content security policy, and it can be read as a
whole with scripts off.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Protocol

import msgspec

from inim.documents import Document
from inim.documents.parts import Checks
from inim.report.markup import element, folded, mark, table, text
from inim.report.wording import MISSING, plain, short

_POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; {scripts}; "
    "base-uri 'none'; form-action 'none'"
)


@dataclass(frozen=True)
class Section:
    """A part of a page under its own heading.

    Attributes
    ----------
    anchor : str
        Links to the section end in ``#anchor``.
    title : str
        Plain text.
    body : str
        HTML. A section without a body is left out of the page.
    is_folded : bool
        Only the title shows until it is clicked.
    """

    anchor: str
    title: str
    body: str
    is_folded: bool = False


@dataclass(frozen=True)
class Widget:
    """A style sheet, and a script that runs in pages that hold `marker`.

    Attributes
    ----------
    style, script : str
        Contents of the CSS and the JavaScript file.
    marker : str
        HTML that only the widget itself writes: text from outside is escaped.
    """

    style: str
    script: str
    marker: str

    def is_in(self, html: str) -> bool:
        """Whether `html` needs the script."""
        return self.marker in html


@cache
def package_text(*path: str) -> str:
    """The text of a file that comes with `inim.report`."""
    return resources.files("inim.report").joinpath(*path).read_text("utf-8")


def render_page(
    heading: object,
    facts: Iterable[str],
    sections: Iterable[Section],
    *,
    window_title: str,
    footer: str,
    verdict_badge: str = "",
    style: str = "",
    widgets: Sequence[Widget] = (),
) -> str:
    """The whole page.

    Parameters
    ----------
    heading : object
        Plain text above the page.
    facts : iterable of str
        HTML, shown in one line below the heading.
    sections : iterable of Section
        In their order. The navigation links to them where there are several.
    window_title : str
        Plain text for the browser's window.
    footer : str
        Plain text; see `data_note`.
    verdict_badge : str
        HTML, from `badge` or `check_badge`.
    style : str
        CSS that only this kind of page needs.
    widgets : sequence of Widget
        Their styles are always in the page, their scripts only where a section needs them.

    Returns
    -------
    str
        HTML that ends in a line break.
    """
    shown = [section for section in sections if section.body]
    scripts = [package_text("page.js")]
    scripts += [w.script for w in widgets if any(w.is_in(s.body) for s in shown)]
    styles = [package_text("report.css"), *(w.style for w in widgets), style]
    head = _head(window_title, "".join(styles), scripts)
    main = "\n".join(map(_section, shown))
    parts = [
        *([_skip_link(shown[0])] if len(shown) > 1 else []),
        _header(heading, facts, verdict_badge),
        *([_contents(shown)] if len(shown) > 1 else []),
        f"<main>\n{main}\n</main>",
        element("footer", element("p", text(footer))),
        *(f"<script>{script}</script>" for script in scripts),
    ]
    body = "\n".join(parts)
    return f'<!doctype html>\n<html lang="en">\n{head}\n<body>\n{body}\n</body>\n</html>\n'


def _head(title: str, style: str, scripts: Sequence[str]) -> str:
    policy = _POLICY.format(scripts=_script_policy(scripts))
    return (
        '<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{text(policy)}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{text(title)}</title>\n<style>\n{style}</style>\n</head>"
    )


def _script_policy(scripts: Sequence[str]) -> str:
    """The directive that lets these very scripts run, and no other."""
    digests = (hashlib.sha256(script.encode()).digest() for script in scripts)
    allowed = " ".join(f"'sha256-{base64.b64encode(one).decode('ascii')}'" for one in digests)
    return "script-src " + (allowed or "'none'")


def _skip_link(first: Section) -> str:
    return element("a", "Skip to the content", class_="skip", href=f"#{first.anchor}")


def _header(heading: object, facts: Iterable[str], verdict_badge: str) -> str:
    line = element("p", " · ".join(facts), class_="facts")
    title = element("div", element("h1", text(heading)), line)
    return element("header", title, verdict_badge)


def _contents(sections: Sequence[Section]) -> str:
    links = [element("a", text(one.title), href=f"#{one.anchor}") for one in sections]
    return element("nav", *links, aria_label="Sections")


def _section(section: Section) -> str:
    label = f"{section.anchor}-title"
    heading = element("h2", text(section.title), id=label)
    body = folded(heading, section.body) if section.is_folded else heading + section.body
    return element("section", body, id=section.anchor, aria_labelledby=label)


def badge(word: str, *lines: str) -> str:
    """A verdict in a word and a sign, and only then a colour; below it `lines` of HTML."""
    kind = word.replace(" ", "-")
    word = element("strong", mark(word), text(word.capitalize()))
    return element("p", word, element("span", " · ".join(lines)), class_=f"verdict {kind}")


def check_badge(verdict: Checks, warnings: Sequence[str] = ()) -> str:
    """The verdict, with links to the sections `checks` and `warnings`."""
    none = "; no criteria set" * (verdict.word == "ran clean")
    counted = f"{verdict.passed_count} of {len(verdict.checks)} checks passed{none}"
    lines = [f'<a href="#checks">{counted}</a>']
    if warnings:
        words = f"{len(warnings)} warning{'s' * (len(warnings) > 1)}"
        lines.append(f'<a href="#warnings">{words}</a>')
    return badge(verdict.word, *lines)


class _Dated(Protocol):
    @property
    def created(self) -> str: ...


def timestamp(document: _Dated) -> str:
    """Time of a document, as HTML."""
    words = plain(document.created).replace("T", " ")
    return element("time", text(words.replace("+00:00", " UTC").replace("Z", " UTC")))


def data_note(document: Document, file: str) -> str:
    """The footer's words: what wrote the page, and which file has its data."""
    version = getattr(document, "inim_version", "")
    words = f"data in {file} ({document.__struct_config__.tag})"
    return f"inim {plain(version)} · {words}" if version else words


def how_to_reproduce(document: Document, more: str = "") -> Section:
    """The command of a report and whatever could make another run differ.

    Parameters
    ----------
    document : Document
        Its `command`, `settings`, `scene`, `versions` and `backend` are shown, as far as it has
        them.
    more : str
        HTML below the command.
    """
    data: dict[str, Any] = msgspec.to_builtins(document)
    command = element("pre", element("code", text(data["command"])), tabindex=0)
    scene = data.get("scene") or {}  # null in a bench of something else
    facts = {**scene, **scene.get("fit", {})}
    tables = {
        "Settings; what is not listed is the display's own": {
            key: value for key, value in data.get("settings", {}).items() if value is not None
        },
        "Scene": {key: value for key, value in facts.items() if _is_fact(key, value)},
        "Versions": {"inim": data["inim_version"], **data.get("versions", {})},
        "Backend": data.get("backend", {}),
    }
    drawn = [_facts_table(caption, values) for caption, values in tables.items() if values]
    below = "".join(drawn)
    if len(drawn) > 1:  # the longest on the left, the others one below another on the right
        stack = element("div", *drawn[1:], class_="stack")
        below = element("div", drawn[0], stack, class_="columns")
    return Section("reproduce", "How to reproduce", command + more + below, is_folded=True)


def _is_fact(key: str, value: object) -> bool:
    """True unless the command or another section shows it: folders, and what is nested."""
    first = value[0] if isinstance(value, (list, tuple)) and value else value
    return key != "allow_folders" and not isinstance(first, dict)


def _facts_table(caption: str, values: Mapping[str, Any]) -> str:
    rows = [
        [text(key), element("span", _lines(value), class_="value")] for key, value in values.items()
    ]
    return table(caption, ["Key", "Value"], rows, "facts")


def _lines(value: object) -> str:
    """A value in full, so that it can be given again; a matrix as one line per row."""
    if isinstance(value, (list, tuple)):
        rows = [v if isinstance(v, (list, tuple)) else [v] for v in value]
        return "<br>".join(text("  ".join(short(v) for v in row)) for row in rows)
    return text(MISSING if value is None else value)
