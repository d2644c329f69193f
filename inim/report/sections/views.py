"""Views section: comparison slider, all views side by side, and parallax.

The controls and the stage of the slider stay hidden until the script has loaded its images from
the views below, which need no script.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from inim.report.document import ReportDocument
from inim.report.images import DIFFERENCE_GAIN, ReportImages, difference, is_wide
from inim.report.labels import NBSP, REFERENCE, TRUTH, metric_scores, named, short
from inim.report.page import (
    Widget,
    captioned,
    element,
    folded,
    lead,
    package_text,
    radio,
    select,
    text,
    void,
)
from inim.report.sections import ReportSection
from inim.scores.document_parts import EyePosition

_INTRO = (
    "Each view is shown with its difference and its SSIM map. The difference is the absolute "
    f"difference of the sRGB values, amplified ×{NBSP}{DIFFERENCE_GAIN}: black is equal. The "
    "reference is compared with the ground truth, which shows the loss of the display. Algorithms "
    "are compared with the reference, which shows their own loss."
)
_SLIDER_ID = "slider"
COMPARISON_SLIDER = Widget(
    package_text("comparison_slider.css"),
    package_text("comparison_slider.js"),
    f'id="{_SLIDER_ID}"',
)
_WAYS = (
    ("slider", "slider", True),
    ("flip", "flip", False),
    ("difference", f"difference ×{NBSP}{DIFFERENCE_GAIN}", False),
)
_HELP = (
    "Drag across the image, or move the slider with the arrow keys, to see more of one or the "
    "other image. Flip alternates between them. Difference shows where they differ."
)
_THUMBNAIL_PX = 320
_PARALLAX = (
    "Above: ground truth. Below: the best algorithm. The frame of each image is the lens array. "
    "The farther a point is from it in depth, the more it moves relative to the centre line. Both "
    "rows should show the same motion."
)


def views(data: ReportDocument, images: ReportImages) -> str:
    """The section on the views, one row of images for each viewpoint."""
    rows = [_viewpoint(data, images, eye) for eye in data.viewpoints]
    intro = lead(named(data, _INTRO)) + _scale(images)
    return _comparison_slider(data, images) + intro + "".join(rows)


def _comparison_slider(data: ReportDocument, images: ReportImages) -> str:
    """Comparison slider of any two images below; initially ground truth and best algorithm.

    The script finds an image by its content and viewpoint. Empty without a viewpoint, or if
    images are missing or omitted.
    """
    viewpoints, start, best = data.viewpoint_names, data.main_viewpoint, data.best_algorithm
    if start is None or not images.encoding.longest_px:
        return ""
    truth = images.read("truth", f"{viewpoints[0]}.png")
    if truth is None:
        return ""
    names = [named(data, TRUTH), REFERENCE, *data.algorithms]
    ways = [radio("compare-by", *way) for way in _WAYS]
    choices = [
        _choice("From", "viewpoint", viewpoints, start),
        _choice("First", "first", names, names[0]),
        _choice("Second", "second", names, best or REFERENCE),
        element("fieldset", element("legend", "Compare by"), element("div", *ways)),
    ]
    rows, columns = truth.shape[:2]
    stage = element(
        "div",
        element("div", class_="pictures"),
        element("i", aria_hidden="true"),
        *(element("b", class_=side, aria_hidden="true") for side in ("first", "second")),
        class_="stage",
        role="img",
        style=f"aspect-ratio:{columns}/{rows};--gain:{DIFFERENCE_GAIN}",
    )
    border = void("input", type="range", name_="border", min=0, max=100, step="any", value=50)
    flips = element("button", "Flip", type="button", name_="flip")
    itself = void("input", type="checkbox", name_="by-itself")
    below = [
        element("label", "Border", border, data_way="slider"),
        element("div", flips, element("label", itself, "automatically"), data_way="flip"),
        element("p", class_="spoken", role="status"),
    ]
    controls = element("div", *choices, class_="controls")
    kind = f"{_SLIDER_ID} wide" if is_wide(truth) else _SLIDER_ID
    return element(
        "div", lead(_HELP), controls, stage, *below, id=_SLIDER_ID, class_=kind, hidden="hidden"
    )


def _choice(label: str, name: str, options: Sequence[str], chosen: str) -> str:
    pairs = [(option, option) for option in options]
    return element("label", text(label), select(pairs, chosen, name_=name))


def _scale(images: ReportImages) -> str:
    """Colour scale of an SSIM map."""
    bar = np.repeat(images.similarity_scale(), 12, axis=0)
    words = [element("span", text(word)) for word in ("1, equal", "SSIM", "0 or below")]
    picture = images.embed(bar, "Colours of the SSIM maps, from black for 1 to pale yellow for 0")
    return element("figure", picture, element("figcaption", *words), class_="ssim-scale")


def _viewpoint(data: ReportDocument, images: ReportImages, eye: EyePosition) -> str:
    view = eye.name
    truth = images.read("truth", f"{view}.png")
    reference = images.read("views", "reference", f"{view}.png")
    place = ", ".join(short(v) for v in eye.position_mm)
    heading = element("h3", text(view), element("small", text(f"eye at ({place}) mm")))

    def shown(name: str, pixels: np.ndarray | None) -> str:
        attributes: dict[str, Any] = {"data_shows": name, "data_viewpoint": view}
        return images.embed(pixels, f"{name} from {view}", is_measured=True, **attributes)

    def compared(name: str, pixels: np.ndarray | None, to: str, reference: Any) -> list[str]:
        """A view, its difference to a reference, and the SSIM map of the two."""
        pair = f"of {name} and {to} from {view}"
        return [
            shown(name, pixels),
            images.embed(difference(pixels, reference), f"Difference {pair}"),
            images.embed(images.similarity(pixels, reference), f"SSIM map {pair}"),
        ]

    floor, own = data.noise_floor, data.reference.views[view]
    name, to_truth = named(data, TRUTH), named(data, "ground truth")
    itself = [] if floor is None else metric_scores(floor.views[view], "relic")
    figures = [
        captioned(
            name,
            "without a display",
            [shown(name, truth)],
            [("On the relic, to itself", itself)] if itself else [],
        ),
        captioned(
            REFERENCE,
            f"compared with {to_truth}",
            compared(REFERENCE, reference, to_truth, truth),
            [
                (f"On the relic, to {to_truth}", metric_scores(own, "relic")),
                (f"Whole image, to {to_truth}", metric_scores(own)),
            ],
        ),
    ]
    for name, result in data.algorithms.items():
        scores = result.views.get(view, {})
        facts = [
            ("On the relic, to reference", metric_scores(scores, "relic to reference")),
            (f"On the relic, to {to_truth}", metric_scores(scores, "relic")),
            ("Whole image, to reference", metric_scores(scores, "reference")),
            (f"Whole image, to {to_truth}", metric_scores(scores)),
        ]
        comparison = compared(
            name, images.read("views", name, f"{view}.png"), "reference", reference
        )
        figures.append(captioned(name, "compared with reference", comparison, facts))
    kind = "views wide" if is_wide(truth) else "views"
    row = element("div", *figures, class_=kind, style=f"--count:{len(figures)}")
    return folded(heading, row)


def parallax(data: ReportDocument, images: ReportImages) -> str:
    """Parallax section; empty with fewer than two viewpoints in a line."""
    best = data.best_algorithm
    sources = [(named(data, TRUTH), ("truth",))] + ([(best, ("views", best))] if best else [])
    strips = [
        _strip(images, direction, [eye.name for eye in line], sources)
        for direction, line in _lines_of_sight(data.viewpoints)
        if len(line) > 1
    ]
    if not strips:
        return ""
    wide = is_wide(images.read("truth", f"{data.viewpoints[0].name}.png")) or len(strips) == 1
    kind = "strips wide" if wide else "strips"
    return lead(named(data, _PARALLAX)) + element("div", *strips, class_=kind)


def _lines_of_sight(eyes: Sequence[EyePosition]) -> list[tuple[str, list[EyePosition]]]:
    """Viewpoints left to right and top to bottom through the one nearest to the axis."""
    if not eyes:
        return []
    x0, y0, _ = min((eye.position_mm for eye in eyes), key=lambda p: math.hypot(*p[:2]))
    row = [eye for eye in eyes if math.isclose(eye.position_mm[1], y0, abs_tol=1e-6)]
    column = [eye for eye in eyes if math.isclose(eye.position_mm[0], x0, abs_tol=1e-6)]
    return [
        ("left to right", sorted(row, key=lambda eye: eye.position_mm[0])),
        ("top to bottom", sorted(column, key=lambda eye: -eye.position_mm[1])),
    ]


def _strip(
    images: ReportImages,
    direction: str,
    views: Sequence[str],
    sources: Sequence[tuple[str, tuple[str, ...]]],
) -> str:
    rows = []
    for label, place in sources:
        shots = [_strip_shot(images, direction, view, label, place) for view in views]
        title = element("h3", text(f"{label}, {direction}"))
        rows.append(title + element("div", *shots, class_="strip"))
    return element("div", *rows)


def _strip_shot(
    images: ReportImages, direction: str, view: str, label: str, place: tuple[str, ...]
) -> str:
    """Small image with a line through its centre, across the direction of movement."""
    pixels = images.read(*place, f"{view}.png")
    picture = images.embed(pixels, f"{label} from {view}", _THUMBNAIL_PX)
    kind = "upright" if direction == "left to right" else "level"
    line = element("i", class_=kind, aria_hidden="true")
    return element(
        "figure", element("div", picture, line, class_="marked"), element("figcaption", text(view))
    )


SECTIONS = (
    ReportSection(50, "parallax", "Parallax", parallax),
    ReportSection(60, "views", "Views", views, COMPARISON_SLIDER),
)
