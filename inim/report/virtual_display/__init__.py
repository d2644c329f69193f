"""The virtual display: an EIA through its lens array, drawn live in the page by WebGL.

Here are the controls and canvases for the script, the data it draws from, and the views that stand
in for it without scripts or WebGL 2. The script and its shader are package data of this folder.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from inim.display import Display
from inim.display.cells import kinds_of_pixels
from inim.display.layouts import Layout
from inim.display.lens import (
    channel_indices,
    check_lens_model,
    drawn_model,
    lens_array,
    lens_traits,
    models_drawn_live,
    thick,
    trace_to_panel,
    white_exposure,
)
from inim.display.panel import emitted_picture, panel_words, seen_light, white_of
from inim.display.pixels import SUBPIXELS, panel_points
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.report.images import ReportImages, is_wide
from inim.report.page import Widget, element, figure, lead, package_text, radio, select, text, void
from inim.scores.document_parts import EyePosition
from inim.system.errors import DisplayError

ANCHOR, TITLE = "virtual-display", "Virtual display"
#: The lens models that the shader draws of any display.
LIVE_LENS_MODELS = models_drawn_live()
_THICK = thick.MODEL.name

_FOLDER = "virtual_display"
# The shader has the layout's code in place of this line.
_LAYOUT_LINE = "// lens_centre of the layout\n"
LIVE = Widget(
    package_text(_FOLDER, "virtual_display.css"),
    package_text(_FOLDER, "virtual_display.js"),
    "<canvas ",
)
_STILL_PX = 420
# Qualities, None without loss, tried in turn until the two panels that matter most fit. An EIA
# cannot be scaled down: its pixels are directions.
_QUALITIES = (None, 95, 85)
_NEEDED = (
    "The live display needs scripts and WebGL 2. Until it starts, pre-rendered views replace it."
)
_HELP = (
    "Drag across an image to move the eye. Click an image, or select it with the Tab key, for more "
    "controls: scroll or pinch to change the distance, press the arrow keys to move (with Shift in "
    "larger steps), + and − to move closer and back, and Home to return."
)
_SWAYS = "The eye moves by itself until you touch the page or press a key."
_ABOVE = "From above, to scale: the display, the viewing zone, and the eye."
#: Between the eyes of a pair: most adults' are 54 to 74 mm apart.
_BETWEEN_EYES_MM = 63


@dataclass(frozen=True)
class Panel:
    """An EIA to show.

    * `codes`, (rows, columns, 3) uint8: sRGB, row 0 on top.
    """

    name: str
    codes: np.ndarray


@dataclass(frozen=True)
class Still:
    """A pre-rendered view, (rows, columns, 3) uint8 sRGB, None where it is missing."""

    name: str
    remark: str
    codes: np.ndarray | None


def live_display(
    display: Display,
    panels: Sequence[Panel],
    eyes: Sequence[EyePosition],
    stills: Sequence[Still],
    images: ReportImages,
    *,
    most_bytes: int,
    lens_model: str = "thick",
    remarks: Sequence[str] = (),
) -> str:
    """Section content: the virtual display, hidden until its script runs, and its replacement.

    * `display`: display with its misaligned array.
    * `panels`: panels of its size, the most important first.
    * `eyes`: eye positions; the eye starts at the first.
    * `lens_model`: initial lens model, or its replacement in the virtual display.
    """
    embedded, left_out = embed_panels(panels, most_bytes, images)
    words = [*_embedding_words(embedded, left_out), *remarks, *_display_words(display)]
    note = lead(" ".join(filter(None, words)), "note")
    if not embedded:
        return _stand_in(stills, images) + note
    start = [0, min(1, len(embedded) - 1)]
    data = {
        "optics": _optics(display),
        "panels": [{"name": panel.name, "source": panel.source} for panel in embedded],
        "viewpoints": [{"name": e.name, "position_mm": list(e.position_mm)} for e in eyes],
        "start": start,
    }
    return (
        _live_html(display, [panel.name for panel in embedded], start, eyes, lens_model)
        + _stand_in(stills, images)
        + note
        + _data_element(data, display.layout)
    )


def live_lens_models(display: Display) -> list[str]:
    """The lens models that the shader draws of a display's lenses.

    Thick ones where they are spherical, fill their cells and can be ground.
    """
    traits = lens_traits(display)
    is_spherical = not (traits.conic or traits.asphere)
    if not (is_spherical and traits.full_aperture):
        return LIVE_LENS_MODELS
    try:
        check_lens_model(_THICK, display)
    except DisplayError:
        return LIVE_LENS_MODELS
    return [*LIVE_LENS_MODELS, _THICK]


def shown_lens_model(display: Display, lens_model: str) -> str:
    """The lens model itself where it is drawn live, or the one that stands in for it."""
    # A thin lens focuses as a thick one does; a pinhole shows one pixel all over.
    return lens_model if lens_model in live_lens_models(display) else drawn_model(lens_model)


def _stand_in(stills: Sequence[Still], images: ReportImages) -> str:
    why = element("p", text(_NEEDED), class_="note", id="virtual-display-why")
    pictures = [
        figure(images.embed(s.codes, f"{s.name} {s.remark}", _STILL_PX), s.name, s.remark)
        for s in stills
    ]
    wide = any(is_wide(s.codes) for s in stills)
    pictured = element("div", *pictures, class_="stills wide" if wide else "stills")
    return element("div", why, pictured if pictures else "", class_="stand-in")


def _live_html(
    display: Display,
    names: Sequence[str],
    start: Sequence[int],
    eyes: Sequence[EyePosition],
    lens_model: str,
) -> str:
    several = len(names) > 1
    screens = [_screen(display, names, side, index) for side, index in enumerate(start)]
    body = [
        element("div", *screens, class_="screens"),
        element(
            "p",
            text(_HELP),
            element("span", text(f" {_SWAYS}"), class_="sways"),
            class_="lead",
            id="virtual-display-help",
        ),
        _controls(eyes, several, live_lens_models(display), shown_lens_model(display, lens_model)),
        _where(),
        element("p", class_="spoken", role="status"),
    ]
    kinds = ["virtual", *(["wide"] if display.width_mm > 1.5 * display.height_mm else [])]
    kinds += [] if several else ["single"]
    return element("div", *body, class_=" ".join(kinds), id="virtual-display-live", hidden="hidden")


def _controls(eyes: Sequence[EyePosition], several: bool, models: Sequence[str], first: str) -> str:
    buttons = [
        element("button", text(eye.name), type="button", data_viewpoint=i, aria_pressed="false")
        for i, eye in enumerate(eyes)
    ]
    radios = [radio("lens-model", model, model, model == first) for model in models]
    # The script shows those that the device supports.
    device = [
        element("button", text(label), type="button", name_=name, hidden="hidden", **more)
        for name, label, more in (
            ("full", "full screen", {}),
            ("tilt", "tilt to look", {"aria_pressed": "false"}),
        )
    ]
    parts = [_choices("Viewpoint", buttons), _choices("Lens model", radios)]
    if several:
        box = void("input", type="checkbox", name_="together", checked="checked")
        parts.append(_choices("Compare", [element("label", box, "side by side")]))
    stereo = void("input", type="checkbox", name_="pair")
    limits = {"min": 0, "max": 200, "step": 1, "value": _BETWEEN_EYES_MM}
    between = void("input", type="number", name_="between", **limits)
    pair = [element("label", stereo, "two eyes"), element("label", between, "mm apart")]
    parts += [_choices("Stereo pair", pair), _choices("Device", device)]
    return element("div", *parts, class_="controls")


def _choices(legend: str, choices: Sequence[str]) -> str:
    inside = element("div", *choices, class_="choices")
    return element("fieldset", element("legend", text(legend)), inside)


def _screen(display: Display, names: Sequence[str], side: int, index: int) -> str:
    word = ("Left", "Right")[side]
    if len(names) > 1:
        menu = select(list(enumerate(names)), index)
        head = element("label", element("span", word, class_="side"), menu)
    else:
        # One panel: nothing to choose, but the script reads what is shown here.
        words = element("b", text(names[0])), element("span", word, class_="side")
        head = element("p", *words) + select([(0, names[0])], 0, hidden="hidden")
    canvas = element(
        "canvas",
        tabindex=0,
        role="application",
        aria_roledescription="virtual display",
        aria_label=names[index],
        aria_describedby="virtual-display-help",
        style=f"--ratio:{display.width_mm:.6g}/{display.height_mm:.6g}",
    )
    return element("figure", head, canvas)


def _where() -> str:
    """Display and eye in words, by sliders and from above; the script fills them in."""
    eye = element("polyline", class_="sight") + element("circle", r=4, class_="eye")
    parts = [element("polygon", class_="zone"), element("g", eye), element("g", eye)]
    panel = element("polyline", class_="panel")
    drawing = element("svg", *parts, panel, viewBox="-110 -8 220 170", role="img", class_="above")
    sliders = [
        element("label", text(label), void("input", type="range", name_=name, **limits))
        for name, label, limits in (
            ("x", "Eye, left to right", {"step": "any"}),
            ("y", "Eye, down to up", {"step": "any"}),
            ("z", "Eye, near to far", {"min": 0, "max": 1, "step": "any"}),
        )
    ]
    words = element("p", class_="readout"), element("p", class_="sign")
    return element(
        "div",
        element("div", *words, element("div", *sliders, class_="sliders")),
        element("figure", drawing, element("figcaption", text(_ABOVE))),
        class_="where",
    )


def _embedding_words(embedded: Sequence[_Embedded], left_out: Sequence[str]) -> list[str]:
    words = []
    if any(not panel.is_exact for panel in embedded):
        words.append(
            "The panels are too large for this page, so it contains them with lossy compression. "
            "The files in the folder are exact."
        )
    if left_out:
        words.append(
            f"Omitted, because the page would be too large: {', '.join(left_out)}. "
            "`inim view` shows every panel."
        )
    return words


def _display_words(display: Display) -> list[str]:
    words = ["The eye is a point, without a pupil."]
    if display.tilt_x_deg or display.tilt_y_deg:
        words.append("The viewing zone is that of a panel without tilt.")
    return words + panel_words(display)


def _optics(display: Display) -> dict[str, Any]:
    """Values of a `Display` for the virtual display, as JSON; lengths in millimetres.

    `traits` are names for the compilation of the shader.

    * `display`: display with its misaligned array.
    """
    array, traits = lens_array(display), lens_traits(display)
    rows, columns = display.eia_shape
    indices = channel_indices(display)
    kinds = {
        "COLORED": len(set(indices)) > 1,
        "APERTURE": not traits.full_aperture,
        "ROUND_APERTURE": traits.round_aperture,
        "CLEAR_BETWEEN": traits.clear_between,
        "TURNED": traits.turned,
        "TILTED": traits.tilted,
        "BULGES_TO_VIEWER": traits.bulges_to_viewer,
        f"LAYERS {len(array.layers)}": bool(array.layers),
        "TOUCHING": traits.touching,
        "GLARE": display.veiling_glare > 0,
        "CYLINDERS": traits.layout.of_cylinders,
        "AREAS": display.subpixels != "none" or display.pixel_fill < 1,
        f"CELLS {len(display.subpixel_cells)}": bool(display.subpixel_cells),
    }
    thick_lens = {}
    if _THICK in live_lens_models(display):
        curvature, foot = thick.relief_mm(display)
        thick_lens = {"curvature_per_mm": curvature, "foot_mm": foot}
        thick_lens |= {"thickness_mm": array.thickness, "design_index": array.design_index}
        thick_lens |= {"exposure": float(white_exposure(display, _THICK))}
    return {
        "size_mm": [display.width_mm, display.height_mm],
        "pitch_mm": [array.pitch_x, array.pitch_y],
        "lenses": list(display.layout.grid[::-1]),
        "outermost_mm": list(display.layout.outermost_mm),
        "gap_mm": array.gap,
        "elemental_pitch_mm": [display.elemental_image_pitch_mm, display.elemental_row_pitch_mm],
        "power_per_mm": [(n - 1) / array.radius for n in indices],
        "index": list(indices),
        "thick": thick_lens or None,
        "traits": [name for name, has in kinds.items() if has],
        "half_aperture_mm": array.half_aperture,
        "shift_mm": [array.shift_x, array.shift_y],
        "turn": [array.cosine, array.sine],
        "tilt": [array.tilt_x, array.tilt_y],
        "layers": array.layers,
        "white": white_of(display),
        "black_level": display.black_level,
        "ambient_reflection": display.ambient_reflection,
        "veiling_glare": display.veiling_glare,
        "pixel_mm": display.pixel_pitch_mm,
        **_emitting_areas(display),
        "panel": [columns, rows],
        "front_mm": max(display.depth_range_mm[1], 0.0),
    }


def _emitting_areas(display: Display) -> dict[str, Any]:
    """Areas of red, green and blue in a pixel, in pixels; see the shader's uniforms."""
    fill, colours = display.pixel_fill, SUBPIXELS[display.subpixels]
    return {
        "areas": [
            [float(c.right), float(c.width) / 2 * fill, float(c.height) / 2 * fill,
             -1 if c.turn is None else c.turn]
            for c in colours
        ],
        "brightness": [1 / (float(c.share) * fill * fill) for c in colours],
        "cells": display.subpixel_cells,
        "kinds": kinds_of_pixels(display),
    }  # fmt: skip


