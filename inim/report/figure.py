"""Figures for papers: views with magnified insets, error maps, scores with intervals, run time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from inim.display.pixels import MM_PER_INCH
from inim.image.color import srgb_from_linear
from inim.image.files.image import read_exr, write_exr_parts
from inim.report import TRUTH, plots
from inim.report.labels import is_number, number
from inim.report.score_table import REFERENCE, ScoreTable, named_relics
from inim.report.sections.time_against_error import times_of
from inim.scores.metrics import HEADLINE, HEADLINE_WORDS, MAIN, ssim_map
from inim.system.errors import FileError, UsageError, suggest_words
from inim.system.process.atomic_file import write_atomically

if TYPE_CHECKING:
    from inim.report import Report

#: Parts of a figure, in their order.
PARTS = ("views", "errors", "scores", "time")
#: Formats, by the file's name.
FORMATS = (".pdf", ".svg", ".png", ".eps")
_DPI = 300
_PLOT_SHARE = 0.42  # height of a plot, of the figure's width
_CAPTION_SHARE = 0.055
_FONT = 7
_IMAGE_MARGINS = {"left": 0.005, "right": 0.995, "bottom": 0.01, "wspace": 0.03, "hspace": 0.03}
_PLOT_MARGINS = {"left": 0.14, "right": 0.8, "bottom": 0.18, "top": 0.94}
_HEADLINE_LINES = HEADLINE_WORDS.replace(", ", ",\n")


class Inset(NamedTuple):
    """Square region of a view to magnify: centre and side, as shares of the view's width."""

    x: float
    y: float
    side: float


@dataclass(frozen=True)
class FigureRequest:
    """Content of a figure.

    * `viewpoint`: viewpoint of the views and error maps; by default the centre, or the first.
    * `algorithms`: by default all of the report.
    * `insets`: magnified below each view.
    """

    parts: tuple[str, ...] = PARTS
    viewpoint: str = ""
    algorithms: tuple[str, ...] = ()
    insets: tuple[Inset, ...] = ()
    width_mm: float = 180.0

    def checked(self, report: Report) -> FigureRequest:
        """The request with defaults filled in; raises `UsageError` for a name the report lacks."""
        data = report.data
        names = data.viewpoint_names
        viewpoint = self.viewpoint or data.main_viewpoint or ""
        choices = {"--parts": PARTS, "--viewpoints": names, "--algorithms": [*data.algorithms]}
        requested = {
            "--parts": self.parts,
            "--viewpoints": (viewpoint,),
            "--algorithms": self.algorithms,
        }
        for option, values in requested.items():
            for value in values:
                if value not in choices[option]:
                    words = suggest_words(value, list(choices[option]))
                    raise UsageError(f"{option} {value}: {words}")
        for inset in self.insets:
            half = inset.side / 2
            if not (0 < inset.side <= 1 and half <= inset.x <= 1 - half):
                raise UsageError(
                    f"--inset {inset.x:g},{inset.y:g},{inset.side:g}: leaves the view; give centre "
                    "and side as shares of the view's width, such as 0.5,0.4,0.2"
                )
        if not 20 <= self.width_mm <= 2000:
            raise UsageError(f"--width {self.width_mm:g}: use 20 to 2000 mm")
        algorithms = self.algorithms or tuple(data.algorithms)
        return replace(self, viewpoint=viewpoint, algorithms=algorithms)


def write_figure(reports: Sequence[Report], request: FigureRequest, path: Path) -> None:
    """Draw a figure of one or several reports into a file.

    Raises `UsageError`: an unknown part, name or format. Raises `FileError`: an image of the report
    is missing.
    """
    if path.suffix.lower() not in FORMATS:
        raise UsageError(f"{path}: use a name that ends in {', '.join(FORMATS)}")
    figure = draw_figure(reports, request)
    metadata = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}.get(path.suffix.lower())

    def save(unfinished: Path) -> None:
        with plots.reproducible():
            form = path.suffix[1:].lower()
            figure.savefig(unfinished, format=form, dpi=_DPI, metadata=metadata)

    write_atomically(path, save)


def draw_figure(reports: Sequence[Report], request: FigureRequest) -> Any:
    """Draw a figure of reports: a matplotlib Figure; errors as of `write_figure`.

    Each report has its own views, error maps and run times, below its title if there are several.
    One plot has the scores of all.
    """
    width = request.width_mm / MM_PER_INCH
    relics = named_relics(reports)
    requests = {relic: request.checked(report) for relic, report in relics.items()}
    drawers: list[tuple[float, Callable[[Any], None]]] = []
    for part in request.parts:
        if part == "scores":
            drawers.append((_PLOT_SHARE * width, partial(_draw_scores, relics, requests)))
            continue
        for relic, report in relics.items():
            size, draw = _part_of(part, report, requests[relic], width)
            if len(relics) > 1:
                size, draw = size + _CAPTION_SHARE * width, partial(_draw_below, relic, size, draw)
            drawers.append((size, draw))
    sizes = [size for size, _ in drawers]
    # Fixed margins: the solver of automatic layouts differs in the last bits from run to run.
    figure = plots.blank_figure((width, sum(sizes)))
    parts = figure.subfigures(len(sizes), 1, height_ratios=sizes, squeeze=False).ravel()
    for (_, draw), part in zip(drawers, parts, strict=True):
        draw(part)
    return figure


