"""The virtual display: a report's EIAs through its lens array, live."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from inim.display import Display
from inim.display.misalignment import mounted
from inim.errors import InimError
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
from inim.report.wording import CEILING, best_algorithm, is_number, items, part, viewpoint_names

#: Room for a report's panels; the rest of the page has as much again.
REPORT_PANEL_BYTES = 6_000_000


@dataclass(frozen=True)
class Shown:
    """An EIA of a report: its name on the page, its file, and the folder of its views."""

    name: str
    file: tuple[str, str]
    views: str


def report_display(
    data: Mapping[str, Any], images: Images, *, most_bytes: int = REPORT_PANEL_BYTES
) -> str:
    """The section of a report; empty for a report without a display.

    Parameters
    ----------
    data : mapping
        Contents of report.json, schema ``inim.report/1``.
    images : Images
    most_bytes : int
        Room for the panels.
    """
    best = best_algorithm(data)
    names = sorted(part(data, "algorithms"), key=lambda name: name != best)
    shown = [Shown(CEILING, ("truth", "eia.png"), "ceiling"), *map(of_algorithm, names)]
    return shown_display(data, images, shown, most_bytes=most_bytes)


def of_algorithm(name: str) -> Shown:
    """The EIA of a report's algorithm."""
    return Shown(name, ("eia", f"{name}.png"), name)


def shown_display(
    data: Mapping[str, Any],
    images: Images,
    shown: Sequence[Shown],
    *,
    most_bytes: int = REPORT_PANEL_BYTES,
) -> str:
    """The live display of EIAs, the two that matter most first; see `report_display`."""
    given = part(data, "display", "given")
    if not given:
        return ""
    try:
        display = mounted(Display(**given), str(data.get("misalign") or ""))
    except (InimError, TypeError) as error:
        return _left_out(f"the display cannot be set up ({error})")
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
        lens_model=str(data.get("lens_model")),
        remarks=[*_missing_words(missing), _lens_words(data, display)],
    )


def _eyes(data: Mapping[str, Any]) -> list[Eye]:
    """The report's viewpoints, the one called centre first."""
    eyes = []
    for viewpoint in items(data, "viewpoints"):
        position = items(viewpoint, "position_mm")
        known = len(position) == 3 and all(map(is_number, position)) and position[2] > 0
        if "name" in part(viewpoint) and known:
            x, y, z = map(float, position)
            eyes.append(Eye(str(viewpoint["name"]), (x, y, z)))
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
    data: Mapping[str, Any], shown: Sequence[Shown], images: Images, view: str
) -> list[Still]:
    """What stands in on paper and without scripts: one viewpoint, as the report's views show it."""
    words = f"from {view}, {data.get('lens_model', '')} lenses"
    return [Still(one.name, words, images.read("views", one.views, f"{view}.png")) for one in shown]


def _left_out(reason: str) -> str:
    return element("p", text(f"Left out: {reason}."), class_="note")


def _missing_words(missing: Sequence[str]) -> list[str]:
    if not missing:
        return []
    return [f"Not there, or not of the panel's size: {', '.join(missing)}."]


def _lens_words(data: Mapping[str, Any], display: Display) -> str:
    model = data.get("lens_model")
    if model in live_lens_models(display) or not model:
        return ""
    views = "views" if viewpoint_names(data) else "pictures"
    return f"The report's {views} and scores are those of {model} lenses; thin ones come nearest."


SECTIONS = (ReportSection(20, ANCHOR, TITLE, report_display, LIVE),)
