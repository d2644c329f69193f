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

    def shown(name: str, pixels: np.ndarray | None) -> str:
        # `wipe` finds a view by what it shows and from where.
        return images.embed(pixels, f"{name} from {view}", data_shows=name, data_viewpoint=view)

    def compared(name: str, pixels: np.ndarray | None, to: str, reference: Any) -> list[str]:
        """A view, its difference to a reference, and SSIM's map of the two."""
        pair = f"of {name} and {to} from {view}"
        return [
            shown(name, pixels),
            images.embed(difference(pixels, reference), f"Difference {pair}"),
            images.embed(similarity(pixels, reference), f"SSIM map {pair}"),
        ]

    floor, own = (part(data, key, "views", view) for key in ("noise_floor", "ceiling"))
    against_truth = compared(_CEILING, ceiling, "ground truth", truth)
    figures = [
        captioned(
            _TRUTH,
            "the scene itself",
            [shown(_TRUTH, truth)],
            [("To itself", metric_scores(floor))],
        ),
        captioned(
            _CEILING,
            "compared with ground truth",
            against_truth,
            [("To scene", metric_scores(own))],
        ),
    ]
    for name in part(data, "algorithms"):
        scores = part(data, "algorithms", name, "views", view)
        facts = [
            ("To ceiling", metric_scores(scores, "ceiling")),
            ("To scene", metric_scores(scores)),
            ("On the relic", metric_scores(scores, "relic")),
        ]
        made = compared(name, images.read("views", name, f"{view}.png"), "ceiling", ceiling)
        figures.append(captioned(name, "compared with ceiling", made, facts))
    kind = "views wide" if is_wide(truth) else "views"
    return heading + element("div", *figures, class_=kind, style=f"--count:{len(figures)}")


SECTIONS = (ReportSection(60, "views", "Views", views),)
