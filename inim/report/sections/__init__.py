"""The page of a validation, `report.html`, and its sections.

Each module in this folder registers one or several sections in its ``SECTIONS``; adding a section
is adding a file. Images are embedded. Should they make the page too large, it is built again with
smaller ones; what is shown smaller or compressed is in full in the report's folder. It can
be read as a whole with scripts off: they only move what stands there anyway.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path

from inim.cache import ResultCache
from inim.documents.report import ReportDocument
from inim.process.threads import threads
from inim.report.images import ENCODINGS, Encoding, Images
from inim.report.page import Section, Widget, check_badge, document_page, text
from inim.report.wording import verdict_words

#: A page above this is built again with smaller images.
LARGEST_PAGE_BYTES = 10_000_000


@dataclass(frozen=True)
class ReportSection:
    """A part of the page.

    Attributes
    ----------
    place : int
        Sections stand on the page in the order of their places.
    anchor, title : str
        As of `inim.report.page.Section`.
    body : callable
        From the report's data and its images to HTML; empty where the section does not apply.
    widget : Widget, optional
        What the section needs of style sheets and scripts.
    is_folded : bool
        As of `inim.report.page.Section`.
    """

    place: int
    anchor: str
    title: str
    body: Callable[[ReportDocument, Images], str]
    widget: Widget | None = None
    is_folded: bool = False


@cache
def all_sections() -> tuple[ReportSection, ...]:
    """Every section that a module in this folder registers, in order."""
    modules = [
        import_module(f"{__name__}.{found.name}") for found in pkgutil.iter_modules(__path__)
    ]
    sections: list[ReportSection] = [one for module in modules for one in module.SECTIONS]
    return tuple(sorted(sections, key=lambda section: section.place))


def render_html(data: ReportDocument, folder: Path, cache: ResultCache | None = None) -> str:
    """The whole report as one HTML page.

    Parameters
    ----------
    data : ReportDocument
    folder : Path
        Where the report's PNG files lie. One that is missing or unreadable shows as a box.
    cache : ResultCache, optional
        Of the page's pictures.

    Returns
    -------
    str
        The page, below `LARGEST_PAGE_BYTES` unless the data without images is above it.
    """
    cache = cache or ResultCache()
    return small_enough(lambda encoding: _page(data, Images(Path(folder), encoding, cache)))


def small_enough(made: Callable[[Encoding], str]) -> str:
    """The first page below `LARGEST_PAGE_BYTES` of those with ever smaller images, or the last."""
    page = ""
    for encoding in ENCODINGS:
        page = made(encoding)
        if len(page.encode()) < LARGEST_PAGE_BYTES:
            break
    return page


def _page(data: ReportDocument, images: Images) -> str:
    listed = all_sections()
    with threads() as submit:  # packing and comparing images takes the longest
        begun = [submit(section.body, data, images) for section in listed]
        bodies = [one.result() for one in begun]
    return document_page(
        data,
        "report.json",
        _facts(data),
        [
            Section(s.anchor, s.title, body, s.is_folded)
            for s, body in zip(listed, bodies, strict=True)
        ],
        purpose="inim report",
        words=f": {verdict_words(data)}",
        verdict_badge=check_badge(data.verdict, data.warnings),
        widgets=[section.widget for section in listed if section.widget],
    )


def _facts(data: ReportDocument) -> list[str]:
    return [
        f"Display {text(data.display.given.name)}",
        f"lens model {text(data.lens_model)}",
        text(data.backend.variant),
        f"inim {text(data.inim_version)}",
    ]
