"""Page of every report: one HTML file that needs no network and no other file.

A page is a header, a list of sections and a footer. Its content security policy allows only
embedded images and the page's own style sheets and scripts. The whole page can be read without
scripts. External strings are escaped in `text`, and only there.
"""

import base64
import hashlib
import html
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import msgspec

from inim.report.labels import MISSING, plain, short
from inim.scores.document_parts import Checks
from inim.system.document import Document

_POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; {scripts}; "
    "base-uri 'none'; form-action 'none'"
)


@dataclass(frozen=True)
class Section:
    """A part of a page under its own heading.

    * `anchor`: links to the section end in ``#anchor``.
    * `title`: plain text.
    * `body`: HTML. A section without a body is left out of the page.
    * `is_folded`: only the title shows until it is clicked.
    """

    anchor: str
    title: str
    body: str
    is_folded: bool = False


@dataclass(frozen=True)
class Widget:
    """A style sheet, and a script that runs in pages that hold `marker`.

    * `style`, `script`: contents of the CSS and the JavaScript file.
    * `marker`: HTML that only the widget itself writes: text from outside is escaped.
    """

    style: str
    script: str
    marker: str

    def is_in(self, html: str) -> bool:
        """True if `html` needs the script."""
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
    widgets: Sequence[Widget] = (),
) -> str:
    """Whole page as HTML.

    * `heading`: plain text above the page.
    * `facts`: HTML, shown in one line below the heading.
    * `sections`: sections in order. The navigation links to them if there are several.
    * `window_title`: plain text for the browser's window.
    * `footer`: plain text.
    * `verdict_badge`: HTML, from `badge` or `check_badge`.
    * `widgets`: widgets: styles are always in the page, scripts only if a section needs them.

    Returns HTML that ends in a line break.
    """
    nonempty = [section for section in sections if section.body]
    scripts = [package_text("page.js")]
    scripts += [w.script for w in widgets if any(w.is_in(s.body) for s in nonempty)]
    styles = [package_text("report.css"), *(w.style for w in widgets)]
    head = _head(window_title, "".join(styles), scripts)
    main = "\n".join(map(_section, nonempty))
    title = element(
        "div", element("h1", text(heading)), element("p", " · ".join(facts), class_="facts")
    )
    skip, contents = [], []
    if len(nonempty) > 1:
        first = f"#{nonempty[0].anchor}"
        links = [
            element("a", text(section.title), href=f"#{section.anchor}") for section in nonempty
        ]
        skip = [element("a", "Skip to the content", class_="skip", href=first)]
        contents = [element("nav", *links, aria_label="Sections")]
    parts = [
        *skip,
        element("header", title, verdict_badge),
        *contents,
        f"<main>\n{main}\n</main>",
        element("footer", element("p", text(footer))),
        *(f"<script>{script}</script>" for script in scripts),
    ]
    body = "\n".join(parts)
    return f'<!doctype html>\n<html lang="en">\n{head}\n<body>\n{body}\n</body>\n</html>\n'


def _head(title: str, style: str, scripts: Sequence[str]) -> str:
    digests = (hashlib.sha256(script.encode()).digest() for script in scripts)
    allowed = " ".join(f"'sha256-{base64.b64encode(digest).decode('ascii')}'" for digest in digests)
    policy = _POLICY.format(scripts=f"script-src {allowed}")
    return (
        '<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{text(policy)}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{text(title)}</title>\n<style>\n{style}</style>\n</head>"
    )


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
    suffix = "; no criteria set" * (verdict.word == "ran clean")
    counted = f"{verdict.passed_count} of {len(verdict.checks)} checks passed{suffix}"
    lines = [*map(text, verdict.doubts), f'<a href="#checks">{counted}</a>']
    if warnings:
        words = f"{len(warnings)} warning{'s' * (len(warnings) > 1)}"
        lines.append(f'<a href="#warnings">{words}</a>')
    return badge(verdict.word, *lines)


def document_page(
    document: Any,
    file: str,
    facts: Iterable[str],
    sections: Iterable[Section],
    *,
    purpose: str = "inim",
    words: str = "",
    **options: Any,
) -> str:
    """The page of a document: its title, time and data file around the sections.

    * `document`: has `title` and `created`.
    * `facts`, `sections`: as of `render_page`; the time follows the facts.
    * `purpose`, `words`: name of the window after the title, and words that belong to the title.
    """
    created = plain(document.created).replace("T", " ")
    time = element("time", text(created.replace("+00:00", " UTC").replace("Z", " UTC")))
    version = getattr(document, "inim_version", "")
    footer = f"inim {plain(version)} · " if version else ""
    return render_page(
        document.title,
        [*facts, time],
        sections,
        window_title=f"{document.title}{words} – {purpose}",
        footer=f"{footer}data in {file} ({document.__struct_config__.tag})",
        **options,
    )


def how_to_reproduce(document: Document, more: str = "") -> Section:
    """Section with the command of a report and all conditions that could change a repeated run.

    * `document`: its `command`, `settings`, `scene`, `versions` and `backend` are shown, as far as
      it has them.
    * `more`: HTML below the command.
    """
    data: dict[str, Any] = msgspec.to_builtins(document)
    command = element("pre", element("code", text(data["command"])), tabindex=0)
    scene = data.get("scene") or {}  # null in a bench of something else
    facts = {**scene, **scene.get("fit", {})}
    tables = {
        "Settings; others are those of the display": {
            key: value for key, value in data.get("settings", {}).items() if value is not None
        },
        "Scene": {key: value for key, value in facts.items() if _is_fact(key, value)},
        "Versions": {"inim": data["inim_version"], **data.get("versions", {})},
        "Backend": data.get("backend", {}),
    }
    parts = [_facts_table(caption, values) for caption, values in tables.items() if values]
    below = "".join(parts)
    if len(parts) > 1:  # the longest on the left, the others one below another on the right
        stack = element("div", *parts[1:], class_="stack")
        below = element("div", parts[0], stack, class_="columns")
    return Section("reproduce", "How to reproduce", command + more + below, is_folded=True)


