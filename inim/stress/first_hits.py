"""First hits, the oracle of `template` and `layered`: all border crossings of a ray, sorted.

In float64, and in fractions, where nothing is rounded. A picture without layers is one layer whose
solids have no back.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction
from itertools import pairwise

import numpy as np

from inim.display import Display
from inim.generators.sources import HOLE
from inim.rgbd import RGBD, Layer, LayeredRGBD
from inim.stress.rays import Line, Rays

__all__ = ["CHUNK", "cell_of", "exact_hits", "first_hits", "framed", "layers_of"]

#: Numbers in the largest array an oracle makes at once.
CHUNK = 2_000_000
_STILL = (0.0, 0.0, 0.0)


def layers_of(rgbd: RGBD) -> tuple[Layer, ...]:
    """A picture's layers; without any, its front surface, solid all the way back."""
    if isinstance(rgbd, LayeredRGBD):
        return rgbd.layers
    back = np.full(rgbd.shape, -np.inf, np.float32)
    return (Layer(rgbd.color, rgbd.depth_mm, back, rgbd.covered),)


def first_hits(rays: Rays, rgbd: RGBD, display: Display, push: tuple = _STILL) -> np.ndarray:
    """The source of each ray, in float64; each interval's cell is that of its midpoint.

    Parameters
    ----------
    rays : Rays
    rgbd : RGBD
    display : Display
    push : (columns, rows, depths)
        By how much coordinates (cells) and depths (mm) are off.

    Returns
    -------
    (n,) int64
        ``(layer * H + row) * W + column``, or `HOLE`.
    """
    low, high = display.depth_range_mm
    fronts = np.stack(
        [_framed(layer.front_mm, layer.covered, push[2]) for layer in layers_of(rgbd)]
    )
    backs = np.stack([_framed(layer.back_mm, layer.covered, push[2]) for layer in layers_of(rgbd)])
    v0, u0 = rays.v0 + push[1], rays.u0 + push[0]
    found = np.empty(len(u0), np.int64)
    reach = np.abs([rays.du, rays.dv]).max(initial=0) * (high - low)
    step = max(1, int(CHUNK // (len(fronts) * (2 * reach + 6))))
    for begin in range(0, len(u0), step):
        part = slice(begin, begin + step)
        down, across = (v0[part], rays.dv[part]), (u0[part], rays.du[part])
        found[part] = _hits(down, across, fronts, backs, rgbd.shape, low, high)
    return found


def framed(rgbd: RGBD, push: float) -> np.ndarray:
    """Depths in float64, moved by `push`, with a frame of nothing around."""
    return _framed(rgbd.depth_mm, rgbd.covered, push)


def _framed(depth_mm: np.ndarray, covered: np.ndarray, push: float) -> np.ndarray:
    depth = np.where(covered, depth_mm.astype(float) + push, -np.inf)
    return np.pad(depth, 1, constant_values=-np.inf)


def _hits(
    down: tuple,
    across: tuple,
    fronts: np.ndarray,
    backs: np.ndarray,
    shape: tuple[int, int],
    low: float,
    high: float,
) -> np.ndarray:
    ends = np.broadcast_to([high, low], (len(down[0]), 2))
    met = [_crossings(start, slope, low, high) for start, slope in (down, across)]
    z = np.concatenate([ends, *met], axis=1)
    z = -np.sort(-z, axis=1)
    top, end = z[:, :-1], z[:, 1:]
    middle = top / 2 + end / 2
    r = cell_of(down[0][:, None] + down[1][:, None] * middle, shape[0])
    c = cell_of(across[0][:, None] + across[1][:, None] * middle, shape[1])
    # A ray comes from in front of everything: its first cell it has always been in.
    entry = np.where(top >= high, np.inf, top)
    reached = (fronts[:, r + 1, c + 1] >= end) & (backs[:, r + 1, c + 1] <= entry)
    hit = reached.any(axis=0) & (top > end)
    first, each = np.argmax(hit, axis=1), np.arange(len(hit))
    layer = np.argmax(reached[:, each, first], axis=0)
    source: np.ndarray = (layer * shape[0] + r[each, first]) * shape[1] + c[each, first]
    return np.where(hit.any(axis=1), source, HOLE)


def cell_of(place: np.ndarray, cells: int) -> np.ndarray:
    """Cell of a place; -1 or `cells` outside, where the frame is."""
    cell: np.ndarray = np.clip(np.floor(place), -1, cells).astype(np.int64)
    return cell


def _crossings(start: np.ndarray, slope: np.ndarray, low: float, high: float) -> np.ndarray:
    """Depths at which rays meet cell borders, (rays, most crossings), padded with `high`."""
    ends = np.stack([start + slope * low, start + slope * high])
    first, last = np.floor(ends.min(axis=0)), np.ceil(ends.max(axis=0))
    border = first[:, None] + np.arange(int((last - first).max(initial=0)) + 1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        z = (border - start[:, None]) / slope[:, None]
    return np.where((z > low) & (z < high), z, high)


def exact_hits(rays: Rays, rgbd: RGBD, display: Display, which: np.ndarray) -> np.ndarray:
    """Sources of the rays numbered `which`, in fractions: no rounding, ties by the definition.

    A cell counts when the ray spends a stretch of depth in it, not when it touches it in a point; a
    ray along a border is in the cell of the larger row or column.
    """
    low, high = map(Fraction, display.depth_range_mm)
    layers = layers_of(rgbd)
    return np.array([_exact_hit(rays.line(int(i)), layers, low, high) for i in which], np.int64)


def _exact_hit(line: Line, layers: tuple[Layer, ...], low: Fraction, high: Fraction) -> int:
    rows, columns = layers[0].covered.shape
    for entry, end, r, c in _spans(line, low, high):
        if not (0 <= r < rows and 0 <= c < columns):
            continue
        for number, layer in enumerate(layers):
            if not layer.covered[r, c] or float(layer.front_mm[r, c]) < end:
                continue
            if entry is None or float(layer.back_mm[r, c]) <= entry:
                return int((number * rows + r) * columns + c)
    return HOLE


def _spans(
    line: Line, low: Fraction, high: Fraction
) -> Iterator[tuple[Fraction | None, Fraction, int, int]]:
    """Depth at which a ray enters a cell, None in front of all, and leaves it; row and column."""
    v0, dv, u0, du = line
    ends = sorted({low, high, *_meets(v0, dv, low, high), *_meets(u0, du, low, high)}, reverse=True)
    for top, end in pairwise(ends):
        middle = (top + end) / 2
        entry = None if top == high else top
        yield entry, end, math.floor(v0 + dv * middle), math.floor(u0 + du * middle)


def _meets(start: Fraction, slope: Fraction, low: Fraction, high: Fraction) -> list[Fraction]:
    """Depths strictly inside the range at which a ray meets borders."""
    if slope == 0:
        return []
    a, b = sorted((start + slope * low, start + slope * high))
    return [(k - start) / slope for k in range(math.floor(a) + 1, math.ceil(b))]
