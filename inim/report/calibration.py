"""The report of a calibration: `calibration.json`, `calibration.html` and its maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from inim.report.files import list_files, write_forms
from inim.report.markup import bullets, element, saved_plot, text, text_table
from inim.report.page import Section, data_note, how_to_reproduce, render_page, timestamp
from inim.report.plots import new_figure, save, style
from inim.report.wording import MISSING, items, number, part

SCHEMA = "inim.calibration/1"
#: What a report has for certain, its JSON first.
FILES = ("calibration.json", "calibration.html", "residuals.svg", "residuals.png")
_STYLE = """
.plot img { max-width: 1240px; }
.calibration table { font-size: 13px; width: auto; min-width: min(100%, 700px); }
.calibration th, .calibration td { white-space: nowrap; padding: 3px 8px; text-align: right; }
.calibration th:first-child { text-align: left; }
.calibration { margin-bottom: 24px; }
.remarks { max-width: 90ch; padding-left: 1.2em; }
"""
# Label, label in a table's head, digits.
_NAMES = {
    "pitch_mm": ("Lens pitch P, mm", "P, mm", 5),
    "rotation_deg": ("Rotation, °", "rotation, °", 4),
    "shift_x_mm": ("Shift to the right, mm", "shift x, mm", 4),
    "shift_y_mm": ("Shift upwards, mm", "shift y, mm", 4),
    "gap_mm": ("Gap g, mm", "g, mm", 3),
    "tilt_x_deg": ("Tilt across, °", "tilt x, °", 3),
    "tilt_y_deg": ("Tilt along, °", "tilt y, °", 3),
    "focal_length_mm": ("Focal length f, mm", "f, mm", 3),
    "focal_px": ("Camera's focal length, px", "camera f, px", 1),
    "centre_x_px": ("Principal point, across, px", "centre x, px", 1),
    "centre_y_px": ("Principal point, down, px", "centre y, px", 1),
    "k1": ("Distortion k1", "k1", 4),
    "k2": ("Distortion k2", "k2", 4),
}
_LEAD = (
    "Every value with its standard error and the interval that holds the truth in 95 of 100 "
    "calibrations. A parameter whose standard error exceeds the limit in the last column is not "
    "determined: the display file keeps the design's value."
)
_MAPS = (
    "What the photographs show less what the fitted display would: where on the panel a lens's "
    "rays end (mean of a lens), and where in the photograph its outline lies. Fine stripes are "
    "pixels, of the panel and of the camera, that beat with the lenses, and belong there. A slope "
    "or a bow over the whole sheet is something that the model lacks, such as a bent sheet."
)
_NEXT = "One more position would leave these standard errors, the best one first."
# Colours end at this quantile: a few outliers must not hide the rest.
_QUANTILE = 0.98

Maps = Sequence[tuple[str, np.ndarray, np.ndarray]]


def write_calibration(data: Mapping[str, Any], maps: Maps, folder: Path) -> None:
    """Write all forms into a folder, `calibration.json` last: it marks a whole report.

    Parameters
    ----------
    data : mapping
        Schema `inim.calibration/1`; `files` is added here.
    maps : sequence of (str, (rows, columns, 2) array, (rows, columns, 2) array)
        Of each position, by lens: residuals on the panel, µm, and in the photograph, pixels.
    folder : Path
    """
    save(_draw(maps), folder, "residuals")
    forms = {"calibration.html": lambda data: _page(data, folder)}
    write_forms(list_files(data, folder, FILES[0], *forms), folder, FILES[0], forms)


def _draw(maps: Maps) -> Any:
    """A row of four maps for each position."""
    from matplotlib.ticker import MaxNLocator

    rows, columns = maps[0][1].shape[:2]
    height = len(maps) * (0.75 + 3.4 * rows / columns)
    figure, axes = new_figure(4, height, len(maps))
    kinds = (
        ("panel, across", "µm"),
        ("panel, up", "µm"),
        ("outline, across", "px"),
        ("outline, down", "px"),
    )
    found = [
        np.stack([np.concatenate([panel, outline], axis=-1) for _, panel, outline in maps])[..., k]
        for k in range(4)
    ]
    limits = [max(float(np.nanquantile(np.abs(one), _QUANTILE)), 1e-9) for one in found]
    for n, (name, *_) in enumerate(maps):
        for k, (what, unit) in enumerate(kinds):
            axis = axes[4 * n + k]
            shown = axis.imshow(
                found[k][n], cmap="RdBu_r", vmin=-limits[k], vmax=limits[k], interpolation="nearest"
            )
            style(axis, f"{name}: {what}", "", "")
            axis.grid(False)
            for side in (axis.xaxis, axis.yaxis):
                side.set_major_locator(MaxNLocator(integer=True))
            bar = figure.colorbar(shown, ax=axis, shrink=0.8)
            bar.ax.set_title(unit, fontsize=8)
            bar.ax.tick_params(labelsize=8)
    return figure


def _page(data: Mapping[str, Any], folder: Path) -> str:
    title = data.get("title", "Calibration")
    return render_page(
        title,
        [
            "Calibrated from photographs",
            text(_count(len(items(data, "positions")), "position")),
            timestamp(data),
        ],
        [
            Section("warnings", "Warnings", bullets(items(data, "warnings"), "cautions")),
            Section("parameters", "Parameters", _parameters(data)),
            Section("next", "What to photograph next", _next(data)),
            Section("residuals", "Residuals", _residuals(folder)),
            Section("positions", "Camera and its positions", _positions(data)),
            Section("correlation", "Correlations", _correlation(data)),
            how_to_reproduce(data),
        ],
        window_title=f"{title} – inim",
        footer=data_note(data, FILES[0]),
        style=_STYLE,
    )


def _count(count: int, noun: str) -> str:
    return f"{count} {noun}{'s' * (count != 1)}"


def _parameters(data: Mapping[str, Any]) -> str:
    rows = []
    for name, (label, _, digits) in _NAMES.items():
        one = part(data, "parameters", name)
        if not one:
            continue
        value = number(one.get("value"), digits)
        rows.append(
            [
                label,
                value if one.get("is_determined") else f"not determined ({value})",
                f"± {number(one.get('standard_error'), digits + 1)}",
                f"{number(one.get('low'), digits)} to {number(one.get('high'), digits)}",
                number(one.get("nominal"), digits),
                number(one.get("largest_standard_error"), digits),
            ]
        )
    heads = ["Parameter", "Found", "Standard error", "95 % interval", "Design", "Limit"]
    return element("p", text(_LEAD), class_="lead") + text_table(
        "The display's parameters", heads, rows, "calibration"
    )


def _next(data: Mapping[str, Any]) -> str:
    advised = items(data, "next")
    if not advised:
        return ""
    names = list(part(advised[0], "standard_errors"))
    now = [part(data, "parameters", name).get("standard_error") for name in names]
    rows = [["as it is", *(number(v, _digits(k)) for k, v in zip(names, now, strict=True))]]
    rows += [
        [
            f"from {one.get('where')}",
            *(number(v, _digits(k)) for k, v in part(one, "standard_errors").items()),
        ]
        for one in advised
    ]
    heads = ["Position", *(_NAMES[name][1] for name in names)]
    return element("p", text(_NEXT), class_="lead") + text_table(
        "Standard errors with one more position", heads, rows, "calibration"
    )


def _digits(name: str) -> int:
    return _NAMES[name][2] + 1


def _residuals(folder: Path) -> str:
    words = "Maps of the residuals over the lens array, a row for each position"
    return element("p", text(_MAPS), class_="lead") + saved_plot(folder / "residuals.svg", words)


def _positions(data: Mapping[str, Any]) -> str:
    rows = []
    for one in items(data, "positions"):
        eye, errors = items(one, "eye_mm"), items(one, "eye_standard_error_mm")
        rows.append(
            [
                str(one.get("name")),
                *(f"{number(v, 1)} ± {number(e, 1)}" for v, e in zip(eye, errors, strict=True)),
                number(one.get("off_straight_deg"), 1),
                str(one.get("lenses", MISSING)),
                number(one.get("panel_residual_um"), 1),
                number(one.get("outline_residual_px"), 2),
            ]
        )
    heads = [
        "Position", "right, mm", "up, mm", "away, mm", "off straight, °", "lenses",
        "residual, panel µm", "residual, outline px",
    ]  # fmt: skip
    camera = part(data, "camera")
    given = camera.get("is_given")
    own = part(camera, "standard_errors")
    intrinsics = [
        [
            label,
            number(camera.get(name), digits),
            "given" if given else f"± {number(own.get(name), digits + 1)}",
        ]
        for name, (label, _, digits) in _NAMES.items()
        if name in camera
    ]
    return text_table("Where the camera stood", heads, rows, "calibration") + text_table(
        "The camera", ["Intrinsic", "Value", "Standard error"], intrinsics, "calibration"
    )


def _correlation(data: Mapping[str, Any]) -> str:
    names = items(part(data, "correlation"), "names")
    labels = [_NAMES[name][1].partition(",")[0] for name in names]
    rows = [
        [label, *(number(value, 2) for value in row)]
        for label, row in zip(labels, items(part(data, "correlation"), "matrix"), strict=True)
    ]
    return text_table("Correlations of the estimates", ["", *labels], rows, "calibration")
