"""The reports of a calibration, and of a photograph compared with its simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from inim.documents.display import CalibrationDocument, PhotoDocument
from inim.documents.document import write_listed
from inim.files.image import write_png
from inim.report.images import DIFFERENCE_GAIN, ENCODINGS, ReportImages, difference
from inim.report.labels import number, per_cent
from inim.report.page import (
    Section,
    bullets,
    document_page,
    element,
    figure,
    how_to_reproduce,
    lead,
    saved_plot,
    text,
    text_table,
)
from inim.report.plots import new_figure, save, style

#: Files of every calibration report, its JSON first.
FILES = ("calibration.json", "calibration.html", "residuals.svg", "residuals.png")
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
    "p1": ("Distortion p1", "p1", 5),
    "p2": ("Distortion p2", "p2", 5),
    "refractive_index": ("Refractive index, added", "n", 4),
    "thickness": ("Lens thickness, share added", "t", 4),
    "glass_mm": ("Glass over the panel, mm", "glass, mm", 3),
    "bow_x_mm": ("Bow at the left and right edge, mm", "bow x, mm", 4),
    "bow_y_mm": ("Bow at the upper and lower edge, mm", "bow y, mm", 4),
    "bow_xy_mm": ("Bow at the corners, mm", "bow xy, mm", 4),
}
_LEAD = (
    "The interval contains the true value in 95 of 100 calibrations. A parameter is not determined "
    "if its standard error exceeds the limit in the last column. The display file then keeps the "
    "nominal value."
)
_MAPS = (
    "Differences between the photographs and the fitted display: the panel point that a lens's "
    "rays reach (mean over the lens), and the position of its outline in the photograph; of a "
    "lenticular display, the panel point and the view that each sample of a photograph sees. Fine "
    "stripes are normal, because the pixels of panel and camera beat with the lenses. A slope or "
    "a bow over the whole sheet is an effect that the model does not include, such as a bent "
    "sheet."
)
_SHEET = (
    "Deviations from the design that the fit takes into account. They widen the intervals and are "
    "not part of the display file. The pull is the deviation in expected standard deviations."
)
_NEXT = "Standard errors after one more position; the most useful position is first."
# Colours end at this quantile: a few outliers must not hide the rest.
_QUANTILE = 0.98


class ResidualMaps(NamedTuple):
    """Residuals over the display, by position."""

    labels: Sequence[tuple[str, str]]  #: Title and unit of each map of a position.
    #: (rows, columns, maps) float each, by name of the position; NaN without data.
    maps: Mapping[str, np.ndarray]


def write_calibration(data: CalibrationDocument, maps: ResidualMaps, folder: Path) -> None:
    """Write all forms into a folder, `calibration.json` last: it marks a whole report.

    * `data`: its `files` are listed here.
    """
    save(_draw(maps), folder, "residuals")
    write_listed(data, folder, FILES[0], {FILES[1]: lambda data: _page(data, folder)})


def _draw(residuals: ResidualMaps) -> Any:
    """A row of maps for each position."""
    from matplotlib.ticker import MaxNLocator

    labels, maps = residuals
    count, (rows, columns) = len(labels), next(iter(maps.values())).shape[:2]
    height = len(maps) * (0.75 + 3.4 * rows / columns)
    figure, axes = new_figure(count, height, len(maps))
    largest = np.nanquantile(np.abs(np.stack([*maps.values()])), _QUANTILE, axis=(0, 1, 2))
    for n, (name, values) in enumerate(maps.items()):
        for k, (title, unit) in enumerate(labels):
            axis, limit = axes[count * n + k], max(float(largest[k]), 1e-9)
            bar = _draw_map(axis, values[..., k], limit, f"{name}: {title}", unit)
            for side in (axis.xaxis, axis.yaxis):
                side.set_major_locator(MaxNLocator(integer=True))
            bar.ax.tick_params(labelsize=8)
    return figure


def _draw_map(axis: Any, values: np.ndarray, limit: float, title: str, unit: str) -> Any:
    """Draw signed values, white at zero, and return their colour bar."""
    image = axis.imshow(values, cmap="RdBu_r", vmin=-limit, vmax=limit, interpolation="nearest")
    style(axis, title, "", "")
    axis.grid(False)
    bar = axis.figure.colorbar(image, ax=axis, shrink=0.8)
    bar.ax.set_title(unit, fontsize=8)
    return bar


def _page(data: CalibrationDocument, folder: Path) -> str:
    count = len(data.positions)
    return document_page(
        data,
        FILES[0],
        ["Calibrated from photographs", f"{count} position{'s' * (count != 1)}"],
        [
            Section("warnings", "Warnings", bullets(data.warnings, "cautions")),
            Section("parameters", "Parameters", _parameters(data)),
            Section("next", "What to photograph next", _next(data)),
            Section("residuals", "Residuals", _residuals(folder)),
            Section("positions", "Camera and its positions", _positions(data)),
            Section("sheet", "Deviations of the sheet", _sheet(data)),
            Section("correlation", "Correlations", _correlation(data)),
            how_to_reproduce(data),
        ],
    )


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
    return lead(_LEAD) + text_table("The display's parameters", heads, rows, "numbers")


def _next(data: CalibrationDocument) -> str:
    if not data.next:
        return ""
    names = list(data.next[0].standard_errors)
    now = {name: data.parameters[name].standard_error for name in names}
    advised = {"as it is": now}
    advised |= {f"from {position.description}": position.standard_errors for position in data.next}
    rows = [
        [position, *(number(errors[name], _NAMES[name][2] + 1) for name in names)]
        for position, errors in advised.items()
    ]
    heads = ["Position", *(_NAMES[name][1] for name in names)]
    return lead(_NEXT) + text_table(
        "Standard errors with one more position", heads, rows, "numbers"
    )


def _residuals(folder: Path) -> str:
    words = "Maps of the residuals over the lens array, a row for each position"
    return lead(_MAPS) + saved_plot(folder / "residuals.svg", words)


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
            number(position.second_residual, 2),
            number(position.smooth_residual_um, 2),
            number(position.smooth_second, 3),
            number(position.change_without, 1),
            number(position.motion_px, 2),
            number(position.blur_px, 2),
            f"{number(100 * position.zoom, 2)} %",
        ]
        for position in data.positions
    ]
    second = data.positions[0].second_kind
    heads = [
        "Position", "right, mm", "up, mm", "away, mm", "off straight, °", "lenses",
        "residual, panel µm", f"residual, {second}", "smooth, µm", f"smooth, {second}",
        "change without, standard errors", "motion, px", "blur, px", "zoom",
    ]  # fmt: skip
    intrinsics = [
        [
            _NAMES[name][0],
            number(getattr(data.camera, name), _NAMES[name][2]),
            "given" if error is None else f"± {number(error, _NAMES[name][2] + 1)}",
        ]
        for name, error in data.camera.standard_errors.items()
    ]
    return text_table("Positions of the camera", heads, rows, "numbers") + text_table(
        "The camera", ["Intrinsic", "Value", "Standard error"], intrinsics, "numbers"
    )


def _sheet(data: CalibrationDocument) -> str:
    rows = [
        [
            _NAMES[name][0],
            number(deviation.value, _NAMES[name][2]),
            f"± {number(deviation.standard_error, _NAMES[name][2])}",
            number(deviation.pull, 1),
        ]
        for name, deviation in data.sheet.items()
    ]
    heads = ["Deviation", "Value", "Standard error", "Pull"]
    return lead(_SHEET) + text_table("Deviations from the design", heads, rows, "numbers")


def _correlation(data: CalibrationDocument) -> str:
    labels = [_NAMES[name][1].partition(",")[0] for name in data.correlation.names]
    rows = [
        [label, *(number(value, 2) for value in row)]
        for label, row in zip(labels, data.correlation.matrix, strict=True)
    ]
    return text_table("Correlations of the estimates", ["", *labels], rows, "numbers")


_PICTURES = ("photograph", "simulation", "matched")
#: Files of every report of a photograph, its JSON first.
PHOTO_FILES = (
    "photo.json",
    "photo.html",
    *(f"{name}.png" for name in _PICTURES),
    "flow.svg",
    "flow.png",
)
_STAGES = (
    "Scores of the simulation against the photograph. Each row corrects one more cause of their "
    "difference: the exposure, the remaining shift, the blur, and the response of panel and "
    "camera. The squared error in the last row has other causes."
)
_FLOW = (
    "Shift of the photograph against the simulation, by blocks, to the right and down, in pixels "
    "of the photograph. One colour everywhere means that the camera moved. A pattern means that "
    "the display differs from its description."
)


def write_photo(
    data: PhotoDocument, pictures: Mapping[str, np.ndarray], flow: np.ndarray, folder: Path
) -> None:
    """Write all forms into a folder, `photo.json` last: it marks a whole report.

    * `data`: its `files` are listed here.
    * `pictures`, mapping of str to (H, W, 3) array, linear: the photograph, its simulation, and
      that matched in all three respects.
    * `flow`, (rows, columns, 2) array: see `inim.calibration.photo.Difference`.
    """
    for name in _PICTURES:
        write_png(folder / f"{name}.png", pictures[name])
    save(_draw_flow(flow), folder, "flow")
    forms = {PHOTO_FILES[1]: lambda data: _photo_page(data, folder)}
    write_listed(data, folder, PHOTO_FILES[0], forms)


def _draw_flow(flow: np.ndarray) -> Any:
    figure, axes = new_figure(2, 0.75 + 3.6 * flow.shape[0] / max(flow.shape[1], 1), 1)
    largest = max(float(np.nanmax(np.abs(flow), initial=0.0)), 1e-3)
    for k, direction in enumerate(("to the right", "down")):
        _draw_map(axes[k], flow[..., k], largest, direction, "px")
    return figure


def _photo_page(data: PhotoDocument, folder: Path) -> str:
    return document_page(
        data,
        PHOTO_FILES[0],
        ["Photograph against simulation", text(data.photograph)],
        [
            Section("causes", "What differs", _causes(data)),
            Section("pictures", "Pictures", _pictures(folder)),
            Section("scores", "Scores", _scores(data)),
            Section("flow", "Remaining shift", _flow(folder)),
            how_to_reproduce(data),
        ],
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
    words = "Corrections of the simulation"
    return text_table(words, ["Cause", "Found"], rows, "numbers")


def _pictures(folder: Path) -> str:
    images = ReportImages(folder, ENCODINGS[1])
    photo, plain, matched = (images.read(f"{name}.png") for name in _PICTURES)
    pictures = (
        (photo, "Photograph", "compared part"),
        (plain, "Simulation", "exposed alike"),
        (matched, "Simulation, matched", "with shift, blur and tone"),
        (difference(photo, matched), "Difference", f"of the two, times {DIFFERENCE_GAIN}"),
    )
    figures = (figure(images.embed(p, name), name, remark) for p, name, remark in pictures)
    return element("div", *figures, class_="columns")


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
    heads = ["Simulation", "SSIM", "PSNR, dB", "FLIP", "remaining squared error"]
    table = text_table("Against the photograph", heads, rows, "numbers")
    return lead(_STAGES) + table


def _flow(folder: Path) -> str:
    words = "Maps of the remaining shift, to the right and down"
    return lead(_FLOW) + saved_plot(folder / "flow.svg", words)
