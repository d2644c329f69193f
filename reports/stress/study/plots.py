"""The figure of a stress run: error against parameter, float32 and float64, SVG and PNG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.accuracy_limits import LANDING_PIXELS
from inim.files.image import write_atomically
from inim.report.plots import LINES, style

__all__ = ["draw_plots"]

_PNG_DPI = 130
# Okabe and Ito's colours, as in the other reports.
_COLOURS = {
    "pinhole": "#009e73", "thin": "#0072b2", "thick": "#d55e00", "template": "#0072b2",
    "gu2020": "#009e73", "wang2024": "#d55e00", "li2012": "#cc79a7",
}  # fmt: skip
_MARKS = {"float32": "o", "float64": "s"}
# Zero has a place at the foot of logarithmic axes.
_NO_ERROR = {"lens": 1e-17, "share": 1e-4}
_LENS_PANELS = (
    ("incidence", "Lens models: incidence", "sideways travel per mm"),
    ("array width", "Lens models: array width", "lenses across"),
    ("eye distance", "Lens models: eye distance", "distance of the eye, mm"),
)
_GENERATOR_PANELS = (
    ("distance in front", "Generators: distance", "nearest surface, mm", "log"),
    ("depth span", "Generators: depth span", "−log2 of span / distance", "linear"),
    ("g to f from above, own range", "Generators: g → f", "−log2 |g − f| / f", "linear"),
)


def draw_plots(data: Mapping[str, Any], folder: Path) -> list[str]:
    """Write the figure; the names of the files."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.2, 8.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3)
    for axis, (family, title, label) in zip(axes[0], _LENS_PANELS, strict=True):
        _lens_panel(axis, data["lens_models"], family, title, label)
    for axis, (family, title, label, scale) in zip(axes[1], _GENERATOR_PANELS, strict=True):
        _generator_panel(axis, data["generators"], family, title, label, scale)
    axes[0, 0].set_ylabel("worst error of the landing, panel pixels", fontsize=9)
    axes[1, 0].set_ylabel("panel pixels of another source, share", fontsize=9)
    for axis in (axes[0, 2], axes[1, 0]):
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=7, frameon=False, loc="best", ncols=2)
    # Without a date or random ids, equal data give equal files. Text stays text.
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
            # No error at all: no light gets through, or rounding chooses the lens.
            mine = [r for r in rows if _is(r, family, dtype) and r["model"] == model]
            mine = [r for r in mine if r["worst_pixels"] > 0]
            _line(axis, mine, "worst_pixels", f"{model}, {dtype}", _NO_ERROR["lens"])
    axis.axhline(LANDING_PIXELS, **LINES["floor"])
    _finish(axis, title, label, "log")


def _generator_panel(
    axis: Any, rows: Sequence[Mapping[str, Any]], family: str, title: str, label: str, scale: str
) -> None:
    for name in ("template", "gu2020", "wang2024", "li2012"):
        for algorithm, dtype in _typed(name):
            mine = [
                {**r, "share": r["changed"] / r["pixels"]}
                for r in rows
                if _is(r, family, dtype) and r["algorithm"] == algorithm
            ]
            shown = f"{name}, {_said(algorithm, dtype)}"
            _line(axis, mine, "share", shown, _NO_ERROR["share"])
    _finish(axis, title, label, scale)


def _typed(name: str) -> list[tuple[str, str]]:
    return [(name, "float64"), *([(name, "float32")] if name == "template" else [])]


def _said(algorithm: str, dtype: str) -> str:
    if algorithm == "template":
        return "float32 tables (as run)" if dtype == "float32" else "float64 rays"
    return dtype


def _is(row: Mapping[str, Any], family: str, dtype: str) -> bool:
    known = row["value"] is not None and row["value"] < 1e30
    return bool(
        row["family"] == family and row["outcome"] == "ran" and row["dtype"] == dtype and known
    )


def _line(axis: Any, rows: Sequence[Mapping[str, Any]], key: str, label: str, least: float) -> None:
    """The worst of each value, in order; dashed in float64."""
    worst: dict[float, float] = {}
    for row in rows:
        worst[row["value"]] = max(worst.get(row["value"], 0.0), row[key])
    points = sorted(p for p in worst.items() if p[0] > 0 or key == "share")
    if not points:
        return
    name, _, dressed = label.partition(", ")
    single = dressed.startswith("float32")
    tables = "tables" in dressed
    axis.plot(
        [x for x, _ in points],
        [max(y, least) for _, y in points],
        "D" if tables else _MARKS["float32" if single else "float64"],
        label=label,
        color=_COLOURS[name],
        linestyle=":" if tables else "-" if single else "--",
        linewidth=1.2,
        markersize=3.5,
        markerfacecolor=_COLOURS[name] if single and not tables else "white",
    )


def _finish(axis: Any, title: str, label: str, scale: str) -> None:
    style(axis, title, label, "")
    axis.set_xscale(scale)
    axis.set_yscale("log")
