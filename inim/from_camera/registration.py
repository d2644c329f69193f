"""Whether a colour and a depth picture belong together: their sizes, and their edges.

Depth is brought to the colour picture's size by taking the nearest pixel, never a mean: between an
object and its background there is nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inim.errors import FileError

__all__ = ["Shift", "check_same_view", "edge_shift", "resampled"]

# Weights of red, green and blue; any that look at all three would do.
_LUMA = (0.3, 0.6, 0.1)
# Of width over height; cropped or letter-boxed pictures differ by more.
_ASPECT_TOLERANCE = 0.01
# Edges are compared on pictures about this wide; farther than this share of it is not looked.
_COMPARED_AT = 480
_FARTHEST = 0.06
# An edge of depth: neighbours that differ by this part of the depth range.
_EDGE = 0.05
# Fewer edge pixels say nothing.
_LEAST_EDGES = 200
# Depth sensors miss the true edge by a few pixels; a shift by less is no finding.
_TOLERATED = 4.0
# How much better the edges must match there than where they are, above their mean match.
_BETTER = 1.35
# A best match this many deviations above the others is none by chance: among the some thousand
# shifts, pictures that have nothing in common reach 4.
_BEYOND_CHANCE = 5.0


@dataclass(frozen=True)
class Shift:
    """Where the depth picture's edges would match the colour picture's best.

    Attributes
    ----------
    right, down : float
        Pixels of the colour picture by which depth would have to be moved.
    found : bool
        Whether the match is so much better there that the two are likely misaligned.
    """

    right: float
    down: float
    found: bool


def check_same_view(color: tuple[int, int], depth: tuple[int, int], name: str) -> None:
    """Raise `FileError` where two pictures, (rows, columns), cannot show the same view."""
    aspects = [columns / rows for rows, columns in (color, depth)]
    if abs(aspects[0] / aspects[1] - 1) <= _ASPECT_TOLERANCE:
        return
    turned = abs(aspects[0] * aspects[1] - 1) <= _ASPECT_TOLERANCE
    way_out = "one of them is turned; turn it back" if turned else "crop them to the same view"
    raise FileError(
        f"{name}: depth has {depth[1]} x {depth[0]} pixels, colour {color[1]} x {color[0]}: "
        f"another shape; {way_out}"
    )


def resampled(depth: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.float32]:
    """Depth at another size, each pixel's that of the nearest pixel centre."""
    if depth.shape == shape:
        return depth
    rows, columns = (
        np.minimum(((np.arange(n) + 0.5) * m / n).astype(np.int64), m - 1)
        for n, m in zip(shape, depth.shape, strict=True)
    )
    nearest: NDArray[np.float32] = depth[np.ix_(rows, columns)]
    return nearest


def edge_shift(color: np.ndarray, depth: NDArray[np.float32]) -> Shift:
    """Compare the edges of depth with those of colour at all small shifts.

    Parameters
    ----------
    color : (H, W, 3) array
    depth : (H, W) float32
        NaN where missing.
    """
    step = max(1, math.ceil(depth.shape[1] / _COMPARED_AT))
    small = depth[::step, ::step]
    grey = np.asarray(color[::step, ::step], np.float32) @ np.array(_LUMA, np.float32)
    edges, contrast = _depth_edges(small), _contrast(grey)
    farthest = max(1, round(_FARTHEST * max(small.shape)))
    if edges.sum() < _LEAST_EDGES or min(small.shape) <= 2 * farthest:
        return Shift(0.0, 0.0, found=False)
    padded = tuple(n + farthest for n in small.shape)
    spectrum = np.fft.rfft2(contrast - contrast.mean(), padded) * np.conj(
        np.fft.rfft2(edges, padded)
    )
    match = np.roll(np.fft.irfft2(spectrum, padded), (farthest, farthest), (0, 1))
    match = match[: 2 * farthest + 1, : 2 * farthest + 1]
    down, right = (int(v) - farthest for v in np.unravel_index(match.argmax(), match.shape))
    here, best = float(match[farthest, farthest]), float(match.max())
    base = float(np.median(match))
    deviation = 1.4826 * float(np.median(np.abs(match - base)))  # of a normal distribution
    found = (
        math.hypot(down, right) * step > _TOLERATED
        and best - base > _BETTER * (here - base)
        and best - base > _BEYOND_CHANCE * deviation
    )
    return Shift(float(right * step), float(down * step), found)


def _depth_edges(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """1 on both sides of a jump of depth, 0 elsewhere and beside missing depth."""
    known = depth[~np.isnan(depth)]
    edges = np.zeros(depth.shape, np.float32)
    if known.size < 2:
        return edges
    low, high = np.quantile(known, (0.02, 0.98))
    limit = _EDGE * float(high - low)
    across = np.abs(np.diff(depth, axis=1)) > limit
    down = np.abs(np.diff(depth, axis=0)) > limit
    edges[:, :-1][across] = 1
    edges[:, 1:][across] = 1
    edges[:-1][down] = 1
    edges[1:][down] = 1
    return edges


def _contrast(grey: NDArray[np.float32]) -> NDArray[np.float32]:
    """Differences of neighbours, compressed so that a few hard edges do not decide."""
    across = np.zeros_like(grey)
    across[:, 1:-1] = np.abs(grey[:, 2:] - grey[:, :-2])
    across[1:-1] += np.abs(grey[2:] - grey[:-2])
    return np.asarray(np.sqrt(across), np.float32)
