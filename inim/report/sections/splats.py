"""How translucent a relic of splats is, and what a depth map cannot hold of it."""

from __future__ import annotations

from inim.documents.report import ReportDocument, Splats
from inim.report.images import Images
from inim.report.markup import element, text, text_table
from inim.report.sections import ReportSection
from inim.report.wording import mm, per_cent, short


def splats(data: ReportDocument, _images: Images) -> str:
    """The section on splats; empty for other scenes."""
    found = data.scene.splats
    if found is None:
        return ""
    lead = element("p", text(_words(data, found)), class_="lead")
    shares = found.coverage_histogram
    rows = [
        (f"{k / len(shares):.0%} to {(k + 1) / len(shares):.0%}", per_cent(share, 1))
        for k, share in enumerate(shares)
    ]
    return lead + text_table(
        "Coverage: what share of the light a pixel's ray loses", ["Coverage", "Pixels"], rows
    )


def _words(data: ReportDocument, found: Splats) -> str:
    """What the figures mean, in sentences."""
    words = (
        f"{short(found.count)} splats touch "
        f"{per_cent(found.touched_fraction, 1)} of the picture's pixels, and take "
        f"{per_cent(found.mean_coverage, 1)} of their light on average. "
        "A depth map has one depth for each: here, that at which half of the light is gone. "
        f"{per_cent(found.without_depth_fraction, 1)} of these pixels never lose half: the "
        "algorithms are not given them. "
        f"{per_cent(found.never_opaque_fraction, 1)} never lose nine tenths: what shows "
        "through them moves otherwise than they do. "
    )
    if found.depth_spread_mm is not None:
        low, high = data.display.given.depth_range_mm
        words += (
            f"In the others, the light is lost over {mm(found.depth_spread_mm)} of depth (median; "
            f"{mm(found.depth_spread_p95_mm)} in one of twenty), from the first tenth to "
            f"the last, of a depth range of {mm(high - low)}."
        )
    return words


SECTIONS = (ReportSection(45, "splats", "Translucency", splats),)
