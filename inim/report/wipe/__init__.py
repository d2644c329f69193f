"""Two views in one place: a border that slides between them, a flip, their difference.

The controls and the stage stay hidden until the script, package data beside this file, finds images
in the page's own section on the views to put there. That section is what stands without scripts.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from inim.report.images import DIFFERENCE_GAIN, is_wide
from inim.report.markup import element, text, void
from inim.report.page import Widget, package_text
from inim.report.wording import NBSP

__all__ = ["WIPE", "wipe"]

_ID = "wipe"
WIPE = Widget(package_text("wipe", "wipe.css"), package_text("wipe", "wipe.js"), f'id="{_ID}"')
_WAYS = (
    ("slider", "slider", True),
    ("flip", "flip", False),
    ("difference", f"difference ×{NBSP}{DIFFERENCE_GAIN}", False),
)
_HELP = (
    "Drag across the picture, or move the slider with the arrow keys, to uncover one of the two "
    "under the other; flip between them where they lie; or see their difference."
)


def wipe(viewpoints: Sequence[str], names: Sequence[str], second: str, truth: Any) -> str:
    """Two views over each other; empty where there are no two to compare.

    Parameters
    ----------
    viewpoints : sequence of str
        The first of them, or the one called centre, is shown first.
    names : sequence of str
        What there is a picture of from each viewpoint: `data-shows` of the page's images, whose
        `data-viewpoint` is the viewpoint. The first of them is one of the two shown first.
    second : str
        The other.
    truth : (rows, columns, 3) uint8, or None
        Any of the images, for their shape; None leaves all out.
    """
    if truth is None or not viewpoints or len(names) < 2:
        return ""
    start = "centre" if "centre" in viewpoints else viewpoints[0]
    choices = [
        _choice("From", "viewpoint", viewpoints, start),
        _choice("First", "first", names, names[0]),
        _choice("Second", "second", names, second),
        element("fieldset", element("legend", "Compare by"), element("div", *map(_way, _WAYS))),
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
        element("div", flips, element("label", itself, "by itself"), data_way="flip"),
        element("p", class_="spoken", role="status"),
    ]
    lead = element("p", text(_HELP), class_="lead")
    controls = element("div", *choices, class_="controls")
    kind = "wipe wide" if is_wide(truth) else "wipe"
    return element("div", lead, controls, stage, *below, id=_ID, class_=kind, hidden="hidden")


def _choice(label: str, name: str, options: Sequence[str], chosen: str) -> str:
    listed = [
        element("option", text(one), value=one, selected="selected" if one == chosen else None)
        for one in options
    ]
    return element("label", text(label), element("select", *listed, name_=name))


def _way(way: tuple[str, str, bool]) -> str:
    value, label, checked = way
    radio = void(
        "input",
        type="radio",
        name_="compare-by",
        value=value,
        checked="checked" if checked else None,
    )
    return element("label", radio, text(label))