def _part_of(
    part: str, report: Report, request: FigureRequest, width: float
) -> tuple[float, Callable[[Any], None]]:
    """Height in inches and drawer of a report's part of a figure."""
    if part == "time":
        return _PLOT_SHARE * width, partial(_draw_time, report, request)
    images = _read_views(report, request.viewpoint, request.algorithms)
    rows, columns = next(iter(images.values())).shape[:2]
    height = width / len(images) * rows / columns + _CAPTION_SHARE * width
    if part == "errors":
        return height, partial(_draw_errors, images)
    inset = width / len(images) / len(request.insets) if request.insets else 0.0
    return height + inset, partial(_draw_views, report, request, images)


def _draw_below(title: str, size: float, draw: Callable[[Any], None], part: Any) -> None:
    """Draw a part of `size` inches below a title."""
    title_size = part.bbox.height / part.figure.dpi - size
    top, body = part.subfigures(2, 1, height_ratios=(title_size, size))
    top.text(0.005, 0.3, title, fontsize=_FONT + 1, fontweight="bold", color=plots.INK)
    draw(body)


def write_error_maps(report: Report, request: FigureRequest, folder: Path) -> list[Path]:
    """Write 1 − SSIM of each view, to the reference view, as ``ALGORITHM/VIEWPOINT.exr``.

    The reference view itself is compared with the ground truth. The only channel is Y.
    """
    request = request.checked(report)
    paths = []
    for viewpoint in report.data.viewpoint_names:
        images = _read_views(report, viewpoint, request.algorithms)
        for name, image in images.items():
            if name == TRUTH:
                continue
            error = _error_map(images, name, image)
            path = folder / name / f"{viewpoint}.exr"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_exr_parts(path, [({"Y": error}, "error")], {})
            paths.append(path)
    return paths


def _read_views(report: Report, viewpoint: str, algorithms: Sequence[str]) -> dict[str, np.ndarray]:
    """Linear views by name: ground truth, reference, then the algorithms."""
    file = f"{viewpoint}.exr"
    folders = {TRUTH: Path("truth"), REFERENCE: Path("views", "reference")}
    folders |= {name: Path("views", name) for name in algorithms}
    images = {name: read_exr(report.folder / path / file) for name, path in folders.items()}
    shapes = {image.shape for image in images.values()}
    if len(shapes) > 1:
        raise FileError(f"{report.folder}: its views differ in size; validate the scene again")
    return images


def _error_map(images: dict[str, np.ndarray], name: str, image: np.ndarray) -> np.ndarray:
    return 1 - ssim_map(images[TRUTH if name == REFERENCE else REFERENCE], image)


def _caption(report: Report, request: FigureRequest, name: str) -> str:
    """Name of a view with its headline score, of algorithms."""
    if name not in report.data.algorithms:
        return {TRUTH: "ground truth", REFERENCE: "reference"}[name]
    value = report.data.algorithms[name].views[request.viewpoint].get(HEADLINE)
    return f"{name}\n{number(value, 3)}" if is_number(value) else name


def _draw_views(
    report: Report, request: FigureRequest, images: dict[str, np.ndarray], part: Any
) -> None:
    rows, columns = images[TRUTH].shape[:2]
    ratios = [rows / columns, *([1 / len(request.insets)] if request.insets else [])]
    caption = _CAPTION_SHARE * len(images)  # in widths of a view, as the ratios
    margins = _IMAGE_MARGINS | {"top": 1 - caption / (caption + sum(ratios))}
    axes = part.subplots(
        len(ratios), len(images), squeeze=False, height_ratios=ratios, gridspec_kw=margins
    )
    for column, (name, image) in enumerate(images.items()):
        pixels = np.clip(srgb_from_linear(np.clip(image, 0, 1)), 0, 1)
        _show(axes[0, column], pixels, _caption(report, request, name))
        if not request.insets:
            continue
        crops = []
        for inset in request.insets:
            left, top, side = _square(inset, image.shape)
            crops.append(pixels[top : top + side, left : left + side])
            _frame(axes[0, column], left, top, side)
        _show(axes[1, column], _side_by_side(crops), "")


