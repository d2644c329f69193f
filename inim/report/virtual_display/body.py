"""The section's HTML: controls and canvases for the script, and views that stand in for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from inim.display import Display
from inim.display.misalignment import mounted
from inim.errors import InimError
from inim.lens import drawn_as
from inim.report.markup import element, figure, text, void
from inim.report.pictures import Pictures, is_wide
from inim.report.virtual_display.optics import SKETCHED_LENS_MODELS, drawn_as_none, optics
from inim.report.virtual_display.panels import EmbeddedPanel, Panel, embed_panels
from inim.report.virtual_display.scripts import data_element
from inim.report.wording import best_algorithm, is_number, items, part, viewpoint_names

__all__ = [
    "ANCHOR",
    "TITLE",
    "Eye",
    "Still",
    "is_live",
    "live_display",
    "report_display",
    "report_eyes",
    "report_panels",
    "report_stills",
]

ANCHOR, TITLE = "virtual-display", "Virtual display"

#: Room for a report's panels; the rest of the page has as much again.
REPORT_PANEL_BYTES = 6_000_000
_STILL_PX = 420
_GROUND_TRUTH = "Ground truth"
_NEEDED = "The live display needs scripts and WebGL 2; these pre-rendered views stand in for it."
_HELP = (
    "Drag across a picture to move the eye. Once clicked, or reached with the Tab key: scroll or "
    "pinch for the distance, arrow keys move the eye (with Shift farther), + and − go nearer and "
    "back, Home returns."
)


@dataclass(frozen=True)
class Eye:
    """A named place to look from, in the display frame."""

    name: str
    position_mm: tuple[float, float, float]


@dataclass(frozen=True)
class Still:
    """A pre-rendered view, (rows, columns, 3) uint8 sRGB, None where it is missing."""

    name: str
    remark: str
    codes: np.ndarray | None


def report_display(
    data: Mapping[str, Any], pictures: Pictures, *, most_bytes: int = REPORT_PANEL_BYTES
) -> str:
    """The section of a report; empty where the report says nothing of a display.

    Parameters
    ----------
    data : mapping
        Contents of report.json, schema ``inim.report/1``.
    pictures : Pictures
    most_bytes : int
        Room for the panels.
    """
    given = part(data, "display", "given")
    if not given:
        return ""
    try:
        display = mounted(Display(**given), str(data.get("misalign") or ""))
    except (InimError, TypeError) as error:
        return _left_out(f"the display cannot be set up ({error})")
    eyes = report_eyes(data)
    if not eyes:
        return _left_out("no viewpoint has a position")
    if not pictures.encoding.longest_px:
        return _left_out("the page would be too large; `inim view` shows it alone")
    panels, missing = report_panels(data, pictures, display)
    if not panels:
        return _left_out(f"{_joined(missing)} cannot be read, or not of the panel's size")
    return live_display(
        display,
        panels,
        eyes,
        report_stills(data, pictures, eyes[0].name),
        pictures,
        most_bytes=most_bytes,
        lens_model=str(data.get("lens_model")),
        remarks=[*_missing_words(missing), _lens_words(data)],
    )


def report_eyes(data: Mapping[str, Any]) -> list[Eye]:
    """The report's viewpoints, the one called centre first."""
    eyes = []
    for viewpoint in items(data, "viewpoints"):
        position = items(viewpoint, "position_mm")
        known = len(position) == 3 and all(map(is_number, position)) and position[2] > 0
        if "name" in part(viewpoint) and known:
            x, y, z = map(float, position)
            eyes.append(Eye(str(viewpoint["name"]), (x, y, z)))
    return sorted(eyes, key=lambda eye: eye.name != "centre")


