"""The pages of a bench, of a stress run, and of studies written with the same functions."""

import base64
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from inim.report.page import (
    Section,
    bullets,
    document_page,
    element,
    folded,
    how_to_reproduce,
    lead,
    saved_plot,
    text,
    text_table,
    void,
)
from inim.report.plots import save
from inim.report.summary import markdown_command, markdown_line, markdown_section
from inim.system.document import write_listed

# Of embedded pictures, 0 to 100.
_QUALITY = 90


@dataclass(frozen=True)
class Table:
    """Text cells under heads; the first cell of a row names it. Without rows it is left out."""

    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Fold:
    """Tables and PNG pictures, by caption, that the page shows after a click on their title."""

    title: str
    tables: Sequence[Table] = ()
    pictures: Mapping[str, Path] = field(default_factory=dict)

    def html(self) -> str:
        """The folded part of the page."""
        tables = (text_table(t.caption, t.heads, t.rows, "numbers") for t in self.tables)
        pictures = "".join(map(_picture, self.pictures.items()))
        views = element("div", pictures, class_="views wide") if pictures else ""
        return folded(text(self.title), *tables, views)


def _picture(item: tuple[str, Path]) -> str:
    """A captioned picture, embedded as WebP, which takes a fifth of the bytes of PNG."""
    from PIL import Image

    caption, path = item
    stream = io.BytesIO()
    with Image.open(path) as picture:
        picture.save(stream, "WEBP", quality=_QUALITY)
    source = f"data:image/webp;base64,{base64.b64encode(stream.getvalue()).decode('ascii')}"
    image = void("img", src=source, alt=caption, loading="lazy")
    return element("figure", image, element("figcaption", text(caption)))


@dataclass(frozen=True)
class PagePart:
    """A part of the page of a bench, a stress run or a study.

    * `name`, `title`, `lead`: its anchor, its heading and the words below that.
    * `plot`: the plot's files are ``PLOT.svg`` and ``PLOT.png``.
    * `remarks`: how it was measured; shown among the page's conditions.
    * `claims`, (str, sequence of str): a heading and sentences below it; none if empty.
    * `folds`: further tables and pictures, each shown after a click.
    """

    name: str
    title: str
    lead: str
    tables: Sequence[Table]
    plot: str = ""
    figure: Any = None
    remarks: Sequence[str] = ()
    claims: tuple[str, Sequence[str]] = ("", ())
    folds: Sequence[Fold] = ()

    @property
    def all_tables(self) -> list[Table]:
        """Its tables, and those of its folds."""
        return [*self.tables, *(table for fold in self.folds for table in fold.tables)]


@dataclass(frozen=True)
class StudyPage:
    """Content of a page besides its document.

    * `summary`: heading of the first section, with `warnings` and `remarks`.
    """

    summary: str
    facts: Sequence[str]
    remarks: Sequence[str]
    parts: Sequence[PagePart]
    warnings: Sequence[str] = ()

    def write(self, data: Any, folder: Path, stem: str) -> None:
        """Write all forms into a folder, ``STEM.json`` last, as a mark of completeness.

        * `data`: its `files` are listed here.
        * `folder`: may hold figures; those of the parts are written first, for the page shows them.
        """
        for part in self.parts:
            if part.figure is not None:
                save(part.figure, folder, part.plot)
        forms = {
            f"{stem}.md": self.markdown,
            f"{stem}.html": lambda data: self._html(data, folder, f"{stem}.json"),
        }
        write_listed(data, folder, f"{stem}.json", forms)

    def markdown(self, data: Any) -> str:
        """The page as Markdown: remarks, tables, claims."""
        blocks = [f"## {markdown_line(data.title)}", markdown_line(", ".join(self.facts))]
        blocks += [f"⚠ {markdown_line(warning)}" for warning in self.warnings]
        blocks.append(_join_lines(self.remarks))
        for table in (table for part in self.parts for table in part.all_tables if table.rows):
            blocks.append(markdown_section(table.caption, table.heads, table.rows))
        for heading, lines in (part.claims for part in self.parts if part.claims[1]):
            blocks += [f"### {markdown_line(heading)}", _join_lines(lines)]
        return "\n\n".join([*blocks, markdown_command(data.command)])

    def _html(self, data: Any, folder: Path, file: str) -> str:
        summary = bullets(self.warnings, "cautions") + bullets(self.remarks, "remarks")
        sections = [Section("summary", self.summary, summary)]
        for part in self.parts:
            body = saved_plot(folder / f"{part.plot}.svg", part.title)
            heading, claims = part.claims
            if claims:
                body += element("h3", text(heading)) + bullets(claims, "remarks claims")
            body += "".join(
                text_table(t.caption, t.heads, t.rows, "numbers") for t in part.tables if t.rows
            )
            body += "".join(fold.html() for fold in part.folds)
            sections.append(Section(part.name, part.title, body and lead(part.lead) + body))
        sections.append(how_to_reproduce(data))
        return document_page(data, file, map(text, self.facts), sections)


def _join_lines(lines: Iterable[str]) -> str:
    return "\n".join(f"* {markdown_line(line)}" for line in lines)
