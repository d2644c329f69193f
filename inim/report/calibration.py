"""The report of a calibration: `calibration.json`, `calibration.html` and its maps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace

from inim.documents.calibration import CalibrationDocument
from inim.documents.files import folder_files, write_forms
from inim.report.markup import bullets, element, saved_plot, text, text_table
from inim.report.page import Section, data_note, how_to_reproduce, render_page, timestamp
from inim.report.plots import new_figure, save, style
from inim.report.wording import number

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


def write_calibration(data: CalibrationDocument, maps: Maps, folder: Path) -> None:
    """Write all forms into a folder, `calibration.json` last: it marks a whole report.

    Parameters
    ----------
    data : CalibrationDocument
        `files` is set here.
    maps : sequence of (str, (rows, columns, 2) array, (rows, columns, 2) array)
        Of each position, by lens: residuals on the panel, µm, and in the photograph, pixels.
    folder : Path
    """
    save(_draw(maps), folder, "residuals")
    data = replace(data, files=folder_files(folder, *FILES))
    write_forms(data, folder, FILES[0], {FILES[1]: lambda data: _page(data, folder)})


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


def _page(data: CalibrationDocument, folder: Path) -> str:
    return render_page(
        data.title,
        [
            "Calibrated from photographs",
            text(_count(len(data.positions), "position")),
            timestamp(data),
        ],
        [
            Section("warnings", "Warnings", bullets(data.warnings, "cautions")),
            Section("parameters", "Parameters", _parameters(data)),
            Section("next", "What to photograph next", _next(data)),
            Section("residuals", "Residuals", _residuals(folder)),
            Section("positions", "Camera and its positions", _positions(data)),
            Section("correlation", "Correlations", _correlation(data)),
            how_to_reproduce(data),
        ],
        window_title=f"{data.title} – inim",
        footer=data_note(data, FILES[0]),
        style=_STYLE,
    )


def _count(count: int, noun: str) -> str:
    return f"{count} {noun}{'s' * (count != 1)}"


def _parameters(data: CalibrationDocument) -> str:
    rows = []
    for name, estimate in data.parameters.items():
        label, _, digits = _NAMES[name]
        value = number(estimate.value, digits)
        rows.append(
            [
                label,
                value if estimate.is_determined else f"not determined ({value})",
                f"± {number(estimate.standard_error, digits + 1)}",
                f"{number(estimate.low, digits)} to {number(estimate.high, digits)}",
                number(estimate.nominal, digits),
                number(estimate.largest_standard_error, digits),
            ]
        )
    heads = ["Parameter", "Found", "Standard error", "95 % interval", "Design", "Limit"]
    return element("p", text(_LEAD), class_="lead") + text_table(
        "The display's parameters", heads, rows, "calibration"
    )


def _next(data: CalibrationDocument) -> str:
    if not data.next:
        return ""
    names = list(data.next[0].standard_errors)
    now = {name: data.parameters[name].standard_error for name in names}
    advised = {"as it is": now}
    advised |= {f"from {position.where}": position.standard_errors for position in data.next}
    rows = [
        [where, *(number(errors[name], _digits(name)) for name in names)]
        for where, errors in advised.items()
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


def _positions(data: CalibrationDocument) -> str:
    rows = [
        [
            position.name,
            *(
                f"{number(value, 1)} ± {number(error, 1)}"
                for value, error in zip(
                    position.eye_mm, position.eye_standard_error_mm, strict=True
                )
            ),
            number(position.off_straight_deg, 1),
            str(position.lenses),
            number(position.panel_residual_um, 1),
            number(position.outline_residual_px, 2),
        ]
        for position in data.positions
    ]
    heads = [
        "Position", "right, mm", "up, mm", "away, mm", "off straight, °", "lenses",
        "residual, panel µm", "residual, outline px",
    ]  # fmt: skip
    intrinsics = [
        [
            _NAMES[name][0],
            number(getattr(data.camera, name), _NAMES[name][2]),
            "given" if error is None else f"± {number(error, _digits(name))}",
        ]
        for name, error in data.camera.standard_errors.items()
    ]
    return text_table("Where the camera stood", heads, rows, "calibration") + text_table(
        "The camera", ["Intrinsic", "Value", "Standard error"], intrinsics, "calibration"
    )


def _correlation(data: CalibrationDocument) -> str:
    labels = [_NAMES[name][1].partition(",")[0] for name in data.correlation.names]
    rows = [
        [label, *(number(value, 2) for value in row)]
        for label, row in zip(labels, data.correlation.matrix, strict=True)
    ]
    return text_table("Correlations of the estimates", ["", *labels], rows, "calibration")
