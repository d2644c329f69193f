"""`--fit auto`: what of a picture a display shows, chosen by its depth.

The subject is the nearer of two classes of nearness (Otsu, IEEE Trans. SMC 9, 1979), the middle of
the picture counting more than its rim, and only where there are two: an even spread of depths,
which has no subject, is explained by two classes to 3 / 4. The depth range goes to the subject and
half as much behind it; what is farther becomes its backdrop at the far end. The picture is cut to
the display's shape around the subject, or kept whole where that would cut the subject.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from inim.from_camera.depth_values import DepthValues

# Enough to see a subject by; the choice does not need every pixel.
_LOOKED_AT = 512
_BINS = 256
_STRAY = 0.005
# Share of the variance that two classes must explain; 0.75 of an even spread, 0.64 of a normal one.
_TWO_CLASSES = 0.8
# Of the weight; less is a rim, a finger, a table's edge.
_LEAST_SUBJECT = 0.05
_BEHIND = 0.5
# Of the picture's range: the least that a flat subject is given.
_LEAST_EXTENT = 0.1
# Stray pixels of the subject's class do not decide where it lies.
_BOX_STRAY = 0.02
# Thresholds as good as the best one: their sums differ by rounding alone.
_TIE = 1e-9


@dataclass(frozen=True)
class Framing:
    """What is shown.

    Attributes
    ----------
    rows, columns : slice
        Of the picture.
    near, far : float
        Range of depth, in the unit of the picture's.
    middle : float
        The subject's median depth.
    fit : {"contain", "cover"}
    said : str
        Why.
    """

    rows: slice
    columns: slice
    near: float
    far: float
    middle: float
    fit: str
    said: str


def frame(values: DepthValues, aspect: float) -> Framing:
    """Choose what to show of a picture.

    Parameters
    ----------
    values : DepthValues
    aspect : float
        Width over height of the display.
    """
    step = max(1, math.ceil(max(values.depth.shape) / _LOOKED_AT))
    small = values.depth[step // 2 :: step, step // 2 :: step].astype(np.float64)
    known = ~np.isnan(small)
    if not known.any():
        small, step = values.depth.astype(np.float64), 1
        known = ~np.isnan(small)
    inverse = not values.near_is_large and bool((small[known] > 0).all())
    nearness = 1 / small if inverse else small if values.near_is_large else -small
    weight = _weights(small.shape)
    low, high = _ends(nearness[known], weight[known])
    threshold, explained = _two_classes(nearness[known], weight[known], low, high)
    with np.errstate(invalid="ignore"):
        subject = known & (nearness > threshold)
    share = float(weight[subject].sum() / weight[known].sum())
    clear = explained >= _TWO_CLASSES and share >= _LEAST_SUBJECT
    if not clear:
        subject = known
    back, front = _ends(nearness[subject], weight[subject])
    extent = max(front - back, _LEAST_EXTENT * (high - low))
    far = max(low, back - _BEHIND * extent) if clear else low

    def depth(value: float) -> float:
        return float(1 / value if inverse else value if values.near_is_large else -value)

    rows, columns = values.depth.shape
    high_px, wide_px = min(rows, round(columns / aspect)), min(columns, round(rows * aspect))
    window, fit = (slice(0, rows), slice(0, columns)), "contain"
    said = f"no subject before a background (two depths explain {explained:.0%}); range: all"
    if clear:
        unit = " mm" if values.has_unit else ""
        said = (
            f"subject {share:.0%} of the picture, the middle counting more; nearer than "
            f"{depth(threshold):.4g}{unit} (two depths explain {explained:.0%}); range: the "
            "subject and half as much behind it"
        )
        ends = [
            np.quantile(places, (_BOX_STRAY, 1 - _BOX_STRAY), method="nearest") * step
            for places in np.nonzero(subject)
        ]
        if np.ptp(ends[0]) <= high_px and np.ptp(ends[1]) <= wide_px:
            window, fit = (
                (_around(ends[0], high_px, rows), _around(ends[1], wide_px, columns)),
                "cover",
            )
    if fit == "cover":
        said += f"; cover: {wide_px} x {high_px} of {columns} x {rows} pixels around it"
    else:
        said += "; contain: the whole picture" + ", as cover would cut the subject" * clear
    middle = float(np.median(nearness[subject]))
    return Framing(*window, depth(front), depth(far), depth(middle), fit=fit, said=said)


def _weights(shape: tuple[int, ...]) -> np.ndarray:
    """A Gaussian about the middle, 1 there and exp(-2) in the middle of each side."""
    y, x = (np.linspace(-1, 1, n) for n in shape)
    weights: np.ndarray = np.exp(-2 * (y[:, None] ** 2 + x[None] ** 2))
    return weights


def _ends(values: np.ndarray, weights: np.ndarray) -> tuple[float, float]:
    """Least and largest value but for stray ones."""
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order])
    least, most = np.searchsorted(below, np.array((_STRAY, 1 - _STRAY)) * below[-1])
    return float(values[order[least]]), float(values[order[most]])


def _two_classes(
    nearness: np.ndarray, weights: np.ndarray, low: float, high: float
) -> tuple[float, float]:
    """The threshold that parts the nearness best, and the share of variance it explains."""
    if not low < high:
        return high, 0.0
    counts, edges = np.histogram(np.clip(nearness, low, high), _BINS, (low, high), weights=weights)
    centres = (edges[1:] + edges[:-1]) / 2
    share = np.cumsum(counts / counts.sum())
    moment = np.cumsum(counts / counts.sum() * centres)
    mean = moment[-1]
    variance = float((counts / counts.sum() * (centres - mean) ** 2).sum())
    inner = (share[:-1] > 0) & (share[:-1] < 1)
    between = np.zeros(_BINS - 1)
    s, m = share[:-1][inner], moment[:-1][inner]
    between[inner] = (mean * s - m) ** 2 / (s * (1 - s))
    # A gap between two classes can be parted anywhere: in its middle.
    best = np.flatnonzero(between >= (1 - _TIE) * between.max())
    threshold = float(edges[1:-1][best].mean())
    return threshold, float(between.max()) / variance if variance > 0 else 0.0


def _around(ends: np.ndarray, size: int, most: int) -> slice:
    """A part of a side, with the ends in its middle where the picture goes so far."""
    begin = min(max(0, int(ends.sum() - size) // 2), most - size)
    return slice(begin, begin + size)
