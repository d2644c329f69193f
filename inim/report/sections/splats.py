"""How translucent a relic of splats is, and what a depth map cannot hold of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from inim.report.images import Images
from inim.report.markup import element, text, text_table
from inim.report.sections import ReportSection
from inim.report.wording import is_number, items, mm, part, per_cent, short


def splats(data: Mapping[str, Any], _images: Images) -> str:
    """The section on splats; empty for other scenes."""
    found = part(data, "scene", "splats")
    if not found:
        return ""
    lead = element("p", text(_words(data, found)), class_="lead")
    shares = items(found, "coverage_histogram")
    rows = [
        (f"{k / len(shares):.0%} to {(k + 1) / len(shares):.0%}", per_cent(share, 1))
        for k, share in enumerate(shares)
    ]
    return lead + text_table(
        "Coverage: what share of the light a pixel's ray loses", ["Coverage", "Pixels"], rows
    )


def _words(data: Mapping[str, Any], found: Mapping[str, Any]) -> str:
    """What the figures mean, in sentences."""
    words = (
        f"{short(found.get('count'))} splats touch "
        f"{per_cent(found.get('touched_fraction'), 1)} of the picture's pixels, and take "
        f"{per_cent(found.get('mean_coverage'), 1)} of their light on average. "
        "A depth map has one depth for each: here, that at which half of the light is gone. "
        f"{per_cent(found.get('without_depth_fraction'), 1)} of these pixels never lose half: the "
        "algorithms are not given them. "
        f"{per_cent(found.get('never_opaque_fraction'), 1)} never lose nine tenths: what shows "
        "through them moves otherwise than they do. "
    )
    spread = found.get("depth_spread_mm")
    derived = part(data, "display", "derived")
    low, high = derived.get("depth_min_mm"), derived.get("depth_max_mm")
    if is_number(spread) and is_number(low) and is_number(high) and high > low:
        words += (
            f"In the others, the light is lost over {mm(spread)} of depth (median; "
            f"{mm(found.get('depth_spread_p95_mm'))} in one of twenty), from the first tenth to "
            f"the last, of a depth range of {mm(high - low)}."
        )
    return words


SECTIONS = (ReportSection(45, "splats", "Translucency", splats),)