def _data_element(data: Mapping[str, Any], layout: Layout) -> str:
    """Block with `data` and the shader, which the script reads and the browser does not execute."""
    shader = package_text(_FOLDER, "virtual_display.glsl").replace(_LAYOUT_LINE, layout.shader)
    whole = {**data, "shader": shader}
    coded = json.dumps(whole, allow_nan=False).replace("<", "\\u003c").replace("&", "\\u0026")
    return f'<script type="application/json" id="virtual-display-data">{coded}</script>'


@dataclass(frozen=True)
class _Embedded:
    """A panel as a data URI; `is_exact` where no pixel differs from the EIA's."""

    name: str
    source: str
    is_exact: bool


def embed_panels(
    panels: Sequence[Panel], most_bytes: int, images: ReportImages
) -> tuple[list[_Embedded], list[str]]:
    """Embed as many panels as fit, and return the names of the others.

    * `panels`: the most important first. The first two go in before anything else, compressed with
      loss if they have to be.
    * `most_bytes`: for all data URIs together.
    """
    for quality in _QUALITIES:
        embedded = [_embed(images, panel, quality) for panel in panels[:2]]
        room = most_bytes - sum(len(panel.source) for panel in embedded)
        if room < 0:
            continue
        left_out = []
        for panel in panels[2:]:
            embedded_panel = _embed(images, panel, quality)
            if len(embedded_panel.source) <= room:
                embedded.append(embedded_panel)
                room -= len(embedded_panel.source)
            else:
                left_out.append(panel.name)
        return embedded, left_out
    return [], [panel.name for panel in panels]


