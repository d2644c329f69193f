"""Oracles of the generators: their definitions in float64 NumPy, and fractions where ties are.

Written from the generators' docstrings, not from their kernels, and by other methods: where a
kernel walks from cell to cell, an oracle gathers all border crossings and sorts them; where a
kernel keeps the best so far, an oracle lists all candidates and takes the least.

Every oracle answers for a list of panel pixels, and says for which of them the answer hangs on
rounding: those that change when coordinates and depths move by a *band*, the error that arithmetic
of some type may make. Such pixels are called uncertain. Of first hits, which `template` and
`layered` show, `with_rational_ties` decides them by `inim.generators.oracle`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache, partial
from typing import Any

import numpy as np

from inim.display import Display
from inim.display.pixels import exact_length
from inim.generators import HOLE
from inim.generators.oracle import column_layers, first_hits_of
from inim.generators.registry import properties
from inim.image.rgbd import RGBD
from reports.stress.study.rays import Rays, band_of

# Numbers in the largest array an oracle makes at once.
_CHUNK = 2_000_000
# More pixels than this are not decided by fractions: only where rounding would decide.
_MOST_EXACT = 400
# Roundings in the number of an entry of a template.
_ROUNDINGS = 4
# Shifts of (columns, rows, depths) in bands: the corners of a cube.
_PUSHES = [(a, b, c) for a in (-1.0, 1.0) for b in (-1.0, 1.0) for c in (-1.0, 1.0)]
_STILL = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Answer:
    """What an oracle says of some pixels.

    Attributes
    ----------
    sources : (n,) int64
        ``row * W + column``, or `HOLE`.
    uncertain : (n,) bool
        Whether rounding of the given type decides.
    """

    sources: np.ndarray
    uncertain: np.ndarray


_Find = Callable[[Rays, RGBD, Display, tuple[Any, Any, Any]], np.ndarray]


def answer(algorithm: str, rays: Rays, rgbd: RGBD, display: Display, dtype: type) -> Answer:
    """What the definition of an algorithm says, and where rounding in a type may say otherwise.

    Parameters
    ----------
    algorithm : str
        "template", "template:columns=solid", "layered", "gu2020", "wang2024",
        "wang2024:matching=ray" or "li2012".
    rays : Rays
    rgbd : RGBD
    display : Display
    dtype : float type
    """
    find = _ORACLES[algorithm]
    band = band_of(rays, display, dtype)
    sources = find(rays, rgbd, display, _STILL)
    uncertain = rays.doubtful.copy()
    for a, b, c in _PUSHES:
        pushed = find(rays, rgbd, display, (a * band[0], b * band[1], c * band[2]))
        uncertain |= pushed != sources
    near = _CLOSE_CALLS.get(algorithm)
    if near is not None:
        uncertain |= near(rays, rgbd, display, band)
    return Answer(sources, uncertain)


# -- first hits ---------------------------------------------------------------------------------


def exact_first_hits(
    rays: Rays, rgbd: RGBD, display: Display, which: np.ndarray, columns: str = "surface"
) -> np.ndarray:
    """Sources of the rays numbered `which`, in fractions; `columns` as of `column_layers`."""
    return first_hits_of((rays.line(int(i)) for i in which), rgbd, display, columns)


def with_rational_ties(
    algorithm: str,
    known: Answer,
    algorithm_output: np.ndarray,
    rays: Rays,
    rgbd: RGBD,
    display: Display,
) -> tuple[np.ndarray, int]:
    """First hits, by fractions wherever float64 may have decided, or what is shown differs.

    Parameters
    ----------
    algorithm : str
        As of `answer`; one of first hits.
    known : Answer
        Of the float64 oracle, for arithmetic in float64.
    shown : (n,) int64
        A generator's sources.

    Returns
    -------
    (n,) int64, and how many are exact
    """
    differ = np.flatnonzero(algorithm_output != known.sources)
    doubt = np.flatnonzero(known.uncertain | (algorithm_output != known.sources))
    step = max(1, len(doubt) // _MOST_EXACT)
    which = np.unique(np.concatenate([doubt[::step], differ]))
    sources = known.sources.copy()
    sources[which] = exact_first_hits(rays, rgbd, display, which, properties(algorithm).columns)
    return sources, len(which)


def first_hits(
    rays: Rays, rgbd: RGBD, display: Display, push: tuple = _STILL, columns: str = "surface"
) -> np.ndarray:
    """The source of each ray, in float64; each interval's cell is that of its midpoint.

    Parameters
    ----------
    rays : Rays
    rgbd : RGBD
    display : Display
    push : (columns, rows, depths)
        By how much coordinates (cells) and depths (mm) are off.
    columns : str
        See `inim.generators.oracle.column_layers`.

    Returns
    -------
    (n,) int64
        ``(layer * H + row) * W + column``, or `HOLE`.
    """
    return _followed(rays, rgbd, display, push, columns)[0]


def _lost(rays: Rays, rgbd: RGBD, display: Display, band: tuple) -> np.ndarray:  # noqa: ARG001
    """Rays that met nothing behind a column.

    What they show may hang on a cell that is visited for no depth at all, at a corner: moved by a
    band to any side, all such rays visit one.
    """
    return _followed(rays, rgbd, display, _STILL, "surface")[1]


def _followed(
    rays: Rays, rgbd: RGBD, display: Display, push: tuple, columns: str
) -> tuple[np.ndarray, np.ndarray]:
    """Sources, and which rays passed behind a column and met nothing."""
    low, high = display.depth_range_mm
    layers, continues = column_layers(rgbd, columns)
    fronts = np.stack([framed(layer.front_mm, layer.covered, push[2]) for layer in layers])
    backs = np.stack([framed(layer.back_mm, layer.covered, push[2]) for layer in layers])
    v0, u0 = rays.v0 + push[1], rays.u0 + push[0]
    found, lost = np.empty(len(u0), np.int64), np.empty(len(u0), bool)
    reach = np.abs([rays.du, rays.dv]).max(initial=0) * (high - low)
    step = max(1, int(_CHUNK // (len(fronts) * (2 * reach + 6))))
    for begin in range(0, len(u0), step):
        part = slice(begin, begin + step)
        down, across = (v0[part], rays.dv[part]), (u0[part], rays.du[part])
        found[part], lost[part] = _hits(
            down, across, fronts, backs, continues, rgbd.shape, low, high
        )
    return found, lost


def framed(depth_mm: np.ndarray, covered: np.ndarray, push: float) -> np.ndarray:
    """Depths in float64, moved by `push`, with a frame of nothing around."""
    depth = np.where(covered, depth_mm.astype(float) + push, -np.inf)
    return np.pad(depth, 1, constant_values=-np.inf)


def _hits(
    down: tuple,
    across: tuple,
    fronts: np.ndarray,
    backs: np.ndarray,
    continues: bool,
    shape: tuple[int, int],
    low: float,
    high: float,
) -> tuple[np.ndarray, np.ndarray]:
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
    # Of rays that passed behind something and met nothing: the last cell that they passed over.
    inside = (r >= 0) & (r < shape[0]) & (c >= 0) & (c < shape[1]) & (top > end)
    over = inside & (fronts[0, r + 1, c + 1] < end)
    lost = continues & (inside & ~over).any(axis=1) & ~hit.any(axis=1)
    last = over.shape[1] - 1 - np.argmax(over[:, ::-1], axis=1)
    algorithm_output = lost & over.any(axis=1) & np.isfinite(fronts[0, r + 1, c + 1][each, last])
    passed = np.where(algorithm_output, r[each, last] * shape[1] + c[each, last], HOLE)
    return np.where(hit.any(axis=1), source, passed), lost


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


# -- gu2020 -------------------------------------------------------------------------------------


def _gu2020(rays: Rays, rgbd: RGBD, display: Display, push: tuple) -> np.ndarray:
    """The first of the depths z_max, z_max - P_I, ..., z_min at which the surface is as near."""
    low, high = map(Fraction, display.depth_range_mm)
    f, g = exact_length(display.focal_length_mm), exact_length(display.gap_mm)
    # P_I = |D| P_D / g with D = f g / (g - f); a picture pixel where that is infinite.
    step = (
        exact_length(rgbd.pixel_mm)
        if display.gap_mm == display.focal_length_mm
        else abs(f / (g - f)) * exact_length(display.pixel_pitch_mm)
    )
    depths = _stepped(low, high, step)
    depth = framed(rgbd.depth_mm, rgbd.covered, push[2])
    v0, u0 = rays.v0 + push[1], rays.u0 + push[0]
    found = np.empty(len(u0), np.int64)
    chunk = max(1, _CHUNK // len(depths))
    for begin in range(0, len(u0), chunk):
        part = slice(begin, begin + chunk)
        r = cell_of(v0[part, None] + rays.dv[part, None] * depths, rgbd.shape[0])
        c = cell_of(u0[part, None] + rays.du[part, None] * depths, rgbd.shape[1])
        hit = depth[r + 1, c + 1] >= depths
        first, each = np.argmax(hit, axis=1), np.arange(len(hit))
        source = r[each, first] * rgbd.shape[1] + c[each, first]
        found[part] = np.where(hit.any(axis=1), source, HOLE)
    return found


@lru_cache(maxsize=4)
def _stepped(low: Fraction, high: Fraction, step: Fraction) -> np.ndarray:
    """From `high` down to `low`, the last step cut short; each depth rounded once."""
    scale = math.lcm(high.denominator, step.denominator)
    top, by = int(high * scale), int(step * scale)
    count = math.ceil((high - low) / step)
    return np.array([(top - k * by) / scale for k in range(count)] + [float(low)])


# -- wang2024 -----------------------------------------------------------------------------------


def _mismatches(
    rays: Rays, rgbd: RGBD, display: Display, push: tuple, i: int, along_ray: bool
) -> tuple[np.ndarray, np.ndarray, float]:
    """|depth - z| of every entry of one pixel's template, its source, and the step of Eq. 5."""
    low, high = display.depth_range_mm
    middle = display.central_depth_mm
    single = middle if low <= middle <= high else (low + high) / 2
    travel = max(abs(rays.du[i]), abs(rays.dv[i]))
    # The push says too to which whole number z_len is rounded.
    sign = np.sign(push[2])
    reach = travel * (high - low) * (1 + _ROUNDINGS * sign * _relative(push[2], display))
    if reach < 0.5:
        step, z = high - low, np.array([single])
    else:
        step = 1 / travel
        z = low + step * np.arange(math.floor(reach + 0.5) + 1)
    at = (push[0][i], push[1][i]) if np.ndim(push[0]) else (0.0, 0.0)
    v = np.floor(rays.v0[i] + at[1] + rays.dv[i] * z)
    u = np.floor(rays.u0[i] + at[0] + rays.du[i] * z)
    if not along_ray:
        v, u = np.broadcast_arrays(v[:, None], u[None, :])
        z = np.broadcast_to(z[:, None], v.shape)
    rows, columns = rgbd.shape
    inside = (v >= 0) & (v < rows) & (u >= 0) & (u < columns)
    r, c = np.where(inside, v, 0).astype(int), np.where(inside, u, 0).astype(int)
    depth = rgbd.depth_mm[r, c].astype(float) + push[2]
    off = np.where(inside & rgbd.covered[r, c], np.abs(depth - z), np.inf)
    return off.ravel(), (r * columns + c).ravel(), step


