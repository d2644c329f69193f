"""Figure of the accuracy study: error against parameter in float32 and float64, SVG and PNG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.generators.accuracy_limits import LANDING_PIXELS
from inim.report.plots import LINES, across, style
from inim.system.process.atomic_file import write_atomically
from reports.stress.study.document import StudyDocument

_PNG_DPI = 130
# Okabe and Ito's colours, as in the other reports.
_COLOURS = {
    "pinhole": "#009e73", "thin": "#0072b2", "thick": "#d55e00", "template": "#0072b2",
    "gu2020": "#009e73", "wang2024": "#d55e00", "li2012": "#cc79a7",
}  # fmt: skip
_PRECISIONS = {"float32": "single precision", "float64": "double precision"}
_DEFAULT = ", default"
# Marker, line style, and True for a filled marker.
_STYLES = {"float32": ("o", "-", True), "float64": ("s", "--", False)}
_TABLES = ("D", ":", False)
# Position of zero on the logarithmic axis of shares.
_NO_ERROR = 1e-4
_LENS_PANELS = (
    ("incidence", "Lens models, oblique rays", "sideways travel of a ray per mm"),
    ("array width", "Lens models, wide arrays", "lenses across the array"),
    ("eye distance", "Lens models, near and far eyes", "distance of the eye from the array, mm"),
)
_GENERATOR_PANELS = (
    (
        "distance in front",
        "Generators, surfaces far from the array",
        "distance of the nearest surface from the array, mm",
        "log",
    ),
    (
        "depth span",
        "Generators, flat pictures",
        "log2 of distance / depth range",
        "linear",
    ),
    (
        "g to f from above, default range",
        "Generators, gap close to the focal length",
        "log2 of focal length / (gap - focal length)",
        "linear",
    ),
)


def draw_plots(data: StudyDocument, folder: Path) -> list[str]:
    """Write the figure and return the names of the files."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.2, 8.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3)
    for axis, (family, title, label) in zip(axes[0], _LENS_PANELS, strict=True):
        _lens_panel(axis, data.lens_models, family, title, label)
    for axis, (family, title, label, scale) in zip(axes[1], _GENERATOR_PANELS, strict=True):
        _generator_panel(axis, data.generators, family, title, label, scale)
    axes[0, 0].set_ylabel("largest error of a landing point, panel pixels", fontsize=9)
    axes[1, 0].set_ylabel("share of panel pixels with another source", fontsize=9)
    for axis in (axes[0, 2], axes[1, 0]):
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=7, frameon=False, loc="best", ncols=1)
    # No date, no random ids: equal data give equal files. Text is not converted to paths.
    with rc_context({"svg.hashsalt": "inim", "svg.fonttype": "none"}):
        write_atomically(
            folder / "stress.svg", lambda p: figure.savefig(p, metadata={"Date": None})
        )
    write_atomically(folder / "stress.png", lambda p: figure.savefig(p, dpi=_PNG_DPI))
    return ["stress.svg", "stress.png"]


def _lens_panel(
    axis: Any, rows: Sequence[Mapping[str, Any]], family: str, title: str, label: str
) -> None:
    for model in ("pinhole", "thin", "thick"):
        for dtype in ("float32", "float64"):
            # An error of exactly 0 means that no light passes or that rounding decides the lens.
            points = [r for r in rows if _is_plotted(r, family, dtype) and r["model"] == model]
            points = [r for r in points if r["worst_pixels"] > 0]
            label_text = f"{model} lenses, {_PRECISIONS[dtype]}"
            _line(axis, points, "worst_pixels", label_text, _COLOURS[model], _STYLES[dtype])
    limit = f"{LANDING_PIXELS:g} pixels, the accuracy limit"
    axis.axhline(LANDING_PIXELS, label=limit, **LINES["floor"])
    _finish(axis, title, label, "log")


def _generator_panel(
    axis: Any, rows: Sequence[Mapping[str, Any]], family: str, title: str, label: str, scale: str
) -> None:
    for name in ("template", "gu2020", "wang2024", "li2012"):
        for dtype in ("float64", "float32") if name == "template" else ("float64",):
            points = [
                {**r, "share": r["changed"] / r["pixels"]}
                for r in rows
                if _is_plotted(r, family, dtype) and r["algorithm"] == name
            ]
            label_text = f"{name}, {_form_label(name, dtype)}"
            line_style = _TABLES if label_text.endswith(_DEFAULT) else _STYLES[dtype]
            _line(axis, points, "share", label_text, _COLOURS[name], line_style)
    _finish(axis, title, label, scale)
    across(axis, "no pixel", y=_NO_ERROR)


def _form_label(algorithm: str, dtype: str) -> str:
    if algorithm == "template":
        if dtype == "float32":
            return f"tables in {_PRECISIONS[dtype]}{_DEFAULT}"
        return f"rays in {_PRECISIONS[dtype]}"
    return _PRECISIONS[dtype]


def _is_plotted(row: Mapping[str, Any], family: str, dtype: str) -> bool:
    has_value = row["value"] is not None and row["value"] < 1e30
    return bool(
        row["family"] == family and row["outcome"] == "ran" and row["dtype"] == dtype and has_value
    )


def _line(
    axis: Any,
    rows: Sequence[Mapping[str, Any]],
    key: str,
    label: str,
    colour: str,
    line_style: tuple[str, str, bool],
) -> None:
    """Draw the largest error of each value, with a style from `_STYLES` or `_TABLES`."""
    worst: dict[float, float] = {}
    for row in rows:
        worst[row["value"]] = max(worst.get(row["value"], 0.0), row[key])
    points = sorted(p for p in worst.items() if p[0] > 0 or key == "share")
    if not points:
        return
    mark, line, filled = line_style
    axis.plot(
        [x for x, _ in points],
        [max(y, _NO_ERROR) if key == "share" else y for _, y in points],
        mark,
        label=label,
        color=colour,
        linestyle=line,
        linewidth=1.2,
        markersize=3.5,
        markerfacecolor=colour if filled else "white",
    )


def _finish(axis: Any, title: str, label: str, scale: str) -> None:
    style(axis, title, label, "")
    axis.set_xscale(scale)
    axis.set_yscale("log")
