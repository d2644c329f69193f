"""Checks: rows of the verdict, each a value against a limit."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from inim.documents.parts import Check, Relation
from inim.image.noisy_image import row_bands

#: An image whose brightest value is below this shows nothing.
BLACK = 1e-4
#: Above this share of clipped pixels, scores say more about exposure than about the algorithm.
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
    """A row of the verdict. A value that is missing or not finite never passes.

    Parameters
    ----------
    name : str
    value : float or None
    relation : {">=", "<="}
    limit : float
    detail : str
    interval : (float, float), optional
        Of the value, where its noise is known.
    criterion : bool
        True for a check of quality, against a limit that the user set.
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
    """A check that fails where pixels were not finite."""
    return [check(f"{name}: pixels not finite", count, "<=", 0, "taken as black")] if count else []


def missing_viewpoints(name: str, wanted: Sequence[str], views: Collection[str]) -> list[Check]:
    """A check that fails where views are missing."""
    missing = [view for view in wanted if view not in views]
    if not missing and views:
        return []
    detail = ", ".join(missing) or "there is none at all"
    return [check(f"{name}: viewpoints missing", max(1, len(missing)), "<=", 0, detail)]


def out_of_range_share(eia: np.ndarray) -> float:
    """Share of pixels that are below black or brighter than the panel's white."""
    rows = row_bands(*eia.shape[:2])
    outside = (np.count_nonzero(any_colour((eia[r] < 0) | (eia[r] > 1))) for r in rows)
    return float(sum(outside) / (eia.shape[0] * eia.shape[1]))


def any_colour(which: np.ndarray) -> np.ndarray:
    """As `any(axis=-1)`, which takes six times as long over three."""
    found: np.ndarray = which[..., 0] | which[..., 1] | which[..., 2]
    return found
