"""Page of a validation, `report.html`, and its sections.

Each module in this folder registers one or several sections in its ``SECTIONS``; to add a section,
add a file. Images are embedded. If the page is too large, it is built again with smaller images;
images shown smaller or compressed are stored in full in the report's folder. The whole page can be
read without scripts, which only move existing content.
"""

import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path

from inim.report.document import ReportDocument
from inim.report.images import ENCODINGS, Encoding, ReportImages
from inim.report.labels import verdict_words
from inim.report.page import Section, Widget, check_badge, document_page, text
from inim.system.cache import ResultCache
from inim.system.process.threads import threads

#: A page above this is built again with smaller images.
LARGEST_PAGE_BYTES = 10_000_000


@dataclass(frozen=True)
class ReportSection:
    """Section of the page.

    * `body`: function from the report's data and its images to HTML; empty if the section does not
      apply.
    """

    place: int
    anchor: str
    title: str
    body: Callable[[ReportDocument, ReportImages], str]
    widget: Widget | None = None
    is_folded: bool = False


@cache
def all_sections() -> tuple[ReportSection, ...]:
    """All sections registered in this folder, in order."""
    modules = [
        import_module(f"{__name__}.{module_info.name}")
        for module_info in pkgutil.iter_modules(__path__)
    ]
    sections: list[ReportSection] = [section for module in modules for section in module.SECTIONS]
    return tuple(sorted(sections, key=lambda section: section.place))


def render_html(data: ReportDocument, folder: Path, cache: ResultCache | None = None) -> str:
    """The whole report as one HTML page.

    * `folder`: where the report's PNG files lie. One that is missing or unreadable shows as a box.

    Returns the page, below `LARGEST_PAGE_BYTES` unless the data without images is above it.
    """
    cache = cache or ResultCache()
    return small_enough(lambda encoding: _page(data, ReportImages(Path(folder), encoding, cache)))


def small_enough(build: Callable[[Encoding], str]) -> str:
    """The first page below `LARGEST_PAGE_BYTES` of those with ever smaller images, or the last."""
    page = ""
    for encoding in ENCODINGS:
        page = build(encoding)
        if len(page.encode()) < LARGEST_PAGE_BYTES:
            break
    return page


def _page(data: ReportDocument, images: ReportImages) -> str:
    listed = all_sections()
    with threads() as submit:  # packing and comparing images takes the longest
        begun = [submit(section.body, data, images) for section in listed]
        bodies = [future.result() for future in begun]
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
        f"Display {text(data.display.parameters.name)}",
        f"lens model {text(data.lens_model)}",
        f"renderer {text(data.backend.variant)}",
        f"inim {text(data.inim_version)}",
    ]
