"""The report of a photograph beside its simulation: `photo.json`, `photo.html` and its pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace

from inim.documents.files import folder_files, write_forms
from inim.documents.photo import PhotoDocument
from inim.files.image import write_png
from inim.report.images import DIFFERENCE_GAIN, ENCODINGS, Images, difference
from inim.report.markup import element, figure, saved_plot, text, text_table
from inim.report.page import Section, data_note, how_to_reproduce, render_page, timestamp
from inim.report.plots import new_figure, save, style
from inim.report.wording import number, per_cent

_PICTURES = ("photograph", "simulation", "matched")
#: What a report has for certain, its JSON first.
FILES = (
    "photo.json",
    "photo.html",
    *(f"{name}.png" for name in _PICTURES),
    "flow.svg",
    "flow.png",
)
_STYLE = """
.plot img { max-width: 900px; }
.photo table { width: auto; min-width: min(100%, 640px); }
.photo th, .photo td { text-align: right; }
.photo th:first-child { text-align: left; }
.photos { display: flex; flex-wrap: wrap; gap: 16px; }
.photos figure { flex: 0 1 calc(50% - 8px); min-width: 300px; margin: 0; }
.photos img { width: 100%; height: auto; }
"""
_STAGES = (
    "Scores of the simulation against the photograph, as one cause after another is put into it: "
    "the exposure alone, then the remaining shift, then blur, then the response of panel and "
    "camera. The share of the squared error that is left at the end has other causes."
)
_FLOW = (
    "How far the photograph lies from the simulation, by blocks: pixels of the photograph, to the "
    "right and down. One colour all over is a camera that moved; a pattern, a wrong display."
)


def write_photo(
    data: PhotoDocument, pictures: Mapping[str, np.ndarray], flow: np.ndarray, folder: Path
) -> None:
    """Write all forms into a folder, `photo.json` last: it marks a whole report.

    Parameters
    ----------
    data : PhotoDocument
        `files` is set here.
    pictures : mapping of str to (H, W, 3) array, linear
        The photograph, its simulation, and that matched in all three respects.
    flow : (rows, columns, 2) array
        See `inim.calibrate.photo.Difference`.
    folder : Path
    """
    for name in _PICTURES:
        write_png(folder / f"{name}.png", pictures[name])
    save(_draw(flow), folder, "flow")
    data = replace(data, files=folder_files(folder, *FILES))
    write_forms(data, folder, FILES[0], {FILES[1]: lambda data: _page(data, folder)})


def _draw(flow: np.ndarray) -> Any:
    figure, axes = new_figure(2, 0.75 + 3.6 * flow.shape[0] / max(flow.shape[1], 1), 1)
    largest = max(float(np.nanmax(np.abs(flow), initial=0.0)), 1e-3)
    for k, what in enumerate(("to the right", "down")):
        shown = axes[k].imshow(
            flow[..., k], cmap="RdBu_r", vmin=-largest, vmax=largest, interpolation="nearest"
        )
        style(axes[k], what, "", "")
        axes[k].grid(False)
        bar = figure.colorbar(shown, ax=axes[k], shrink=0.8)
        bar.ax.set_title("px", fontsize=8)
    return figure


def _page(data: PhotoDocument, folder: Path) -> str:
    return render_page(
        data.title,
        ["Photograph against simulation", text(data.photograph), timestamp(data)],
        [
            Section("causes", "What differs", _causes(data)),
            Section("pictures", "Pictures", _pictures(folder)),
            Section("scores", "Scores", _scores(data)),
            Section("flow", "Remaining shift", _flow(folder)),
            how_to_reproduce(data),
        ],
        window_title=f"{data.title} – inim",
        footer=data_note(data, FILES[0]),
        style=_STYLE,
    )


def _causes(data: PhotoDocument) -> str:
    geometry = data.geometry
    rows = [
        [
            "Geometry: shift, photograph px",
            f"{number(geometry.right_px, 3)} right, {number(geometry.down_px, 3)} down, "
            f"± {number(geometry.standard_error_px, 3)}; a lens is {number(geometry.lens_px, 1)} "
            "wide",
        ],
        ["Blur: sigma, photograph px", number(data.blur_sigma_px, 2)],
        *(
            [
                f"Tone: {label}",
                ", ".join(number(getattr(curve, key), 3) for curve in data.tone.values()),
            ]
            for key, label in (
                ("gamma", "gamma (red, green, blue)"),
                ("black", "black level"),
                ("gain", "gain"),
            )
        ),
    ]
    words = "What has to be changed in the simulation"
    return text_table(words, ["Cause", "Found"], rows, "photo")


def _pictures(folder: Path) -> str:
    images = Images(folder, ENCODINGS[1])
    photo, plain, matched = (images.read(f"{name}.png") for name in _PICTURES)
    shown = (
        (photo, "Photograph", "what is compared of it"),
        (plain, "Simulation", "exposed alike"),
        (matched, "Simulation, matched", "shift, blur and tone put in"),
        (difference(photo, matched), "Difference", f"of the two, times {DIFFERENCE_GAIN}"),
    )
    figures = (figure(images.embed(p, name), name, remark) for p, name, remark in shown)
    return element("div", *figures, class_="photos")


def _scores(data: PhotoDocument) -> str:
    rows = [
        [
            stage.name,
            number(stage.scores["ssim"], 4),
            number(stage.scores["psnr_db"], 2),
            number(stage.scores["flip"], 4),
            per_cent(stage.error_share, 1),
        ]
        for stage in data.stages
    ]
    heads = ["Simulation", "SSIM", "PSNR, dB", "FLIP", "squared error left"]
    table = text_table("Against the photograph", heads, rows, "photo")
    return element("p", text(_STAGES), class_="lead") + table


def _flow(folder: Path) -> str:
    words = "Maps of the remaining shift, to the right and down"
    return element("p", text(_FLOW), class_="lead") + saved_plot(folder / "flow.svg", words)
