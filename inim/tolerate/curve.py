"""What an error costs: a law fitted to draws, and the largest error that costs a stated loss.

The loss of SSIM by an error e of one parameter, all others exact:

    L(e) = 1 - exp(-(|e| / w)^p),   w of its own below zero and above

It is none at zero, grows as a power of small errors (p = 1 where an error swaps whole pixels, 2
where it mixes neighbours), and ends where nothing is left to lose. Nothing in it is derived from
optics: how far draws lie off it is reported beside it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from random import Random

import numpy as np

_RESAMPLED = 200
_COVERAGE = 0.95
# Residuals beyond this count by their size, no longer by their square: in `_stretched` units, of
# which near zero one is the criterion.
_OUTLIER = 0.1
_LEAST_POWER, _LARGEST_POWER = 0.5, 6.0


@dataclass(frozen=True)
class Curve:
    """The law, of one parameter.

    Attributes
    ----------
    power : float
        p.
    below, above : float
        w of negative and of positive errors, in the parameter's unit.
    """

    power: float
    below: float
    above: float

    def loss(self, error: float) -> float:
        """What an error costs."""
        return float(_law(astuple(self), np.array(error)))

    def tolerance(self, criterion: float) -> float:
        """The largest error, either way, that costs no more."""
        part: float = (-math.log1p(-criterion)) ** (1 / self.power)
        return min(self.below, self.above) * part


def fit_curve(
    errors: Sequence[float], losses: Sequence[float], criterion: float, near: Curve | None = None
) -> Curve:
    """The law that draws follow; draws that do not, if few, change little.

    Losses are compared in a scale that is linear up to the criterion and logarithmic beyond it, so
    that large losses do not outweigh those that decide.

    Parameters
    ----------
    errors, losses : sequence of float
        Of the draws; not all errors are zero.
    criterion : float
        The loss that matters.
    near : Curve, optional
        Where to begin.
    """
    from scipy.optimize import least_squares

    e, lost = np.asarray(errors, float), np.asarray(losses, float)
    seen, farthest = _stretched(lost, criterion), float(np.abs(e).max())

    def curve(x: np.ndarray) -> tuple[float, float, float]:
        # By the power and, either way, the error that costs the criterion: they hang together far
        # less than power and widths do.
        power, below, above = np.exp(x)
        wider = (-math.log1p(-criterion)) ** (1 / power)
        return power, below / wider, above / wider

    low = np.log([_LEAST_POWER, farthest / 1e3, farthest / 1e3])
    high = np.log([_LARGEST_POWER, farthest * 1e2, farthest * 1e2])
    starts = [(p, *[_crossing(e, lost, criterion, p)] * 2) for p in (1.0, 2.0)]
    if near is not None:
        wider = (-math.log1p(-criterion)) ** (1 / near.power)
        starts = [(near.power, near.below * wider, near.above * wider)]
    found = [
        least_squares(
            lambda x: _stretched(_law(curve(x), e), criterion) - seen,
            np.clip(np.log(start), low + 1e-6, high - 1e-6),
            bounds=(low, high),
            loss="soft_l1",
            f_scale=_OUTLIER,
        )
        for start in starts
    ]
    return Curve(*map(float, curve(min(found, key=lambda one: float(one.cost)).x)))


def _crossing(error: np.ndarray, lost: np.ndarray, criterion: float, power: float) -> float:
    """The error that would cost the criterion if each draw alone were believed: their median."""
    counts = lost > criterion / 4
    if not counts.any():
        return float(3 * np.abs(error).max())
    return float(np.median(np.abs(error[counts]) * (criterion / lost[counts]) ** (1 / power)))


def _stretched(loss: np.ndarray, criterion: float) -> np.ndarray:
    found: np.ndarray = np.arcsinh(loss / criterion)
    return found


def _law(x: tuple[float, float, float], error: np.ndarray) -> np.ndarray:
    power, below, above = x
    width = np.where(error < 0, below, above)
    found: np.ndarray = -np.expm1(-((np.abs(error) / width) ** power))
    return found


def tolerance_interval(
    curve: Curve,
    errors: Sequence[float],
    losses: Sequence[float],
    farthest: float,
    criterion: float,
    seed: str,
) -> list[float | None]:
    """The 95 % interval of a curve's tolerance, by draws drawn again from the draws.

    Parameters
    ----------
    curve : Curve
        Fitted to all draws.
    errors, losses : sequence of float
        Of the draws.
    farthest : float
        To which they reach.
    criterion : float
    seed : str

    Returns
    -------
    list of two float or None
        None: beyond the draws.
    """
    bears, random = curve.tolerance(criterion), Random(seed)
    pairs = [pair for pair in zip(errors, losses, strict=True) if pair[0]]
    found = []
    for _ in range(_RESAMPLED):
        again = random.choices(pairs, k=len(pairs))
        fitted = fit_curve([e for e, _ in again], [loss for _, loss in again], criterion, curve)
        found.append(fitted.tolerance(criterion) / bears)
    found.sort()
    outside = round(len(found) * (1 - _COVERAGE) / 2)
    # Draws drawn again scatter less than new ones would, by the numbers fitted to them.
    wider = math.sqrt(len(pairs) / (len(pairs) - len(astuple(curve))))
    ends = (bears * found[place] ** wider for place in (outside, -1 - outside))
    return [end if end <= farthest else None for end in ends]


def share_interval(passed: int, of: int) -> tuple[float, float]:
    """The 95 % interval of a share (Wilson 1927)."""
    z = 1.96
    middle, room = passed + z * z / 2, of + z * z
    half = z * math.sqrt(passed * (of - passed) / of + z * z / 4)
    return max((middle - half) / room, 0.0), min((middle + half) / room, 1.0)