def _relative(push: float, display: Display) -> float:
    return abs(push) / max(map(abs, display.depth_range_mm))


def _wang(along_ray: bool) -> _Find:
    """Eq. 7 to 10: of all entries of the template the nearest to its surface, if within a step."""

    def find(rays: Rays, rgbd: RGBD, display: Display, push: tuple) -> np.ndarray:
        found = np.empty(len(rays.u0), np.int64)
        for i in range(len(found)):
            off, source, step = _mismatches(rays, rgbd, display, push, i, along_ray)
            best = int(np.argmin(off))
            found[i] = source[best] if off[best] < step else HOLE
        return found

    return find


def _wang_close(along_ray: bool) -> Callable[[Rays, RGBD, Display, tuple], np.ndarray]:
    """Pixels whose best match beats another source, or the limit, by less than the band.

    Steps are of one cell, so where one entry lies on a border all do, and in arithmetic each goes
    to its own side: every entry is asked for in all the cells that it may fall into.
    """

    def close(rays: Rays, rgbd: RGBD, display: Display, band: tuple) -> np.ndarray:
        found = np.empty(len(rays.u0), bool)
        nudges = [(a * band[0], b * band[1], 0.0) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]
        for i in range(len(found)):
            off, source, step = _mismatches(rays, rgbd, display, _STILL, i, along_ray)
            best = int(np.argmin(off))
            moved = [_mismatches(rays, rgbd, display, push, i, along_ray) for push in nudges]
            offs = np.stack([off, *(m[0] for m in moved)])
            sources = np.stack([source, *(m[1] for m in moved)])
            # Some entry is at most so far off, wherever entries fall.
            surely = float(offs.max(axis=0).min())
            bound = min(surely, step) + 4 * band[2]
            # Entries of one depth and one surface depth tie exactly, in any arithmetic.
            rivals = (offs <= bound) & (sources != source[best]) & (offs != off[best])
            at_limit = float(offs.min()) < step + 4 * band[2] and surely >= step - 4 * band[2]
            found[i] = bool(rivals.any()) or at_limit
        return found

    return close


