"""Oracles of the generators: their definitions in float64 NumPy, and fractions for ties.

The oracles are written from the generators' docstrings and use other methods. A kernel walks from
cell to cell; an oracle collects and sorts all border crossings. A kernel updates the best match; an
oracle lists all candidates and selects the minimum.

An oracle returns the sources of a list of panel pixels and marks uncertain ones, which rounding may
decide: those that change when coordinates and depths move by a *band*, the rounding error of a
type. For the first hits of `template` and `layered`, `with_rational_ties` decides these pixels by
`inim.generators.oracle`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache, partial
from typing import Any

import numpy as np

from inim.apps.stress.oracles.rays import Rays, band_of
from inim.display import Display
from inim.display.pixels import exact_length
from inim.generators import HOLE, parse_algorithm
from inim.generators.oracle import column_layers, first_hits_of
from inim.image.rgbd import RGBD

# Largest number of elements of a temporary array.
_CHUNK = 2_000_000
# Approximate number of uncertain pixels of which fractions decide; the others stay uncertain.
_MAX_EXACT = 400
# Rounding errors of the number of a template's entry.
_ROUNDINGS = 4
# Shifts of (columns, rows, depths) in bands: the corners of a cube.
_SHIFTS = [(a, b, c) for a in (-1.0, 1.0) for b in (-1.0, 1.0) for c in (-1.0, 1.0)]
_NO_SHIFT = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Answer:
    """An oracle's sources of panel pixels.

    Attributes
    ----------
    sources : (n,) int64
        ``row * W + column``, or `HOLE`.
    uncertain : (n,) bool
        True if rounding in the type may decide.
    """

    sources: np.ndarray
    uncertain: np.ndarray


_Find = Callable[[Rays, RGBD, Display, tuple[Any, Any, Any]], np.ndarray]


def answer(algorithm: str, rays: Rays, rgbd: RGBD, display: Display, dtype: type) -> Answer:
    """Sources by the definition of an algorithm, with those that rounding in a type may change.

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
    sources = find(rays, rgbd, display, _NO_SHIFT)
    uncertain = rays.doubtful.copy()
    for a, b, c in _SHIFTS:
        shifted = find(rays, rgbd, display, (a * band[0], b * band[1], c * band[2]))
        uncertain |= shifted != sources
    close_calls = _CLOSE_CALLS.get(algorithm)
    if close_calls is not None:
        uncertain |= close_calls(rays, rgbd, display, band)
    return Answer(sources, uncertain)


# -- first hits ---------------------------------------------------------------------------------


def exact_first_hits(
    rays: Rays, rgbd: RGBD, display: Display, indices: np.ndarray, columns: str = "surface"
) -> np.ndarray:
    """Sources of the rays with these indices, in fractions; `columns` as in `column_layers`."""
    return first_hits_of((rays.line(int(i)) for i in indices), rgbd, display, columns)


