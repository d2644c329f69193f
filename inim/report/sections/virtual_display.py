"""The virtual display: a report's EIAs through its lens array, live."""

from collections.abc import Sequence
from dataclasses import dataclass

from inim.display import Display
from inim.display.misalignment import misaligned
from inim.report.document import ReportDocument
from inim.report.images import ReportImages
from inim.report.labels import REFERENCE
from inim.report.page import lead
from inim.report.sections import ReportSection
from inim.report.virtual_display import (
    ANCHOR,
    LIVE,
    TITLE,
    Panel,
    Still,
    live_display,
    live_lens_models,
)

#: Room for a report's panels; the rest of the page has as much again.
REPORT_PANEL_BYTES = 6_000_000


@dataclass(frozen=True)
class Shown:
    """An EIA of a report: its name on the page, its file, and the folder of its views."""

    name: str
    file: tuple[str, str]
    views: str


def report_display(
    data: ReportDocument, images: ReportImages, *, most_bytes: int = REPORT_PANEL_BYTES
) -> str:
    """The section of a report."""
    best = data.best_algorithm
    names = sorted(data.algorithms, key=lambda name: name != best)
    candidates = [Shown(REFERENCE, ("truth", "eia.png"), "reference"), *map(of_algorithm, names)]
    return shown_display(data, images, candidates, most_bytes=most_bytes)


def of_algorithm(name: str) -> Shown:
    """The EIA of a report's algorithm."""
    return Shown(name, ("eia", f"{name}.png"), name)


def shown_display(
    data: ReportDocument,
    images: ReportImages,
    candidates: Sequence[Shown],
    *,
    most_bytes: int = REPORT_PANEL_BYTES,
) -> str:
    """The live display of EIAs, the two most important first; see `report_display`."""
    display = misaligned(data.display.parameters, data.misalign)
    eyes = [eye for eye in data.viewpoints if eye.position_mm[2] > 0]
    eyes.sort(key=lambda eye: eye.name != "centre")
    if not eyes:
        return _left_out("no viewpoint has a position")
    if not images.encoding.longest_px:
        return _left_out("the page would be too large; `inim view` shows it alone")
    panels, missing = _panels(candidates, images, display)
    if not panels:
        return _left_out(f"{', '.join(missing)} cannot be read, or not of the panel's size")
    view = eyes[0].name
    words = f"from {view}, {data.lens_model} lenses"
    stills = [
        Still(eia.name, words, images.read("views", eia.views, f"{view}.png"))
        for eia in candidates[:2]
    ]
    remarks = [f"Missing, or not of the panel's size: {', '.join(missing)}."] if missing else []
    if data.lens_model not in live_lens_models(display):
        remarks.append(
            f"The views and scores of this report use {data.lens_model} lenses. This virtual "
            "display uses the most similar lens model that it has."
        )
    return live_display(
        display,
        panels,
        eyes,
        stills,
        images,
        most_bytes=most_bytes,
        lens_model=data.lens_model,
        remarks=remarks,
    )


def _panels(
    candidates: Sequence[Shown], images: ReportImages, display: Display
) -> tuple[list[Panel], list[str]]:
    """The EIAs, and the names of those that are not there."""
    panels, missing = [], []
    for candidate in candidates:
        codes = images.read(*candidate.file)
        if codes is None or codes.shape[:2] != display.eia_shape:
            missing.append(candidate.name)
        else:
            panels.append(Panel(candidate.name, codes))
    return panels, missing


def _left_out(reason: str) -> str:
    return lead(f"Omitted: {reason}.", "note")


SECTIONS = (ReportSection(20, ANCHOR, TITLE, report_display, LIVE),)
