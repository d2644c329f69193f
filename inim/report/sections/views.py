"""What is seen from each viewpoint: ground truth, ceiling and every algorithm side by side."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from inim.report.markup import captioned, decibels, element, text, triple
from inim.report.pictures import DIFFERENCE_GAIN, Pictures, difference, is_wide
from inim.report.wording import NBSP, items, part, score, short

__all__ = ["views"]

_INTRO = (
    f"Differences are absolute differences of the sRGB values, amplified ×{NBSP}{DIFFERENCE_GAIN}: "
    "black is equal. The ceiling is compared with the ground truth, which shows what the display "
    "loses; an algorithm is compared with the ceiling, which shows what the algorithm loses."
)


def views(data: Mapping[str, Any], pictures: Pictures) -> str:
    """The section on the views, one row of pictures for each viewpoint."""
    rows = [_viewpoint(data, pictures, v) for v in items(data, "viewpoints") if "name" in part(v)]
    return element("p", text(_INTRO), class_="lead") + "".join(rows)


def _viewpoint(data: Mapping[str, Any], pictures: Pictures, viewpoint: Mapping[str, Any]) -> str:
    view = str(viewpoint["name"])
    truth = pictures.read("truth", f"{view}.png")
    ceiling = pictures.read("views", "ceiling", f"{view}.png")
    place = ", ".join(short(v) for v in items(viewpoint, "position_mm"))
    heading = element("h3", text(view), element("small", text(f"eye at ({place}) mm")))
    figures = [
        _truth_figure(data, pictures, view, truth),
        _ceiling_figure(data, pictures, view, truth, ceiling),
    ]
    figures += [
        _algorithm_figure(data, pictures, view, name, ceiling) for name in part(data, "algorithms")
    ]
    kind = "views wide" if is_wide(truth) else "views"
    return heading + element("div", *figures, class_=kind, style=f"--count:{len(figures)}")


def _truth_figure(
    data: Mapping[str, Any], pictures: Pictures, view: str, truth: np.ndarray | None
) -> str:
    facts = [("To itself", triple(part(data, "noise_floor", "views", view)))]
    picture = pictures.embed(truth, f"Ground truth from {view}")
    return captioned("Ground truth", "the scene itself", [picture], facts)


def _ceiling_figure(
    data: Mapping[str, Any],
    pictures: Pictures,
    view: str,
    truth: np.ndarray | None,
    ceiling: np.ndarray | None,
) -> str:
    change = difference(ceiling, truth)
    pair = [
        pictures.embed(ceiling, f"Ceiling from {view}"),
        pictures.embed(change, f"Difference of ceiling and ground truth from {view}"),
    ]
    facts = [("To scene", triple(part(data, "ceiling", "views", view)))]
    return captioned("Ceiling", "and difference to ground truth", pair, facts)


def _algorithm_figure(
    data: Mapping[str, Any],
    pictures: Pictures,
    view: str,
    name: str,
    ceiling: np.ndarray | None,
) -> str:
    scores = part(data, "algorithms", name, "views", view)
    made = pictures.read("views", name, f"{view}.png")
    change = difference(made, ceiling)
    pair = [
        pictures.embed(made, f"{name} from {view}"),
        pictures.embed(change, f"Difference of {name} and ceiling from {view}"),
    ]
    to_ceiling = [
        ("SSIM", score(scores, "ssim_to_ceiling")),
        ("PSNR", decibels(scores, "psnr_to_ceiling_db")),
        ("FLIP", score(scores, "flip_to_ceiling")),
    ]
    on_relic = [("SSIM", score(scores, "ssim_on_relic"))]
    facts = [("To ceiling", to_ceiling), ("To scene", triple(scores)), ("On the relic", on_relic)]
    return captioned(name, "and difference to ceiling", pair, facts)