# -- li2012 -------------------------------------------------------------------------------------


def _landings(
    rays: Rays, rgbd: RGBD, display: Display, push: tuple
) -> tuple[list[np.ndarray], list[tuple[np.ndarray, ...]]]:
    """For each pixel, the picture pixels that land on it, and the keys by which one is kept.

    Keys, the least first: -z, distance^2 from the panel pixel's centre, distance from the vertical
    axis, from the horizontal one.
    """
    rows, columns = np.nonzero(rgbd.covered & (rgbd.depth_mm != 0))
    z = rgbd.depth_mm[rows, columns].astype(float)
    high, wide = display.eia_shape
    found: list[np.ndarray] = []
    keys: list[tuple[np.ndarray, ...]] = []
    lens_v, lens_u = rays.rows.lens, rays.columns.lens
    shift = [np.median(p) if np.ndim(p) else 0.0 for p in push[:2]]
    placed: dict[tuple[int, int], tuple] = {}
    for row, column in rays.pixels:
        m, n = lens_v[row], lens_u[column]
        if (m, n) not in placed:
            across = (n, display.lens_columns, display.pitch_mm, display.shift_x_mm)
            down = (m, display.lens_rows, display.row_pitch_mm, -display.shift_y_mm)
            x = _landing(display, across, columns, rgbd.shape[1], rgbd, z)
            y = _landing(display, down, rows, rgbd.shape[0], rgbd, z)
            x, y = x + shift[0], y + shift[1]
            placed[m, n] = (x, y, _panel_pixel(x, wide), _panel_pixel(y, high))
        x, y, i, j = placed[m, n]
        here = np.flatnonzero((i == column) & (j == row))
        dx, dy = x[here] - (column - (wide - 1) / 2), y[here] - (row - (high - 1) / 2)
        pixel_offset = np.abs(2 * columns[here] + 1 - rgbd.shape[1])
        above = np.abs(2 * rows[here] + 1 - rgbd.shape[0])
        found.append(rows[here] * rgbd.shape[1] + columns[here])
        keys.append((-z[here], dx * dx + dy * dy, pixel_offset, above))
    return found, keys