def _square(inset: Inset, shape: tuple[int, ...]) -> tuple[int, int, int]:
    """Left, top and side of an inset in pixels, inside the view."""
    rows, columns = shape[:2]
    side = max(4, min(round(inset.side * columns), rows, columns))
    left = min(max(round(inset.x * columns - side / 2), 0), columns - side)
    top = min(max(round(inset.y * columns - side / 2), 0), rows - side)
    return left, top, side


def _side_by_side(crops: Sequence[np.ndarray]) -> np.ndarray:
    """Crops of one height, next to one another, each pixel repeated a whole number of times."""
    largest = max(len(crop) for crop in crops)
    scaled = []
    for crop in crops:
        rows = np.arange(largest) * len(crop) // largest
        scaled.append(crop[rows][:, rows])
    return np.concatenate(scaled, axis=1)


def _frame(axis: Any, left: int, top: int, side: int) -> None:
    from matplotlib.patches import Rectangle

    place = (left - 0.5, top - 0.5)
    axis.add_patch(
        Rectangle(place, side, side, fill=False, edgecolor=plots.VERMILION, linewidth=0.7)
    )


def _show(axis: Any, pixels: np.ndarray, title: str, **options: Any) -> Any:
    image = axis.imshow(pixels, interpolation="nearest", **options)
    axis.set_title(title, fontsize=_FONT, color=plots.INK)
    axis.set_axis_off()
    return image


def _draw_errors(images: dict[str, np.ndarray], part: Any) -> None:
    names = [name for name in images if name != TRUTH]
    margins = _IMAGE_MARGINS | {"right": 0.94}
    axes = part.subplots(1, len(images), squeeze=False, gridspec_kw=margins)[0]
    axes[0].set_axis_off()
    axes[0].text(
        0.5, 0.5, f"1 − {MAIN.label}\nreference: to the\nground truth;\nothers: to the\nreference",
        ha="center", va="center", fontsize=_FONT, color=plots.SOFT, transform=axes[0].transAxes,
    )  # fmt: skip
    last = None
    for axis, name in zip(axes[1:], names, strict=True):
        error = _error_map(images, name, images[name])
        last = _show(axis, error, "", cmap="magma", vmin=0, vmax=1)
    bar = part.colorbar(last, cax=part.add_axes((0.95, 0.1, 0.012, 0.8)))
    bar.ax.tick_params(labelsize=_FONT - 1)


def _draw_scores(
    relics: Mapping[str, Report], requests: Mapping[str, FigureRequest], part: Any
) -> None:
    """Plot the scores of all viewpoints of a report, or of the views shown of several relics."""
    table, is_single = ScoreTable.of([*relics.values()], [HEADLINE]), len(relics) == 1
    key = "viewpoint" if is_single else "relic"
    groups = next(iter(relics.values())).data.viewpoint_names if is_single else [*relics]
    shown_rows = [
        row
        for row in table.rows
        if is_number(row[HEADLINE])
        and (is_single or row["viewpoint"] == requests[row["relic"]].viewpoint)
    ]
    names = list(dict.fromkeys(name for r in requests.values() for name in r.algorithms))
    axis = part.subplots(gridspec_kw=_PLOT_MARGINS)
    for n, name in enumerate(names):
        rows = [row for row in shown_rows if row["algorithm"] == name]
        if not rows:
            continue
        places = [groups.index(row[key]) for row in rows]
        offset = (n - (len(names) - 1) / 2) * 0.6 / len(names)
        values = np.array([row[HEADLINE] for row in rows])
        ends = [[row[f"{HEADLINE}_{end}"] for row in rows] for end in ("low", "high")]
        low, high = (np.array([math.nan if end is None else end for end in side]) for side in ends)
        axis.errorbar(
            np.array(places) + offset, values, [values - low, high - values],
            fmt=plots.marker_of(name), color=plots.colour_of(name), markersize=4, capsize=2,
            linewidth=0.8, label=name.replace("$", r"\$"),
        )  # fmt: skip
    plots.style(axis, "", f"{key}, with 95 % intervals", _HEADLINE_LINES)
    axis.set_xticks(range(len(groups)), groups)
    axis.legend(fontsize=_FONT, frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))


def _draw_time(report: Report, request: FigureRequest, part: Any) -> None:
    times, unit = times_of(report.data)
    axis = part.subplots(gridspec_kw=_PLOT_MARGINS)
    errors = {
        name: 1 - score
        for name in request.algorithms
        if (score := report.data.mean(name, HEADLINE)) is not None
    }
    labels = plots.draw_time_against_error(
        axis,
        [
            plots.TimedPoint(name, times[name], error, error)
            for name, error in errors.items()
            if name in times
        ],
    )
    plots.style(axis, "", f"{unit} (↙ better)", f"1 − {_HEADLINE_LINES}")
    axis.set_xscale("log")
    axis.margins(0.25, 0.2)
    plots.plain_ticks(axis)
    axis.figure.canvas.draw()
    plots.set_apart(axis, labels)
