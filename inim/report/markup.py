"""HTML elements, tables and figures. Whatever comes from outside is escaped here and only here."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence
from pathlib import Path

from inim.report.wording import plain

_SIGNS = {"passed": "✓", "ran clean": "–", "failed": "✕"}


def text(value: object) -> str:
    """`value` as HTML text or attribute: the one place where escaping happens."""
    return html.escape(plain(value), quote=True)


def element(name: str, *content: str, **attributes: object) -> str:
    """An element around HTML `content`; attributes are escaped, ``class_`` becomes class."""
    given = {key.rstrip("_").replace("_", "-"): value for key, value in attributes.items()}
    written = "".join(f' {k}="{text(v)}"' for k, v in given.items() if v is not None)
    return f"<{name}{written}>{''.join(content)}</{name}>"


def void(name: str, **attributes: object) -> str:
    """An element that can have no content; attributes as in `element`."""
    return element(name, **attributes).removesuffix(f"</{name}>")


def bullets(lines: Iterable[object], class_: str) -> str:
    """A list of plain texts; empty where there are none."""
    listed = [element("li", text(line)) for line in lines]
    return element("ul", *listed, class_=class_) if listed else ""


def folded(title: str, *content: str, is_open: bool = False) -> str:
    """HTML that shows when its title is clicked; paper shows it anyway."""
    given = {"open": "open"} if is_open else {}
    return element("details", element("summary", title), *content, **given)


def plot(svg: bytes, alt: str, caption: str = "", **attributes: object) -> str:
    """A drawing as an embedded image: it scales, and its styles stay its own."""
    source = f"data:image/svg+xml;base64,{base64.b64encode(svg).decode('ascii')}"
    image = void("img", src=source, alt=alt, **attributes)
    words = element("figcaption", text(caption)) if caption else ""
    return element("figure", image, words, class_="plot")


def saved_plot(path: Path, alt: str, caption: str = "") -> str:
    """The drawing in an SVG file; empty where there is no such file."""
    try:
        return plot(path.read_bytes(), alt, caption)
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
    rows = "".join(element("div", element("dt", text(k)), _measured(v)) for k, v in facts)
    caption = element("figcaption", title, element("dl", rows))
    kind = "single" if len(images) == 1 else "pair"
    return element("figure", element("div", *images, class_=kind), caption)


def _measured(scores: Iterable[tuple[str, str]]) -> str:
    return "".join(
        element("dd", text(f"{metric} "), element("b", text(value))) for metric, value in scores
    )
