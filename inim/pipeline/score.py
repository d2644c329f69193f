"""Scores of pictures, each made once: equal pictures have equal scores."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np

from inim import metrics
from inim.cache.digest import array_digest
from inim.cache.store import Record
from inim.pipeline.deciding import score_parts
from inim.pipeline.memo import Memo
from inim.regression import ScoreEstimate, view_scores

__all__ = ["Sampled", "Scorer", "ViewScores"]


class Sampled(Protocol):
    """A picture and the two halves of its samples, (rows, columns, 3) float32 each."""

    @property
    def image(self) -> np.ndarray:
        """The mean of the halves."""

    @property
    def first(self) -> np.ndarray:
        """By one half of the samples."""

    @property
    def second(self) -> np.ndarray:
        """By the other."""


@dataclass(frozen=True)
class ViewScores:
    """How like its reference a view is.

    Attributes
    ----------
    values : dict of str to float
        As `inim.metrics.score` returns them.
    estimates : dict of str to ScoreEstimate
        The same values, of those asked for, and how sure they are.
    """

    values: dict[str, float]
    estimates: dict[str, ScoreEstimate]


class Scorer:
    """The scores of a run.

    Parameters
    ----------
    memo : Memo
    """

    def __init__(self, memo: Memo) -> None:
        self._memo = memo

    def view(
        self,
        reference: Sampled,
        test: Sampled,
        mask: np.ndarray | None = None,
        *,
        sure: Sequence[str],
    ) -> ViewScores:
        """Scores of a view.

        Parameters
        ----------
        reference, test : Sampled
        mask : (rows, columns) bool, optional
            Where the relic is.
        sure : sequence of str
            The scores whose errors are wanted; see `inim.regression.view_scores`.
        """
        truth, shown = ((one.image, one.first, one.second) for one in (reference, test))

        def make() -> dict[str, Any]:
            maps = metrics.score_maps(truth[0], shown[0])
            estimates = view_scores(truth, shown, sure, maps)
            return {
                "values": metrics.scores_of(maps, mask),
                "estimates": {name: asdict(score) for name, score in estimates.items()},
            }

        found = self._once(f"scores of a view {[*sure]}", (*truth, *shown, mask), make)
        estimates = {name: ScoreEstimate(**score) for name, score in found["estimates"].items()}
        return ViewScores(found["values"], estimates)

    def plain_view(self, reference: np.ndarray, test: np.ndarray) -> dict[str, float]:
        """`inim.metrics.score` of two pictures."""
        found: dict[str, float] = self._once(
            "scores of a picture", (reference, test), lambda: metrics.score(reference, test)
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

    def _once(
        self, product: str, pictures: tuple[np.ndarray | None, ...], make: Callable[[], Any]
    ) -> Any:
        parts = {"pictures": array_digest(*pictures), **score_parts()}
        return self._memo.recall(product, parts, lambda: Record({}, make())).facts
