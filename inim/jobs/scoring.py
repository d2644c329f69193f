"""Scores of pictures, each made once: equal pictures have equal scores."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from inim import metrics
from inim.digest import array_digest
from inim.jobs.deciding import score_parts
from inim.jobs.memo import Memo
from inim.regression import ScoreEstimate, view_scores
from inim.store import Record

__all__ = ["Scorer"]

#: A picture and the two halves it is the mean of, (rows, columns, 3) float32 each.
Three = tuple[np.ndarray, np.ndarray, np.ndarray]


class Scorer:
    """The scores of a run.

    Parameters
    ----------
    memo : Memo
    """

    def __init__(self, memo: Memo) -> None:
        self._memo = memo

    def view(
        self, reference: np.ndarray, test: np.ndarray, mask: np.ndarray | None = None
    ) -> dict[str, float]:
        """See `inim.metrics.score`."""
        pictures = reference, test, mask
        found: dict[str, float] = self._once(
            "scores of a view", pictures, lambda: metrics.score(reference, test, mask)
        )
        return found

    def eia(self, reference: np.ndarray, test: np.ndarray) -> dict[str, float]:
        """SSIM and PSNR of a panel.

        No FLIP: an EIA is never looked at as a picture, so its visibility model says nothing.
        """
        found: dict[str, float] = self._once(
            "scores of an EIA",
            (reference, test),
            lambda: {
                "ssim": metrics.ssim(reference, test),
                "psnr_db": metrics.psnr_db(reference, test),
            },
        )
        return found

    def estimates(
        self, reference: Three, test: Three, names: list[str] | None = None
    ) -> dict[str, ScoreEstimate]:
        """See `inim.regression.view_scores`."""

        def make() -> dict[str, Any]:
            found = view_scores(reference, test, *([names] if names else []))
            return {name: asdict(score) for name, score in found.items()}

        data = self._once(f"score estimates {names or ''}", (*reference, *test), make)
        return {name: ScoreEstimate(**score) for name, score in data.items()}

    def _once(
        self, product: str, pictures: tuple[np.ndarray | None, ...], make: Callable[[], Any]
    ) -> Any:
        parts = {"pictures": array_digest(*pictures), **score_parts()}
        return self._memo.recall(product, parts, lambda: Record({}, make())).facts