def report_panels(
    data: Mapping[str, Any], pictures: Pictures, display: Display
) -> tuple[list[Panel], list[str]]:
    """The report's EIAs, the most important first, and the names of those that are not there."""
    best = best_algorithm(data)
    names = sorted(part(data, "algorithms"), key=lambda name: name != best)
    files = {_GROUND_TRUTH: ("truth", "eia.png")} | {n: ("eia", f"{n}.png") for n in names}
    panels, missing = [], []
    for name, place in files.items():
        codes = pictures.read(*place)
        if codes is None or codes.shape[:2] != display.eia_shape:
            missing.append(name)
        else:
            panels.append(Panel(name, codes))
    return panels, missing


def report_stills(data: Mapping[str, Any], pictures: Pictures, view: str) -> list[Still]:
    """What stands in on paper and without scripts: one viewpoint, as the report's views show it."""
    best = best_algorithm(data)
    sources = [(_GROUND_TRUTH, "ceiling")] + ([(best, best)] if best else [])
    model = data.get("lens_model", "")
    return [
        Still(name, f"from {view}, {model} lenses", pictures.read("views", place, f"{view}.png"))
        for name, place in sources
    ]


def live_display(
    display: Display,
    panels: Sequence[Panel],
    eyes: Sequence[Eye],
    stills: Sequence[Still],
    pictures: Pictures,
    *,
    most_bytes: int,
    lens_model: str = "thick",
    remarks: Sequence[str] = (),
) -> str:
    """The section's content: the live display, hidden until the script shows it, and its stand-in.

    Parameters
    ----------
    display : Display
        As its array lies.
    panels : sequence of Panel
        Of its size, the most important first.
    eyes : sequence of Eye
        The first is where the eye starts.
    stills : sequence of Still
    pictures : Pictures
        Embeds the stills.
    most_bytes : int
        Room for the panels.
    lens_model : str
        What the display starts with, or the one nearest to it that is drawn live.
    remarks : sequence of str
        Said below the display.
    """
    embedded, left_out = embed_panels(panels, most_bytes)
    words = [*_embedding_words(embedded, left_out), *remarks, *_display_words(display)]
    note = element("p", text(" ".join(filter(None, words))), class_="note")
    if not embedded:
        return _stand_in(stills, pictures) + note
    start = [0, min(1, len(embedded) - 1)][: len(embedded)]
    data = {
        "optics": optics(display),
        "panels": [{"name": one.name, "source": one.source} for one in embedded],
        "viewpoints": [{"name": e.name, "position_mm": list(e.position_mm)} for e in eyes],
        "start": start,
    }
    return (
        _live(display, [one.name for one in embedded], start, eyes, lens_model)
        + _stand_in(stills, pictures)
        + note
        + data_element(data)
    )


def is_live(body: str) -> bool:
    """Whether a section's content holds a live display, which needs the script."""
    return "<canvas " in body  # whatever comes from outside is escaped


def _left_out(reason: str) -> str:
    return element("p", text(f"Left out: {reason}."), class_="note")


def _stand_in(stills: Sequence[Still], pictures: Pictures) -> str:
    why = element("p", text(_NEEDED), class_="note", id="virtual-display-why")
    shown = [
        figure(pictures.embed(s.codes, f"{s.name} {s.remark}", _STILL_PX), s.name, s.remark)
        for s in stills
    ]
    wide = any(is_wide(s.codes) for s in stills)
    pictured = element("div", *shown, class_="stills wide" if wide else "stills")
    return element("div", why, pictured if shown else "", class_="stand-in")


def _live(
    display: Display,
    names: Sequence[str],
    start: Sequence[int],
    eyes: Sequence[Eye],
    lens_model: str,
) -> str:
    several = len(start) > 1
    screens = [_screen(display, names, side, index) for side, index in enumerate(start)]
    body = [
        element("p", text(_HELP), class_="lead", id="virtual-display-help"),
        _controls(eyes, several, lens_model),
        element("div", *screens, class_="screens"),
        element("p", class_="readout"),
        element("p", class_="sign"),
        _sliders(),
        element("p", class_="spoken", role="status"),
    ]
    kinds = ["virtual", *(["wide"] if display.width_mm > 1.5 * display.height_mm else [])]
    kinds += [] if several else ["single"]
    return element("div", *body, class_=" ".join(kinds), id="virtual-display-live", hidden="hidden")


