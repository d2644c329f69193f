"""What the numbers mean, in words for a reader who has not read the code."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from inim.report.markup import element, text

__all__ = ["meanings"]

_MEANINGS = (
    (
        "Ground truth",
        "The scene itself, rendered from the viewpoint; and the elemental images "
        "path traced through the centre of every lens.",
    ),
    (
        "Ceiling",
        "The view through this display's lenses of the ground-truth elemental images: "
        "what a perfect algorithm would show on it. What lies between ceiling and scene is lost "
        "by the display, not by an algorithm. It holds noise of its own, so that an algorithm can "
        "come out slightly above it when both are compared with the scene.",
    ),
    (
        "SSIM to ceiling",
        "Likeness of a reconstructed view and the ceiling, from structure: 1 is "
        "identical. It isolates what the algorithm lost, and is the main score.",
    ),
    (
        "SSIM to scene",
        "Likeness of a reconstructed view and the scene: what the viewer gets, "
        "losses of the display included.",
    ),
    (
        "Noise floor",
        "The score of the ground truth against itself with another seed. Differences "
        "between algorithms that are smaller than its distance from 1 mean nothing.",
    ),
    (
        "SSIM on the relic",
        "SSIM to the scene, averaged over the relic's pixels only: an empty "
        "background is easy and flatters every algorithm.",
    ),
    ("PSNR", "Peak signal-to-noise ratio in dB, higher is better; ∞ for identical pictures."),
    ("FLIP", "Difference an eye would notice when flipping between two pictures: 0 is none."),
    ("Holes", "Share of the panel's pixels for which an algorithm found no colour."),
    (
        "Across scenes",
        "Scores are never compared across scenes: a smooth relic scores higher "
        "than a detailed one with the same algorithm. Compare algorithms within this page.",
    ),
)


def meanings(data: Mapping[str, Any]) -> str:  # noqa: ARG001
    """The glossary; the same for every report."""
    entries = [element("div", element("dt", text(k)), element("dd", text(v))) for k, v in _MEANINGS]
    return element("dl", *entries, class_="meanings")
