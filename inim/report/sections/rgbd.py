"""What the algorithms were given: colour, depth, and whether the depth suits the display."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from inim.report.depth_profile import depth_profile
from inim.report.markup import element, figure, text
from inim.report.pictures import Pictures
from inim.report.wording import is_number, mm, part, per_cent, short

__all__ = ["rgbd"]

# The renderer works in single precision, and so does the depth picture.
_SLACK = 1e-5


def rgbd(data: Mapping[str, Any], pictures: Pictures) -> str:
    """The section on the RGB-D input."""
    colour, depth = (pictures.read(f"rgbd_{kind}.png") for kind in ("color", "depth"))
    shots = [
        figure(pictures.embed(colour, "RGB-D input, colour"), "Colour"),
        figure(pictures.embed(depth, "RGB-D input, depth"), "Depth", _depth_words(data)),
        _profile(data, pictures),
    ]
    return element("p", text(_words(data)), class_="lead") + element("div", *shots, class_="three")


def _words(data: Mapping[str, Any]) -> str:
    given = part(data, "rgbd")
    return (
        f"What the algorithms were given: {short(given.get('columns'))} × "
        f"{short(given.get('rows'))} pixels of {mm(given.get('pixel_mm'))}, "
        f"{per_cent(given.get('covered_fraction'), 1)} of them covered by the relic, depths from "
        f"{mm(given.get('depth_min_mm'))} to {mm(given.get('depth_max_mm'))} towards the viewer."
    )


def _depth_words(data: Mapping[str, Any]) -> str:
    derived = part(data, "display", "derived")
    far, near = mm(derived.get("depth_min_mm")), mm(derived.get("depth_max_mm"))
    return f"lighter is nearer to the viewer, from {far} to {near}; black is background"


def _profile(data: Mapping[str, Any], pictures: Pictures) -> str:
    drawing = depth_profile(pictures.folder, part(data, "display", "derived"))
    return figure(drawing, "Depth along the array", _profile_words(data)) if drawing else ""


def _profile_words(data: Mapping[str, Any]) -> str:
    """Whether the relic is where the display can show it."""
    derived, given = part(data, "display", "derived"), part(data, "rgbd")
    ends = [(part_.get("depth_min_mm"), part_.get("depth_max_mm")) for part_ in (derived, given)]
    (low, high), (first, last) = ends
    if not (is_number(low) and is_number(high) and is_number(first) and is_number(last)):
        return "seen from above"
    slack = _SLACK * max(abs(low), abs(high))
    inside = low - slack <= first and last <= high + slack
    place = "lies inside" if inside else "leaves"
    return f"seen from above, all rows together: the relic {place} the display's depth range"