def _embed(images: ReportImages, panel: Panel, quality: int | None) -> _Embedded:
    is_exact = quality is None
    source = images.source(panel.codes, quality, "WEBP" if is_exact else "JPEG")
    return _Embedded(panel.name, source, is_exact)


def still_view(
    eia: np.ndarray,
    display: Display,
    eye_mm: tuple[float, float, float],
    lens_model: str = "pinhole",
    *,
    pixels_per_lens: int = 4,
    grid: int = 4,
) -> np.ndarray:
    """A view of a display from one eye position, by the lens models in NumPy.

    * `eia`, (rows, columns, 3) uint8, sRGB: row 0 on top.
    * `lens_model`: one of `inim.display.lens.lens_models`.
    * `pixels_per_lens`: of the view, which shows exactly the lens array.
    * `grid`: samples along one side of a view pixel, at the shader's places.

    Returns (rows, columns, 3) uint8, sRGB.
    """
    rows, columns = (n * pixels_per_lens for n in display.layout.grid)
    drive = linear_from_srgb(np.arange(256) / 255)
    light = emitted_picture(np.stack([drive] * 3, -1), display)
    total = np.zeros((rows, columns, 3), np.float32)
    for j in range(grid):
        for i in range(grid):
            x = _places(columns, (i + (j + 0.5) / grid) / grid, display.width_mm)[None, :]
            y = _places(rows, (j + (i + 0.5) / grid) / grid, display.height_mm)[::-1, None]
            codes, weight = _codes(eia, display, lens_model, x, y, eye_mm)
            total += light[codes, np.arange(3)] * weight
    total *= white_exposure(display, lens_model)
    return srgb_to_uint8(srgb_from_linear(seen_light(total / grid**2, display)))


