"""What a metric is: a function of two pictures, and all that the rest of the program says of it."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np

from inim.errors import UsageError

__all__ = ["Metric", "mean_of"]

_NAME = re.compile(r"[a-z][a-z0-9]*")
_UNIT = re.compile(r"[A-Za-z]*")


@dataclass(frozen=True)
class Metric:
    """A metric.

    Attributes
    ----------
    name : str
        Small letters and digits: ``ssim``.
    function : callable
        Of reference and test, (rows, columns, 3) float32 each, sRGB in 0..1: the score, or a
        (rows, columns) map whose mean is the score. A map tells noise from change more sharply.
    tolerance : float
        The smallest change that a regression check counts, in the score's unit.
    better : {"higher", "lower"}
    range : (float, float)
        Of scores. An infinite end allows infinite scores.
    label : str
        In reports; the name in capitals where it is empty.
    unit : str
        Of the score, in letters: ``dB``.
    digits : int
        After the point, in reports.
    reference : str
        The paper that defines it.
    of_eia : bool
        Whether it says something of a panel's pixels, too, which nobody looks at as a picture.
    on_relic : bool
        Whether the mean over the relic's pixels is reported, too. It needs a map.
    of_mean : callable, optional
        From a map's mean to the score and its derivative, where the score is not the mean itself;
        derivative 0 where it has none.
    whole : callable, optional
        Of reference and test in linear RGB: the score of pictures too large for a map.
    reach : int, optional
        Pixels beyond its own on which a map's value depends. If it is given, the function sees
        only parts of pictures, those in which they differ.
    where_equal : float
        A map's value where all that it depends on is equal; needed with `reach`.
    dtype : type
        Of the map, with `reach`.
    least_px : int
        Least side of a picture that the function takes.
    """

    name: str
    function: Callable[[np.ndarray, np.ndarray], Any]
    _: KW_ONLY
    tolerance: float
    better: str = "higher"
    range: tuple[float, float] = (0.0, 1.0)
    label: str = ""
    unit: str = ""
    digits: int = 4
    reference: str = ""
    of_eia: bool = False
    on_relic: bool = False
    of_mean: Callable[[float], tuple[float, float]] | None = None
    whole: Callable[[np.ndarray, np.ndarray], float] | None = None
    reach: int | None = None
    where_equal: float = 0.0
    dtype: type = np.float32
    least_px: int = 1

    def __post_init__(self) -> None:
        """Raise `UsageError` unless the declaration makes sense."""
        if not self.label:
            object.__setattr__(self, "label", str(self.name).upper())
        wrong = [said for said, holds in self._claims().items() if not holds]
        if wrong:
            raise UsageError(f"metric {self.name!r}: {wrong[0]}")

    def _claims(self) -> dict[str, bool]:
        number = isinstance(self.tolerance, (int, float)) and math.isfinite(self.tolerance)
        return {
            "its name must be small letters and digits": bool(_NAME.fullmatch(str(self.name))),
            "its function must be one of (reference, test)": callable(self.function),
            "its tolerance must be a number above 0": number and self.tolerance > 0,
            "better is 'higher' or 'lower'": self.better in ("higher", "lower"),
            "its range must be (low, high)": len(self.range) == 2 and self.range[0] < self.range[1],
            "its unit must be letters": bool(_UNIT.fullmatch(self.unit)),
        }

    @property
    def key(self) -> str:
        """Name of its score in reports and tables, with the unit: ``psnr_db``."""
        return "_".join(filter(None, (self.name, self.unit.lower())))

    @property
    def to_ceiling_key(self) -> str:
        """The same of a score against the ceiling: ``psnr_to_ceiling_db``."""
        return "_".join(filter(None, (self.name, "to_ceiling", self.unit.lower())))

    @property
    def on_relic_key(self) -> str:
        """The same of a score over the relic's pixels alone: ``ssim_on_relic``."""
        return "_".join(filter(None, (self.name, "on_relic", self.unit.lower())))

    def score(self, local: np.ndarray, mask: np.ndarray | None = None) -> float:
        """The score from a map, (rows, columns), or from the score itself, ().

        With a (rows, columns) bool mask, from the pixels that it picks.
        """
        mean = mean_of(local, mask)
        return mean if self.of_mean is None else self.of_mean(mean)[0]


def mean_of(local: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Mean of a map in float64, over a mask if one is given; NaN of no pixel."""
    if mask is not None:
        local = local[mask]
    return float(local.mean(dtype=np.float64)) if local.size else math.nan