def _landing(
    display: Display,
    lens: tuple[int, int, float, float],
    cell: np.ndarray,
    cells: int,
    rgbd: RGBD,
    z: np.ndarray,
) -> np.ndarray:
    """X = x0 + (x0 - X) g / z in panel pixels from the panel's middle.

    `lens` is the lens's number, how many there are, their pitch and the array's shift.
    """
    pixel = exact_length(display.pixel_pitch_mm)
    number, lenses, pitch, shift = lens
    centre = Fraction(2 * number + 1 - lenses, 2) * exact_length(pitch) + exact_length(shift)
    x0 = float(centre / pixel)
    X = (2 * cell + 1 - cells) / 2 * float(exact_length(rgbd.pixel_mm) / pixel)
    place: np.ndarray = x0 + (x0 - X) * float(exact_length(display.gap_mm)) / z
    return place


def _panel_pixel(place: np.ndarray, pixels: int) -> np.ndarray:
    """Panel pixel that holds a place; a border belongs to the pixel nearer the axis."""
    right = np.ceil(place + pixels / 2) - 1
    left = np.floor(place + pixels / 2)
    return np.where(place > 0, right, np.where(place < 0, left, (pixels - 1) // 2))


def _li2012(rays: Rays, rgbd: RGBD, display: Display, push: tuple) -> np.ndarray:
    """Of the picture pixels that land on a panel pixel the nearest to the viewer."""
    found, keys = _landings(rays, rgbd, display, _in_panel_pixels(push, display))
    return np.array(
        [s[np.lexsort(k[::-1])[0]] if len(s) else HOLE for s, k in zip(found, keys, strict=True)],
        np.int64,
    )


def _in_panel_pixels(push: tuple, display: Display) -> tuple:
    """A push of landing points instead of coordinates: as many roundings, of panel pixels."""
    if not np.ndim(push[0]):
        return _STILL
    unit = abs(push[2]) / max(map(abs, display.depth_range_mm))
    high, wide = display.eia_shape
    return unit * 2 * wide * np.sign(push[0]), unit * 2 * high * np.sign(push[1]), 0.0


def _li_close(rays: Rays, rgbd: RGBD, display: Display, band: tuple) -> np.ndarray:
    """Pixels on which two points of one depth land almost equally far from the centre."""
    unit = band[2] / max(map(abs, display.depth_range_mm)) * 4 * max(display.eia_shape)
    close = np.zeros(len(rays.u0), bool)
    _, keys = _landings(rays, rgbd, display, _STILL)
    for i, (nearness, off, *_) in enumerate(keys):
        foremost = np.sort(off[nearness == nearness.min(initial=np.inf)])
        close[i] = len(foremost) > 1 and foremost[1] - foremost[0] <= unit
    return close


_ORACLES: dict[str, _Find] = {
    "template": first_hits,
    "template:columns=solid": partial(first_hits, columns="solid"),
    "layered": partial(first_hits, columns="layers"),
    "gu2020": _gu2020,
    "wang2024": _wang(along_ray=False),
    "wang2024:matching=ray": _wang(along_ray=True),
    "li2012": _li2012,
}
_CLOSE_CALLS = {
    "template": _lost,
    "wang2024": _wang_close(along_ray=False),
    "wang2024:matching=ray": _wang_close(along_ray=True),
    "li2012": _li_close,
}
