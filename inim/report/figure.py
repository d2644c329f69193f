"""Figures for papers: views with magnified insets, error maps, scores with intervals, run time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from inim.display.pixels import MM_PER_INCH
from inim.image.color import srgb_from_linear
from inim.image.files.image import read_exr, write_exr_parts
from inim.report import TRUTH, plots
from inim.report.figure_plots import (
    FONT,
    LETTER,
    LINE,
    Part,
    Styles,
    draw_time,
    legend,
    plot_height,
    scores,
    size_of,
    styles_of,
    wrapped,
)
from inim.report.labels import is_number, number
from inim.report.score_table import REFERENCE, named_relics
from inim.scores.metrics import HEADLINE, MAIN, ssim_map
from inim.system.errors import FileError, UsageError, suggest_words
from inim.system.process.atomic_file import write_atomically

if TYPE_CHECKING:
    from inim.report import Report

#: Parts of a figure, in their order.
PARTS = ("views", "errors", "scores", "time")
#: Formats, by the file's name.
FORMATS = (".pdf", ".svg", ".png", ".eps")
_DPI = 300
_TITLE = 1.6 * LINE
_IMAGE_MARGINS = {"left": 0.005, "right": 0.995, "bottom": 0.01, "wspace": 0.03, "hspace": 0.03}
_PLOTS = ("scores", "time")
_ERROR_WORDS = (
    f"1 − {MAIN.label} of the reference to the ground truth, and of the others to the reference"
)


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
    One plot has the scores of all. Options that all algorithms have are left out of their names.
    """
    width = request.width_mm / MM_PER_INCH
    relics = named_relics(reports)
    requests = {relic: request.checked(report) for relic, report in relics.items()}
    styles = styles_of([name for r in requests.values() for name in r.algorithms])
    drawers: list[Part] = []
    for n, part in enumerate(request.parts):
        if styles and part in _PLOTS and not {*request.parts[:n]} & {*_PLOTS}:
            drawers.append(legend(styles, width))
        if part == "scores":
            viewpoints = {relic: r.viewpoint for relic, r in requests.items()}
            drawers.append(scores(relics, viewpoints, styles, width))
            continue
        for relic, report in relics.items():
            size, draw = _part_of(part, report, requests[relic], styles, width)
            if len(relics) > 1:
                size, draw = size + _TITLE, partial(_draw_below, relic, size, draw)
            drawers.append((size, draw))
    sizes = [size for size, _ in drawers]
    # Fixed margins: the solver of automatic layouts differs in the last bits from run to run.
    figure = plots.blank_figure((width, sum(sizes)))
    parts = figure.subfigures(len(sizes), 1, height_ratios=sizes, squeeze=False).ravel()
    for (_, draw), part in zip(drawers, parts, strict=True):
        draw(part)
    return figure


def _fitting_font(texts: Iterable[str], width: float) -> float:
    """Size of the font with which the longest line has a width in inches, or less."""
    longest = max(len(line) for text in texts for line in text.splitlines())
    return min(FONT, FONT * width / (LETTER * longest))


def _part_of(
    part: str,
    report: Report,
    request: FigureRequest,
    styles: Styles,
    width: float,
) -> Part:
    """Height in inches and drawer of a report's part of a figure."""
    if part == "time":
        return plot_height(width), partial(draw_time, report, request.algorithms, styles)
    images = _read_views(report, request.viewpoint, request.algorithms)
    rows, columns = next(iter(images.values())).shape[:2]
    view = width / len(images)
    height = view * rows / columns
    if part == "errors":
        words = wrapped(_ERROR_WORDS, width)
        heading = (words.count("\n") + 1.5) * LINE
        return height + heading, partial(_draw_errors, images, words, heading)
    captions = {name: _caption(report, request, styles, name, view) for name in images}
    heading = (max(text.count("\n") for text in captions.values()) + 1.5) * LINE
    inset = view / len(request.insets) if request.insets else 0.0
    return height + heading + inset, partial(_draw_views, request, images, captions, heading)


def _draw_below(title: str, size: float, draw: Callable[[Any], None], part: Any) -> None:
    """Draw a part of `size` inches below a title."""
    top, body = part.subfigures(2, 1, height_ratios=(_TITLE, size))
    top.text(0.005, 0.3, title, fontsize=FONT + 1, fontweight="bold", color=plots.INK)
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


def _caption(
    report: Report,
    request: FigureRequest,
    styles: Styles,
    name: str,
    width: float,
) -> str:
    """Name of a view with its headline score, of algorithms."""
    if name not in report.data.algorithms:
        return wrapped({TRUTH: "ground truth", REFERENCE: "reference"}[name], width)
    value = report.data.algorithms[name].views[request.viewpoint].get(HEADLINE)
    label = wrapped(styles[name]["label"], width)
    return f"{label}\n{number(value, 3)}" if is_number(value) else label


def _draw_views(
    request: FigureRequest,
    images: dict[str, np.ndarray],
    captions: Mapping[str, str],
    heading: float,
    part: Any,
) -> None:
    rows, columns = images[TRUTH].shape[:2]
    ratios = [rows / columns, *([1 / len(request.insets)] if request.insets else [])]
    width, height = size_of(part)
    font = _fitting_font(captions.values(), width / len(images))
    margins = _IMAGE_MARGINS | {"top": 1 - heading / height}
    axes = part.subplots(
        len(ratios), len(images), squeeze=False, height_ratios=ratios, gridspec_kw=margins
    )
    for column, (name, image) in enumerate(images.items()):
        pixels = np.clip(srgb_from_linear(np.clip(image, 0, 1)), 0, 1)
        _show(axes[0, column], pixels, captions[name], font)
        if not request.insets:
            continue
        crops = []
        for inset in request.insets:
            left, top, side = _square(inset, image.shape)
            crops.append(pixels[top : top + side, left : left + side])
            _frame(axes[0, column], left, top, side)
        _show(axes[1, column], _side_by_side(crops))


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


def _show(
    axis: Any, pixels: np.ndarray, title: str = "", font: float = FONT, **options: Any
) -> Any:
    image = axis.imshow(pixels, interpolation="nearest", **options)
    axis.set_title(title, fontsize=font, color=plots.INK, pad=3)
    axis.set_axis_off()
    return image


def _draw_errors(images: dict[str, np.ndarray], words: str, heading: float, part: Any) -> None:
    """Draw the error maps below the views, and the colour bar below the ground truth."""
    margins = _IMAGE_MARGINS | {"top": 1 - heading / size_of(part)[1]}
    axes = part.subplots(1, len(images), squeeze=False, gridspec_kw=margins)[0]
    part.text(0.005, 0.99, words, va="top", fontsize=FONT, color=plots.SOFT)
    axes[0].set_axis_off()
    last = None
    for axis, name in zip(axes[1:], [name for name in images if name != TRUTH], strict=True):
        error = _error_map(images, name, images[name])
        last = _show(axis, error, cmap="magma", vmin=0, vmax=1)
    place = axes[0].inset_axes((0.1, 0.5, 0.8, 0.06))
    bar = part.colorbar(last, cax=place, orientation="horizontal", ticks=(0, 0.5, 1))
    bar.ax.tick_params(labelsize=FONT - 1)
