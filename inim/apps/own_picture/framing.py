"""`--fit auto`: crop and depth range of a picture, chosen by its depth.

The nearness of the pixels is split into two classes (Otsu, IEEE Trans. SMC 9, 1979), with more
weight in the middle of the picture. The nearer class is the subject if the two classes are distinct
(two classes explain 3 / 4 of a uniform distribution). The depth range covers the subject and half
as much behind it; farther depths are clipped to its far end. The picture is cropped to the
display's shape around the subject, or around its middle if it has none.
"""

import math
from dataclasses import dataclass

import numpy as np

from inim.apps.own_picture.depth_values import DepthValues

# The picture is subsampled to at most this size.
_SAMPLED_PX = 512
_BINS = 256
_STRAY = 0.005
# Share of the variance that two classes must explain; 0.75 if uniform, 0.64 if normal.
_MIN_EXPLAINED = 0.8
# Minimum share of the weight; smaller classes are a rim, a finger or a table's edge.
_MIN_SUBJECT = 0.05
_BEHIND = 0.5
# Minimum depth extent of a flat subject, as a share of the picture's range.
_MIN_EXTENT = 0.1
# Stray pixels at each side that the subject's bounding box ignores.
_BOX_STRAY = 0.02
# A subject of which this share remains is whole.
_WHOLE = 0.98
# Relative tolerance for equally good thresholds, which differ by rounding.
_TIE = 1e-9


@dataclass(frozen=True)
class Framing:
    """Crop and depth range of a picture."""

    #: Part of the picture.
    rows: slice
    columns: slice
    #: Depth range, in the picture's unit.
    near: float
    far: float
    subject_depth: float  #: Median depth of the subject.
    notes: dict[str, str]  #: Short explanations of `subject`, `range` and `crop`.


def choose_framing(values: DepthValues, aspect: float) -> Framing:
    """Choose crop and depth range by the subject; `aspect` is width over height of the display."""
    step = max(1, math.ceil(max(values.depth.shape) / _SAMPLED_PX))
    small = values.depth[step // 2 :: step, step // 2 :: step].astype(np.float64)
    valid = ~np.isnan(small)
    if not valid.any():
        small, step = values.depth.astype(np.float64), 1
        valid = ~np.isnan(small)
    inverse = not values.near_is_large and bool((small[valid] > 0).all())
    nearness = 1 / small if inverse else small if values.near_is_large else -small
    weight = _weights(small.shape)
    low, high = _ends(nearness[valid], weight[valid])
    threshold, explained = _otsu_threshold(nearness[valid], weight[valid], low, high)
    with np.errstate(invalid="ignore"):
        subject = valid & (nearness > threshold)
    share = float(weight[subject].sum() / weight[valid].sum())
    has_subject = explained >= _MIN_EXPLAINED and share >= _MIN_SUBJECT
    if not has_subject:
        subject = valid
    back, front = _ends(nearness[subject], weight[subject])
    extent = max(front - back, _MIN_EXTENT * (high - low))
    far = max(low, back - _BEHIND * extent) if has_subject else low

    def depth(value: float) -> float:
        return float(1 / value if inverse else value if values.near_is_large else -value)

    rows, columns = values.depth.shape
    high_px, wide_px = min(rows, round(columns / aspect)), min(columns, round(rows * aspect))
    ends = [np.array([0, size]) for size in (rows, columns)]
    notes = {
        "subject": f"none before a background: two depths explain {explained:.0%}",
        "range": "all depths",
        "crop": f"{wide_px} x {high_px} of {columns} x {rows} pixels",
    }
    if has_subject:
        unit = " mm" if values.has_unit else ""
        notes["subject"] = (
            f"{share:.0%} of the picture, centre-weighted, nearer than {depth(threshold):.4g}"
            f"{unit}: two depths explain {explained:.0%}"
        )
        notes["range"] = "the subject and half as much behind it"
        ends = [
            np.quantile(places, (_BOX_STRAY, 1 - _BOX_STRAY), method="nearest") * step
            for places in np.nonzero(subject)
        ]
    window = _centre_window(ends[0], high_px, rows), _centre_window(ends[1], wide_px, columns)
    shares = [size / (np.ptp(e) + 1) for e, size in zip(ends, (high_px, wide_px), strict=True)]
    if has_subject and min(shares) < _WHOLE:
        lost = f"{1 - min(shares):.0%} of the subject"
        notes["crop"] += f", without {lost}; --fit contain shows all"
    middle = depth(float(np.median(nearness[subject])))
    return Framing(*window, depth(front), depth(far), middle, notes)


def _weights(shape: tuple[int, ...]) -> np.ndarray:
    """Gaussian around the centre: 1 there and exp(-2) in the middle of each side."""
    y, x = (np.linspace(-1, 1, n) for n in shape)
    weights: np.ndarray = np.exp(-2 * (y[:, None] ** 2 + x[None] ** 2))
    return weights


def _ends(values: np.ndarray, weights: np.ndarray) -> tuple[float, float]:
    """Smallest and largest value, without stray ones."""
    order = np.argsort(values, kind="stable")
    cumulative = np.cumsum(weights[order])
    least, most = np.searchsorted(cumulative, np.array((_STRAY, 1 - _STRAY)) * cumulative[-1])
    return float(values[order[least]]), float(values[order[most]])


def _otsu_threshold(
    nearness: np.ndarray, weights: np.ndarray, low: float, high: float
) -> tuple[float, float]:
    """Threshold between two classes of nearness, and the share of variance that they explain."""
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
    # All thresholds within a gap are equally good: take the middle.
    best = np.flatnonzero(between >= (1 - _TIE) * between.max())
    threshold = float(edges[1:-1][best].mean())
    return threshold, float(between.max()) / variance if variance > 0 else 0.0


def _centre_window(ends: np.ndarray, size: int, limit: int) -> slice:
    """Window of `size` pixels centred between the ends, within 0 .. `limit`."""
    begin = min(max(0, int(ends.sum() - size) // 2), limit - size)
    return slice(begin, begin + size)
