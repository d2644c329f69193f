"""What is seen from each viewpoint: ground truth, ceiling and every algorithm side by side."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from inim.report.images import (
    DIFFERENCE_GAIN,
    Images,
    difference,
    is_wide,
    similarity,
    similarity_scale,
)
from inim.report.markup import captioned, element, text
from inim.report.sections import ReportSection
from inim.report.wipe import wipe
from inim.report.wording import (
    NBSP,
    best_algorithm,
    items,
    metric_scores,
    part,
    short,
    viewpoint_names,
)

__all__ = ["SECTIONS", "views"]

_TRUTH, _CEILING = "Ground truth", "Ceiling"
_INTRO = (
    "Below each picture are its difference and its SSIM map. Differences are absolute differences "
    f"of the sRGB values, amplified ×{NBSP}{DIFFERENCE_GAIN}: black is equal. The ceiling is "
    "compared with the ground truth, which shows what the display loses; an algorithm is compared "
    "with the ceiling, which shows what the algorithm loses."
)


def views(data: Mapping[str, Any], images: Images) -> str:
    """The section on the views, one row of images for each viewpoint."""
    rows = [_viewpoint(data, images, v) for v in items(data, "viewpoints") if "name" in part(v)]
    intro = element("p", text(_INTRO), class_="lead") + _scale(images)
    return _wipe(data, images) + intro + "".join(rows)


def _wipe(data: Mapping[str, Any], images: Images) -> str:
    """Any two of the images below over each other: ground truth and best algorithm at first."""
    views, best = viewpoint_names(data), best_algorithm(data)
    if not views or not images.encoding.longest_px:
        return ""
    names = [_TRUTH, _CEILING, *part(data, "algorithms")]
    return wipe(views, names, best or _CEILING, images.read("truth", f"{views[0]}.png"))


def _scale(images: Images) -> str:
    """What the colours of an SSIM map stand for."""
    bar = np.repeat(similarity_scale(), 12, axis=0)
    words = [element("span", text(word)) for word in ("1, alike", "SSIM", "0 or below, unlike")]
    picture = images.embed(bar, "Colours of the SSIM maps, from black for 1 to pale yellow for 0")
    return element("figure", picture, element("figcaption", *words), class_="ssim-scale")


def _viewpoint(data: Mapping[str, Any], images: Images, viewpoint: Mapping[str, Any]) -> str:
    view = str(viewpoint["name"])
    truth = images.read("truth", f"{view}.png")
    ceiling = images.read("views", "ceiling", f"{view}.png")
    place = ", ".join(short(v) for v in items(viewpoint, "position_mm"))
    heading = element("h3", text(view), element("small", text(f"eye at ({place}) mm")))
    figures = [
        _truth_figure(data, images, view, truth),
        _ceiling_figure(data, images, view, truth, ceiling),
    ]
    figures += [
        _algorithm_figure(data, images, view, name, ceiling) for name in part(data, "algorithms")
    ]
    kind = "views wide" if is_wide(truth) else "views"
    return heading + element("div", *figures, class_=kind, style=f"--count:{len(figures)}")


def _truth_figure(
    data: Mapping[str, Any], images: Images, view: str, truth: np.ndarray | None
) -> str:
    facts = [("To itself", metric_scores(part(data, "noise_floor", "views", view)))]
    picture = _shown(images, truth, _TRUTH, view)
    return captioned(_TRUTH, "the scene itself", [picture], facts)


def _shown(images: Images, pixels: np.ndarray | None, name: str, view: str) -> str:
    """A view that `wipe` finds by what it shows and from where."""
    alt = f"{name} from {view}"
    return images.embed(pixels, alt, data_shows=name, data_viewpoint=view)


def _compared(
    images: Images,
    pixels: np.ndarray | None,
    reference: np.ndarray | None,
    name: str,
    to: str,
    view: str,
) -> list[str]:
    """A view, its difference to a reference, and SSIM's map of the two."""
    pair = f"of {name} and {to} from {view}"
    return [
        _shown(images, pixels, name, view),
        images.embed(difference(pixels, reference), f"Difference {pair}"),
        images.embed(similarity(pixels, reference), f"SSIM map {pair}"),
    ]


def _ceiling_figure(
    data: Mapping[str, Any],
    images: Images,
    view: str,
    truth: np.ndarray | None,
    ceiling: np.ndarray | None,
) -> str:
    shown = _compared(images, ceiling, truth, _CEILING, "ground truth", view)
    facts = [("To scene", metric_scores(part(data, "ceiling", "views", view)))]
    return captioned(_CEILING, "compared with ground truth", shown, facts)


def _algorithm_figure(
    data: Mapping[str, Any],
    images: Images,
    view: str,
    name: str,
    ceiling: np.ndarray | None,
) -> str:
    scores = part(data, "algorithms", name, "views", view)
    made = images.read("views", name, f"{view}.png")
    shown = _compared(images, made, ceiling, name, "ceiling", view)
    facts = [
        ("To ceiling", metric_scores(scores, "ceiling")),
        ("To scene", metric_scores(scores)),
        ("On the relic", metric_scores(scores, "relic")),
    ]
    return captioned(name, "compared with ceiling", shown, facts)


SECTIONS = (ReportSection(60, "views", "Views", views),)