def with_rational_ties(
    algorithm: str,
    float64_answer: Answer,
    algorithm_sources: np.ndarray,
    rays: Rays,
    rgbd: RGBD,
    display: Display,
) -> tuple[np.ndarray, int]:
    """First hits, by fractions for uncertain pixels and for pixels that differ from the algorithm.

    Parameters
    ----------
    algorithm : str
        As in `answer`, with first hits.
    float64_answer : Answer
        Answer of the float64 oracle for arithmetic in float64.
    algorithm_sources : (n,) int64
        Sources of the tested generator.

    Returns
    -------
    (n,) int64, and the number of exact ones
    """
    differ = np.flatnonzero(algorithm_sources != float64_answer.sources)
    doubtful = np.union1d(np.flatnonzero(float64_answer.uncertain), differ)
    step = max(1, len(doubtful) // _MAX_EXACT)
    indices = np.union1d(doubtful[::step], differ)
    sources = float64_answer.sources.copy()
    sources[indices] = exact_first_hits(
        rays, rgbd, display, indices, parse_algorithm(algorithm).columns
    )
    return sources, len(indices)


def first_hits(
    rays: Rays, rgbd: RGBD, display: Display, shift: tuple = _NO_SHIFT, columns: str = "surface"
) -> np.ndarray:
    """Source of each ray in float64; the cell of an interval is that of its midpoint.

    Parameters
    ----------
    rays : Rays
    rgbd : RGBD
    display : Display
    shift : (columns, rows, depths)
        Shifts of coordinates (cells) and depths (mm).
    columns : str
        See `inim.generators.oracle.column_layers`.

    Returns
    -------
    (n,) int64
        ``(layer * H + row) * W + column``, or `HOLE`.
    """
    return _trace(rays, rgbd, display, shift, columns)[0]


def _lost(rays: Rays, rgbd: RGBD, display: Display, band: tuple) -> np.ndarray:  # noqa: ARG001
    """Rays that pass behind a column and miss all others.

    Their source may depend on a cell that they touch in a single point, at a corner.
    """
    return _trace(rays, rgbd, display, _NO_SHIFT, "surface")[1]


def _trace(
    rays: Rays, rgbd: RGBD, display: Display, shift: tuple, columns: str
) -> tuple[np.ndarray, np.ndarray]:
    """Sources, and True for rays that pass behind a column and miss all others."""
    low, high = display.depth_range_mm
    layers, continues = column_layers(rgbd, columns)
    fronts = np.stack([framed(layer.front_mm, layer.covered, shift[2]) for layer in layers])
    backs = np.stack([framed(layer.back_mm, layer.covered, shift[2]) for layer in layers])
    v0, u0 = rays.v0 + shift[1], rays.u0 + shift[0]
    sources, lost = np.empty(len(u0), np.int64), np.empty(len(u0), bool)
    reach = np.abs([rays.du, rays.dv]).max(initial=0) * (high - low)
    step = max(1, int(_CHUNK // (len(fronts) * (2 * reach + 6))))
    for begin in range(0, len(u0), step):
        part = slice(begin, begin + step)
        row_rays, column_rays = (v0[part], rays.dv[part]), (u0[part], rays.du[part])
        sources[part], lost[part] = _hits(
            row_rays, column_rays, fronts, backs, continues, rgbd.shape, low, high
        )
    return sources, lost


def framed(depth_mm: np.ndarray, covered: np.ndarray, shift: float) -> np.ndarray:
    """Depths in float64, moved by `shift`, with a frame of empty cells."""
    depth = np.where(covered, depth_mm.astype(float) + shift, -np.inf)
    return np.pad(depth, 1, constant_values=-np.inf)


def _hits(
    row_rays: tuple,
    column_rays: tuple,
    fronts: np.ndarray,
    backs: np.ndarray,
    continues: bool,
    shape: tuple[int, int],
    low: float,
    high: float,
) -> tuple[np.ndarray, np.ndarray]:
    """First hits and lost rays, for (start, slope) of rays in rows and in columns."""
    ends = np.broadcast_to([high, low], (len(row_rays[0]), 2))
    crossings = [_crossings(start, slope, low, high) for start, slope in (row_rays, column_rays)]
    z = np.concatenate([ends, *crossings], axis=1)
    z = -np.sort(-z, axis=1)
    top, end = z[:, :-1], z[:, 1:]
    middle = top / 2 + end / 2
    r = cell_of(row_rays[0][:, None] + row_rays[1][:, None] * middle, shape[0])
    c = cell_of(column_rays[0][:, None] + column_rays[1][:, None] * middle, shape[1])
    # A ray starts in front of all surfaces, in its first cell.
    entry = np.where(top >= high, np.inf, top)
    reached = (fronts[:, r + 1, c + 1] >= end) & (backs[:, r + 1, c + 1] <= entry)
    hit = reached.any(axis=0) & (top > end)
    first, ray = np.argmax(hit, axis=1), np.arange(len(hit))
    layer = np.argmax(reached[:, ray, first], axis=0)
    source: np.ndarray = (layer * shape[0] + r[ray, first]) * shape[1] + c[ray, first]
    # A lost ray shows the last cell whose column it passed over.
    inside = (r >= 0) & (r < shape[0]) & (c >= 0) & (c < shape[1]) & (top > end)
    over = inside & (fronts[0, r + 1, c + 1] < end)
    lost = continues & (inside & ~over).any(axis=1) & ~hit.any(axis=1)
    last = over.shape[1] - 1 - np.argmax(over[:, ::-1], axis=1)
    is_over = lost & over.any(axis=1) & np.isfinite(fronts[0, r + 1, c + 1][ray, last])
    last_source = np.where(is_over, r[ray, last] * shape[1] + c[ray, last], HOLE)
    return np.where(hit.any(axis=1), source, last_source), lost


def cell_of(coordinate: np.ndarray, cells: int) -> np.ndarray:
    """Cell of a coordinate; -1 or `cells`, the frame, outside the picture."""
    cell: np.ndarray = np.clip(np.floor(coordinate), -1, cells).astype(np.int64)
    return cell


def _crossings(start: np.ndarray, slope: np.ndarray, low: float, high: float) -> np.ndarray:
    """Depths at which rays meet cell borders, (rays, crossings), padded with `high`."""
    ends = np.stack([start + slope * low, start + slope * high])
    first, last = np.floor(ends.min(axis=0)), np.ceil(ends.max(axis=0))
    border = first[:, None] + np.arange(int((last - first).max(initial=0)) + 1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        z = (border - start[:, None]) / slope[:, None]
    return np.where((z > low) & (z < high), z, high)


# -- gu2020 -------------------------------------------------------------------------------------


def _gu2020(rays: Rays, rgbd: RGBD, display: Display, shift: tuple) -> np.ndarray:
    """Sources at the first depth of z_max, z_max - P_I, ..., z_min that the surface reaches."""
    low, high = map(Fraction, display.depth_range_mm)
    f, g = exact_length(display.focal_length_mm), exact_length(display.gap_mm)
    # P_I = |D| P_D / g with D = f g / (g - f); the picture pixel if that is infinite.
    step = (
        exact_length(rgbd.pixel_mm)
        if math.isinf(display.scene_pixel_mm)
        else abs(f / (g - f)) * exact_length(display.pixel_pitch_mm)
    )
    depths = _stepped_depths(low, high, step)
    depth = framed(rgbd.depth_mm, rgbd.covered, shift[2])
    v0, u0 = rays.v0 + shift[1], rays.u0 + shift[0]
    sources = np.empty(len(u0), np.int64)
    chunk = max(1, _CHUNK // len(depths))
    for begin in range(0, len(u0), chunk):
        part = slice(begin, begin + chunk)
        r = cell_of(v0[part, None] + rays.dv[part, None] * depths, rgbd.shape[0])
        c = cell_of(u0[part, None] + rays.du[part, None] * depths, rgbd.shape[1])
        hit = depth[r + 1, c + 1] >= depths
        first, ray = np.argmax(hit, axis=1), np.arange(len(hit))
        source = r[ray, first] * rgbd.shape[1] + c[ray, first]
        sources[part] = np.where(hit.any(axis=1), source, HOLE)
    return sources


@lru_cache(maxsize=4)
def _stepped_depths(low: Fraction, high: Fraction, step: Fraction) -> np.ndarray:
    """Depths from `high` down to `low`, with a shorter last step; each is rounded once."""
    scale = math.lcm(high.denominator, step.denominator)
    top, by = int(high * scale), int(step * scale)
    count = math.ceil((high - low) / step)
    return np.array([(top - k * by) / scale for k in range(count)] + [float(low)])


# -- wang2024 -----------------------------------------------------------------------------------


def _mismatches(
    rays: Rays, rgbd: RGBD, display: Display, shift: tuple, i: int, along_ray: bool
) -> tuple[np.ndarray, np.ndarray, float]:
    """|depth - z| and source of each entry of a pixel's template, and the step of Eq. 5."""
    low, high = display.depth_range_mm
    middle = display.central_depth_mm
    single = middle if low <= middle <= high else (low + high) / 2
    travel = max(abs(rays.du[i]), abs(rays.dv[i]))
    # The shift also decides to which integer z_len is rounded.
    sign = np.sign(shift[2])
    reach = travel * (high - low) * (1 + _ROUNDINGS * sign * _relative(shift[2], display))
    if reach < 0.5:
        step, z = high - low, np.array([single])
    else:
        step = 1 / travel
        z = low + step * np.arange(math.floor(reach + 0.5) + 1)
    shift_u, shift_v = (shift[0][i], shift[1][i]) if np.ndim(shift[0]) else (0.0, 0.0)
    v = np.floor(rays.v0[i] + shift_v + rays.dv[i] * z)
    u = np.floor(rays.u0[i] + shift_u + rays.du[i] * z)
    if not along_ray:
        v, u = np.broadcast_arrays(v[:, None], u[None, :])
        z = np.broadcast_to(z[:, None], v.shape)
    rows, columns = rgbd.shape
    inside = (v >= 0) & (v < rows) & (u >= 0) & (u < columns)
    r, c = np.where(inside, v, 0).astype(int), np.where(inside, u, 0).astype(int)
    depth = rgbd.depth_mm[r, c].astype(float) + shift[2]
    mismatch = np.where(inside & rgbd.covered[r, c], np.abs(depth - z), np.inf)
    return mismatch.ravel(), (r * columns + c).ravel(), step


def _relative(shift: float, display: Display) -> float:
    return abs(shift) / max(map(abs, display.depth_range_mm))


def _wang(along_ray: bool) -> _Find:
    """Oracle of Eq. 7 to 10: the template entry nearest to its surface, if within a step."""

    def find(rays: Rays, rgbd: RGBD, display: Display, shift: tuple) -> np.ndarray:
        sources = np.empty(len(rays.u0), np.int64)
        for i in range(len(sources)):
            mismatch, source, step = _mismatches(rays, rgbd, display, shift, i, along_ray)
            best = int(np.argmin(mismatch))
            sources[i] = source[best] if mismatch[best] < step else HOLE
        return sources

    return find


def _wang_close(along_ray: bool) -> Callable[[Rays, RGBD, Display, tuple], np.ndarray]:
    """Pixels whose best match is better than another, or than the limit, by less than the band.

    Steps are one cell long. If one entry is on a cell border, all are, and rounding decides for
    each of them separately. Therefore all cells that an entry may fall into are tested.
    """

    def close_calls(rays: Rays, rgbd: RGBD, display: Display, band: tuple) -> np.ndarray:
        is_close = np.empty(len(rays.u0), bool)
        shifts = [(a * band[0], b * band[1], 0.0) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]
        for i in range(len(is_close)):
            mismatch, source, step = _mismatches(rays, rgbd, display, _NO_SHIFT, i, along_ray)
            best = int(np.argmin(mismatch))
            moved = [_mismatches(rays, rgbd, display, shift, i, along_ray) for shift in shifts]
            mismatches = np.stack([mismatch, *(m[0] for m in moved)])
            sources = np.stack([source, *(m[1] for m in moved)])
            # Upper bound of the best mismatch, in whichever cells the entries fall.
            upper = float(mismatches.max(axis=0).min())
            bound = min(upper, step) + 4 * band[2]
            # Entries with equal depth and equal surface depth tie exactly in any arithmetic.
            rivals = (
                (mismatches <= bound) & (sources != source[best]) & (mismatches != mismatch[best])
            )
            lowest = float(mismatches.min())
            at_limit = lowest < step + 4 * band[2] and upper >= step - 4 * band[2]
            is_close[i] = bool(rivals.any()) or at_limit
        return is_close

    return close_calls


# -- li2012 -------------------------------------------------------------------------------------


def _landings(
    rays: Rays, rgbd: RGBD, display: Display, shift: tuple
) -> tuple[list[np.ndarray], list[tuple[np.ndarray, ...]]]:
    """Picture pixels that land on each panel pixel, and the keys that decide between them.

    The smallest key wins, in this order: -z, squared distance from the panel pixel's centre,
    distance from the vertical axis, distance from the horizontal axis.
    """
    rows, columns = np.nonzero(rgbd.covered & (rgbd.depth_mm != 0))
    z = rgbd.depth_mm[rows, columns].astype(float)
    high, wide = display.eia_shape
    sources: list[np.ndarray] = []
    keys: list[tuple[np.ndarray, ...]] = []
    lens_v, lens_u = rays.rows.lens, rays.columns.lens
    shift_x, shift_y = (np.median(p) if np.ndim(p) else 0.0 for p in shift[:2])
    landings: dict[tuple[int, int], tuple] = {}
    for row, column in rays.pixels:
        m, n = lens_v[row], lens_u[column]
        if (m, n) not in landings:
            lens_x = (n, display.lens_columns, display.pitch_mm, display.shift_x_mm)
            lens_y = (m, display.lens_rows, display.row_pitch_mm, -display.shift_y_mm)
            x = _landing(display, lens_x, columns, rgbd.shape[1], rgbd, z) + shift_x
            y = _landing(display, lens_y, rows, rgbd.shape[0], rgbd, z) + shift_y
            landings[m, n] = (x, y, _panel_pixel(x, wide), _panel_pixel(y, high))
        x, y, i, j = landings[m, n]
        here = np.flatnonzero((i == column) & (j == row))
        dx, dy = x[here] - (column - (wide - 1) / 2), y[here] - (row - (high - 1) / 2)
        from_vertical = np.abs(2 * columns[here] + 1 - rgbd.shape[1])
        from_horizontal = np.abs(2 * rows[here] + 1 - rgbd.shape[0])
        sources.append(rows[here] * rgbd.shape[1] + columns[here])
        keys.append((-z[here], dx * dx + dy * dy, from_vertical, from_horizontal))
    return sources, keys


def _landing(
    display: Display,
    lens: tuple[int, int, float, float],
    cell: np.ndarray,
    cells: int,
    rgbd: RGBD,
    z: np.ndarray,
) -> np.ndarray:
    """Landing points x0 + (x0 - X) g / z, in panel pixels from the panel's middle.

    `lens` contains the lens number, the number of lenses, their pitch and the array's shift.
    """
    pixel = exact_length(display.pixel_pitch_mm)
    number, lenses, pitch, shift = lens
    centre = Fraction(2 * number + 1 - lenses, 2) * exact_length(pitch) + exact_length(shift)
    x0 = float(centre / pixel)
    X = (2 * cell + 1 - cells) / 2 * float(exact_length(rgbd.pixel_mm) / pixel)
    landing: np.ndarray = x0 + (x0 - X) * float(exact_length(display.gap_mm)) / z
    return landing


def _panel_pixel(landing: np.ndarray, pixels: int) -> np.ndarray:
    """Panel pixel of a landing point; a border belongs to the pixel nearer the axis."""
    right = np.ceil(landing + pixels / 2) - 1
    left = np.floor(landing + pixels / 2)
    return np.where(landing > 0, right, np.where(landing < 0, left, (pixels - 1) // 2))


def _li2012(rays: Rays, rgbd: RGBD, display: Display, shift: tuple) -> np.ndarray:
    """Sources that are nearest to the viewer among those landing on each panel pixel."""
    sources, keys = _landings(rays, rgbd, display, _in_panel_pixels(shift, display))
    return np.array(
        [s[np.lexsort(k[::-1])[0]] if len(s) else HOLE for s, k in zip(sources, keys, strict=True)],
        np.int64,
    )


def _in_panel_pixels(shift: tuple, display: Display) -> tuple:
    """Shift of landing points with the same number of rounding errors, in panel pixels."""
    if not np.ndim(shift[0]):
        return _NO_SHIFT
    unit = abs(shift[2]) / max(map(abs, display.depth_range_mm))
    high, wide = display.eia_shape
    return unit * 2 * wide * np.sign(shift[0]), unit * 2 * high * np.sign(shift[1]), 0.0


def _li_close(rays: Rays, rgbd: RGBD, display: Display, band: tuple) -> np.ndarray:
    """Pixels on which two points of equal depth land at almost equal distances from the centre."""
    unit = band[2] / max(map(abs, display.depth_range_mm)) * 4 * max(display.eia_shape)
    close = np.zeros(len(rays.u0), bool)
    _, keys = _landings(rays, rgbd, display, _NO_SHIFT)
    for i, (minus_z, distance, *_) in enumerate(keys):
        foremost = np.sort(distance[minus_z == minus_z.min(initial=np.inf)])
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
