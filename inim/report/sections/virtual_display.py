"""The virtual display: a report's EIAs through its lens array, live."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from inim.display import Display
from inim.display.misalignment import mounted
from inim.documents.picture import PictureDocument
from inim.documents.report import ReportDocument
from inim.report.images import Images
from inim.report.markup import element, text
from inim.report.sections import ReportSection
from inim.report.virtual_display import (
    ANCHOR,
    LIVE,
    TITLE,
    Eye,
    Panel,
    Still,
    live_display,
    live_lens_models,
)
from inim.report.wording import CEILING

#: Room for a report's panels; the rest of the page has as much again.
REPORT_PANEL_BYTES = 6_000_000


@dataclass(frozen=True)
class Shown:
    """An EIA of a report: its name on the page, its file, and the folder of its views."""

    name: str
    file: tuple[str, str]
    views: str


def report_display(
    data: ReportDocument, images: Images, *, most_bytes: int = REPORT_PANEL_BYTES
) -> str:
    """The section of a report.

    Parameters
    ----------
    data : ReportDocument
    images : Images
    most_bytes : int
        Room for the panels.
    """
    best = data.best_algorithm
    names = sorted(data.algorithms, key=lambda name: name != best)
    shown = [Shown(CEILING, ("truth", "eia.png"), "ceiling"), *map(of_algorithm, names)]
    return shown_display(data, images, shown, most_bytes=most_bytes)


def of_algorithm(name: str) -> Shown:
    """The EIA of a report's algorithm."""
    return Shown(name, ("eia", f"{name}.png"), name)


def shown_display(
    data: ReportDocument | PictureDocument,
    images: Images,
    shown: Sequence[Shown],
    *,
    most_bytes: int = REPORT_PANEL_BYTES,
) -> str:
    """The live display of EIAs, the two that matter most first; see `report_display`."""
    misalign = "" if isinstance(data, PictureDocument) else data.misalign
    display = mounted(data.display.given, misalign)
    eyes = _eyes(data)
    if not eyes:
        return _left_out("no viewpoint has a position")
    if not images.encoding.longest_px:
        return _left_out("the page would be too large; `inim view` shows it alone")
    panels, missing = _panels(shown, images, display)
    if not panels:
        return _left_out(f"{', '.join(missing)} cannot be read, or not of the panel's size")
    return live_display(
        display,
        panels,
        eyes,
        _stills(data, shown[:2], images, eyes[0].name),
        images,
        most_bytes=most_bytes,
        lens_model=data.lens_model,
        remarks=[*_missing_words(missing), _lens_words(data, display)],
    )


def _eyes(data: ReportDocument | PictureDocument) -> list[Eye]:
    """The report's viewpoints, the one called centre first."""
    eyes = [Eye(one.name, one.position_mm) for one in data.viewpoints if one.position_mm[2] > 0]
    return sorted(eyes, key=lambda eye: eye.name != "centre")


def _panels(
    shown: Sequence[Shown], images: Images, display: Display
) -> tuple[list[Panel], list[str]]:
    """The EIAs, and the names of those that are not there."""
    panels, missing = [], []
    for one in shown:
        codes = images.read(*one.file)
        if codes is None or codes.shape[:2] != display.eia_shape:
            missing.append(one.name)
        else:
            panels.append(Panel(one.name, codes))
    return panels, missing


def _stills(
    data: ReportDocument | PictureDocument, shown: Sequence[Shown], images: Images, view: str
) -> list[Still]:
    """What stands in on paper and without scripts: one viewpoint, as the report's views show it."""
    words = f"from {view}, {data.lens_model} lenses"
    return [Still(one.name, words, images.read("views", one.views, f"{view}.png")) for one in shown]


def _left_out(reason: str) -> str:
    return element("p", text(f"Left out: {reason}."), class_="note")


def _missing_words(missing: Sequence[str]) -> list[str]:
    if not missing:
        return []
    return [f"Not there, or not of the panel's size: {', '.join(missing)}."]


def _lens_words(data: ReportDocument | PictureDocument, display: Display) -> str:
    model = data.lens_model
    if model in live_lens_models(display):
        return ""
    return f"The report's views and scores are those of {model} lenses; thin ones come nearest."


SECTIONS = (ReportSection(20, ANCHOR, TITLE, report_display, LIVE),)
