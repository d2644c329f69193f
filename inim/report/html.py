"""The page of a validation: `report.html`.

Images are embedded. Should they make the page too large, it is built again with smaller ones; what
is shown smaller or compressed is in full in the folder beside the page. It can be read as a whole
with scripts off: they only move what stands there anyway.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from inim.parallel import threads
from inim.report import wipe
from inim.report.images import ENCODINGS, Images
from inim.report.markup import text
from inim.report.page import Section, check_badge, data_note, render_page, timestamp
from inim.report.sections import all_sections
from inim.report.virtual_display.live import LIVE
from inim.report.wording import MISSING, part, verdict

__all__ = ["LARGEST_PAGE_BYTES", "render_html"]

#: A page above this is built again with smaller images.
LARGEST_PAGE_BYTES = 10_000_000


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
        The page, below `LARGEST_PAGE_BYTES` unless the data without images is above it.
    """
    page = ""
    for encoding in ENCODINGS:
        page = _page(data, Images(Path(folder), encoding))
        if len(page.encode()) < LARGEST_PAGE_BYTES:
            break
    return page


def _page(data: Mapping[str, Any], images: Images) -> str:
    with threads() as submit:  # packing and comparing images takes the longest
        begun = [(s, submit(s.body, data, images)) for s in all_sections()]
        sections = [Section(s.anchor, s.title, one.result()) for s, one in begun]
    title = data.get("title") or "Untitled"
    return render_page(
        title,
        _facts(data),
        sections,
        window_title=f"{title}: {verdict(data)} – inim report",
        footer=data_note(data, "report.json"),
        verdict_badge=check_badge(data),
        widgets=[LIVE, wipe.WIPE],
    )


def _facts(data: Mapping[str, Any]) -> list[str]:
    display = part(data, "display", "given").get("name", MISSING)
    return [
        f"Display {text(display)}",
        f"lens model {text(data.get('lens_model', MISSING))}",
        text(part(data, "backend").get("variant", MISSING)),
        f"inim {text(data.get('inim_version', MISSING))}",
        timestamp(data),
    ]