def _places(count: int, within: float, size_mm: float) -> np.ndarray:
    """One place inside each of `count` pixels that fill `size_mm` about the axis, ascending."""
    return ((np.arange(count) + within) / count - 0.5) * size_mm


def _codes(
    eia: np.ndarray,
    display: Display,
    lens_model: str,
    x: np.ndarray,
    y: np.ndarray,
    eye_mm: tuple[float, float, float],
) -> tuple[np.ndarray, np.ndarray]:
    """Code values that rays through points (x, y) of the array land on, and their weights.

    Both (rows, columns, 3), of red, green and blue.
    """
    slopes = (x - eye_mm[0]) / eye_mm[2], (y - eye_mm[1]) / eye_mm[2]
    codes = np.zeros((y.shape[0], x.shape[1], 3), np.uint8)
    weights = np.zeros(codes.shape, np.float32)
    traced = None
    for channel, index in enumerate(channel_indices(display)):
        if index != traced:
            *landed, weight = trace_to_panel(display, lens_model, x, y, *slopes, index=index)
            on_panel = (np.where(weight > 0, place, np.inf) for place in landed)
            points, traced = panel_points(display, *on_panel), index
        codes[..., channel] = eia[points.row, points.column, channel]
        weights[..., channel] = np.where(weight > 0, weight, 0) * points.shines[channel]
    return codes, weights
