"""Checks of a report: each compares a value with a limit."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from inim.documents.parts import Check, Relation
from inim.image.noisy_image import row_bands

#: An image whose brightest value is below this is black.
BLACK = 1e-4
#: Above this share of clipped pixels, scores depend more on exposure than on the algorithm.
CLIPPED_SHARE = 0.01


def check(
    name: str,
    value: float | None,
    relation: Relation,
    limit: float,
    detail: str = "",
    interval: tuple[float, float] | None = None,
    criterion: bool = False,
) -> Check:
    """Compare a value with a limit; a value that is missing or not finite fails.

    The interval is that of the value, if available. A criterion is a limit that the user
    set.
    """
    passed = False
    if value is not None and np.isfinite(value):
        passed = bool(value >= limit if relation == ">=" else value <= limit)
    return Check(
        name=name,
        value=value,
        relation=relation,
        limit=limit,
        passed=passed,
        detail=detail,
        interval=interval,
        criterion=criterion,
    )


def nonfinite_checks(name: str, count: int) -> list[Check]:
    """A failed check if pixels are not finite; otherwise empty."""
    return [check(f"{name}: pixels not finite", count, "<=", 0, "taken as black")] if count else []


def missing_viewpoints(name: str, expected: Sequence[str], views: Collection[str]) -> list[Check]:
    """A failed check if views are missing; otherwise empty."""
    missing = [view for view in expected if view not in views]
    if not missing and views:
        return []
    detail = ", ".join(missing) or "no views"
    return [check(f"{name}: viewpoints missing", max(1, len(missing)), "<=", 0, detail)]


def out_of_range_share(eia: np.ndarray) -> float:
    """Share of pixels that are below black or brighter than the panel's white."""
    rows = row_bands(*eia.shape[:2])
    counts = (np.count_nonzero(any_colour((eia[r] < 0) | (eia[r] > 1))) for r in rows)
    return float(sum(counts) / (eia.shape[0] * eia.shape[1]))


def any_colour(mask: np.ndarray) -> np.ndarray:
    """Same as `any(axis=-1)` over three colours, six times as fast."""
    pixels: np.ndarray = mask[..., 0] | mask[..., 1] | mask[..., 2]
    return pixels