def _is_fact(key: str, value: object) -> bool:
    """True unless the command or another section shows the value: folders, and nested values."""
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


_SIGNS = {"passed": "✓", "ran clean": "–", "failed": "✕"}


def text(value: object) -> str:
    """`value` as HTML text or attribute: the one place where escaping happens."""
    return html.escape(plain(value), quote=True)


def element(name: str, *content: str, **attributes: object) -> str:
    """An element around HTML `content`; attributes are escaped, ``class_`` becomes class."""
    html_attributes = {
        key.rstrip("_").replace("_", "-"): value for key, value in attributes.items()
    }
    attribute_text = "".join(
        f' {k}="{text(v)}"' for k, v in html_attributes.items() if v is not None
    )
    return f"<{name}{attribute_text}>{''.join(content)}</{name}>"


def radio(name: str, value: str, label: str, is_checked: bool) -> str:
    """A labelled radio button."""
    checked = "checked" if is_checked else None
    button = void("input", type="radio", name_=name, value=value, checked=checked)
    return element("label", button, text(label))


def select(options: Sequence[tuple[object, str]], chosen: object, **attributes: object) -> str:
    """A drop-down list of values and their labels."""
    listed = [
        element("option", text(label), value=v, selected="selected" if v == chosen else None)
        for v, label in options
    ]
    return element("select", *listed, **attributes)


def void(name: str, **attributes: object) -> str:
    """An element that can have no content; attributes as in `element`."""
    return element(name, **attributes).removesuffix(f"</{name}>")


def lead(words: object, kind: str = "lead") -> str:
    """Introductory paragraph of plain text."""
    return element("p", text(words), class_=kind)


def bullets(lines: Iterable[object], class_: str) -> str:
    """A list of plain texts; empty where there are none."""
    listed = [element("li", text(line)) for line in lines]
    return element("ul", *listed, class_=class_) if listed else ""


def folded(title: str, *content: str, is_open: bool = False) -> str:
    """HTML that is visible after a click on its title, and always in print."""
    html_attributes = {"open": "open"} if is_open else {}
    return element("details", element("summary", title), *content, **html_attributes)


def svg_source(svg: bytes) -> str:
    """A drawing as the source of an img element."""
    return f"data:image/svg+xml;base64,{base64.b64encode(svg).decode('ascii')}"


def plot(svg: bytes, alt: str, caption: str = "", **attributes: object) -> str:
    """A drawing as an embedded image: it scales, and its styles do not affect the page."""
    image = void("img", src=svg_source(svg), alt=alt, **attributes)
    words = element("figcaption", text(caption)) if caption else ""
    return element("figure", image, words, class_="plot")


def saved_plot(path: Path, alt: str) -> str:
    """The drawing in an SVG file; empty where there is no such file."""
    try:
        return plot(path.read_bytes(), alt)
    except OSError:
        return ""


def text_table(
    caption: str, heads: Sequence[str], rows: Iterable[Sequence[object]], class_: str = ""
) -> str:
    """A table of plain texts; the first cell of a row names it."""
    cells = [[text(cell) for cell in row] for row in rows]
    return table(caption, [text(head) for head in heads], cells, class_)


def table(
    caption: str, heads: Sequence[str], rows: Iterable[Sequence[str]], class_: str = ""
) -> str:
    """A table of HTML cells; the first cell of a row names it."""
    head = "".join(element("th", cell, scope="col") for cell in heads)
    body = "".join(_row(row) for row in rows)
    whole = (
        f"<table><caption>{text(caption)}</caption>"
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    )
    # Focusable, so that a wide table can be scrolled from the keyboard.
    reach = {"tabindex": 0, "role": "region", "aria_label": caption}
    return element("div", whole, class_=f"scroll {class_}".strip(), **reach)


def _row(cells: Sequence[str]) -> str:
    rest = "".join(element("td", cell) for cell in cells[1:])
    return element("tr", element("th", cells[0], scope="row"), rest)


def mark(word: str) -> str:
    """A tick or a cross before a verdict's word, so that colour is never the only sign."""
    return element("span", _SIGNS.get(word, "?"), class_="mark", aria_hidden="true")


def figure(picture: str, name: str, remark: str = "") -> str:
    """One picture under which stand its name and a remark."""
    words = element("b", text(name)) + (f" {text(remark)}" if remark else "")
    return element("figure", picture, element("figcaption", words))


def captioned(
    name: str,
    remark: str,
    images: Sequence[str],
    facts: Iterable[tuple[str, Sequence[tuple[str, str]]]],
) -> str:
    """A figure of one or more images; under its name, per reference, the scores against it."""
    title = element("b", text(name)) + " " + element("span", text(remark))
    rows = "".join(element("div", element("dt", text(k)), _score_entries(v)) for k, v in facts)
    caption = element("figcaption", title, element("dl", rows))
    kind = "single" if len(images) == 1 else "pair"
    return element("figure", element("div", *images, class_=kind), caption)


def _score_entries(scores: Iterable[tuple[str, str]]) -> str:
    return "".join(
        element("dd", text(f"{metric} "), element("b", text(value))) for metric, value in scores
    )