def _controls(eyes: Sequence[Eye], several: bool, lens_model: str) -> str:
    buttons = [
        element("button", text(eye.name), type="button", data_viewpoint=i, aria_pressed="false")
        for i, eye in enumerate(eyes)
    ]
    # A thick lens focuses as a thin one does; a pinhole shows one pixel all over.
    first = drawn_as(lens_model)
    radios = [_radio(model, model == first) for model in SKETCHED_LENS_MODELS]
    parts = [_choices("Look from", buttons), _choices("Lens model", radios)]
    if several:
        box = void("input", type="checkbox", name_="together", checked="checked")
        parts.append(_choices("Compare", [element("label", box, "side by side")]))
    return element("div", *parts, class_="controls")


def _choices(legend: str, choices: Sequence[str]) -> str:
    inside = element("div", *choices, class_="choices")
    return element("fieldset", element("legend", text(legend)), inside)


def _radio(model: str, checked: bool) -> str:
    chosen = "checked" if checked else None
    button = void("input", type="radio", name_="lens-model", value=model, checked=chosen)
    return element("label", button, text(model))


def _screen(display: Display, names: Sequence[str], side: int, index: int) -> str:
    word = ("Left", "Right")[side]
    if len(names) > 1:
        options = [
            element("option", text(name), value=i, selected="selected" if i == index else None)
            for i, name in enumerate(names)
        ]
        head = element("label", word, element("select", *options))
    else:
        # One panel: nothing to choose, but the script wants to be told what is shown.
        only = element("option", text(names[0]), value=0, selected="selected")
        head = element("b", text(names[0])) + element("select", only, hidden="hidden")
    canvas = element(
        "canvas",
        tabindex=0,
        role="application",
        aria_roledescription="virtual display",
        aria_label=names[index],
        aria_describedby="virtual-display-help",
        style=f"aspect-ratio:{display.width_mm:.6g}/{display.height_mm:.6g}",
    )
    return element("figure", head, canvas)


def _sliders() -> str:
    sliders = [
        element("label", text(label), void("input", type="range", name_=name, **limits))
        for name, label, limits in (
            ("x", "Eye, left to right", {"step": "any"}),
            ("y", "Eye, down to up", {"step": "any"}),
            ("z", "Eye, near to far", {"min": 0, "max": 1, "step": "any"}),
        )
    ]
    return element("div", *sliders, class_="sliders")


def _embedding_words(embedded: Sequence[EmbeddedPanel], left_out: Sequence[str]) -> list[str]:
    words = []
    if any(not one.is_exact for one in embedded):
        words.append(
            "The panels are too large to be embedded exactly: they are compressed with loss here, "
            "and exact in the folder."
        )
    if left_out:
        words.append(
            f"Left out, the page would be too large: {_joined(left_out)}. "
            "`inim view` shows every panel."
        )
    return words


def _missing_words(missing: Sequence[str]) -> list[str]:
    if not missing:
        return []
    return [f"Not there, or not of the panel's size: {_joined(missing)}."]


def _lens_words(data: Mapping[str, Any]) -> str:
    model = data.get("lens_model")
    if model in SKETCHED_LENS_MODELS or not model:
        return ""
    views = "views" if viewpoint_names(data) else "pictures"
    return f"The report's {views} and scores are those of {model} lenses; thin ones come nearest."


def _display_words(display: Display) -> list[str]:
    words = ["The eye is a point."]
    if drawn_as_none(display):
        words.append("Panel pixels are drawn evenly lit: sub-pixels and pixel fill as none.")
    if display.tilt_x_deg or display.tilt_y_deg:
        words.append("The viewing zone is stated for a panel that is not tilted.")
    return words


def _joined(names: Sequence[str]) -> str:
    return ", ".join(names)
