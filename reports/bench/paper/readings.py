# Kernels have no types of their own.
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
"""Readings of Eq. 2 to 10 of the paper, as plain Python loops, NumPy matrices and compiled loops.

The pixels of one elemental image have local depth templates, which all lenses share. Each template
is matched with the picture under every lens. The loops are in the part of Python that both
interpreter and numba run; uncompiled they read lists. Gu et al. 2020, as the paper describes it,
has the same forms.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any, NamedTuple, cast

import numpy as np

from inim.display import Display
from inim.display.pixels import CENTRE, PixelOffset
from inim.generators.base import HOLE, Sources, run_kernel
from inim.generators.raycast.cells import cell_rays
from inim.image.rgbd import RGBD

_CORNER = PixelOffset(Fraction(-1, 2), Fraction(-1, 2))


class Reading(NamedTuple):
    """A reading of the print: the recommended one, with the deviations that are set."""

    from_corner: bool = (
        False  #: Eq. 2: panel pixel i is at i P_D from the corner, not at its centre
    )
    rounded: bool = False  #: Eq. 2: the nearest corner of a picture pixel, not the one hit
    scene_steps: bool = False  #: Eq. 5: P_I of Eq. 3 instead of the picture's pixel
    x_only: bool = False  #: Eq. 5: the offset along x instead of the larger one
    undefined: bool = False  #: Eq. 5: no source where it divides by zero
    up: bool = False  #: Eq. 6: z_len rounded up
    consecutive: bool = False  #: Eq. 7, 8: consecutive rows and columns, not those of the ray
    along_ray: bool = False  #: Eq. 7 to 10: the diagonal of the matrix only
    always: bool = False  #: Eq. 9, 10: the best match however far it is from the surface
    reverse: bool = False  #: Not a reading: the reverse search of Gu et al. 2020.


RECOMMENDED, STRICT = "recommended", "strict print"
_PLAIN = Reading()
#: Readings with a name.
READINGS = {
    STRICT: Reading(from_corner=True, rounded=True, x_only=True, consecutive=True, always=True),
    RECOMMENDED: _PLAIN,
    "along the ray": Reading(along_ray=True),
    "along the ray, steps of P_I": Reading(along_ray=True, scene_steps=True),
}
#: Algorithms of inim with the same sources as a reading.
ALGORITHMS = {
    RECOMMENDED: "wang2024",
    "along the ray": "wang2024:matching=ray",
    "along the ray, steps of P_I": "wang2024:matching=ray:step_pixel=scene",
}


class Search(NamedTuple):
    """Rays of the pixels under some lenses, in column ``u + du z`` and row ``v + dv z``, in cells.

    `u` and `v` belong to the lenses' columns and rows, `du` and `dv` to the pixels of a lens.
    """

    v: Any
    dv: Any
    u: Any
    du: Any
    z_min: float
    z_max: float
    single: float  #: Depth of a template with one entry.
    stride: float  #: Picture pixels of sideways travel per step.
    depths: Any  #: Samples of the reverse search.

    @classmethod
    def of(
        cls, display: Display, rgbd: RGBD, lenses: slice = slice(None), reading: Reading = _PLAIN
    ) -> Search:
        """Rays of a display with square lenses of whole pixels, in rows and columns `lenses`."""
        pixels, offset = display.eia_shape[0] // display.lens_rows, (CENTRE, _CORNER)
        axes = cell_rays(rgbd.shape, rgbd.pixel_mm, display, offset[reading.from_corner])
        u, v = (axis.in_cells[0][::pixels][lenses] + 0.5 * reading.rounded for axis in axes)
        du, dv = (axis.in_cells[1][:pixels] for axis in axes)
        (low, high), middle, p_i = (
            display.depth_range_mm, display.central_depth_mm, display.scene_pixel_mm
        )  # fmt: skip
        samples = high - p_i * np.arange(math.ceil(round((high - low) / p_i, 9)))
        stride = p_i / rgbd.pixel_mm if reading.scene_steps else 1.0
        return cls(v, dv, u, du, low, high, middle, stride, np.append(samples, low))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the panel pixels under these lenses."""
        return len(self.v) * len(self.dv), len(self.u) * len(self.du)


def surface_depth(rgbd: RGBD) -> np.ndarray:
    """Depths of a picture, (rows, columns) float64; uncovered pixels never match."""
    return np.where(rgbd.covered, rgbd.depth_mm.astype(np.float64), -np.inf)


def sources_of(reading: Reading, display: Display, rgbd: RGBD) -> Sources:
    """Sources of all panel pixels, by compiled loops."""
    rays, depth = Search.of(display, rgbd, reading=reading), surface_depth(rgbd)
    size = depth.shape
    return run_kernel(search_all, len(rays.dv), rays.shape, rays, depth, *size, reading)


def plain_python(rays: Search, depth: np.ndarray, reading: Reading) -> Callable[[], list[int]]:
    """Call that runs the loops in plain Python and returns the sources."""
    lists = with_lists(rays)
    size, lines, loops = math.prod(rays.shape), depth.tolist(), cast("Any", search_all)

    def run() -> list[int]:
        sources = [HOLE] * size
        loops(0, len(lists.dv), lists, lines, *depth.shape, reading, sources)
        return sources

    return run


def with_lists(arrays: Any) -> Any:
    """Named tuple with lists in the place of arrays."""
    return type(arrays)(*(v.tolist() if isinstance(v, np.ndarray) else v for v in arrays))


def search_all(begin, end, rays, depth, rows, columns, reading, sources):
    """Search for pixel rows `begin` to `end` of the elemental image, under every lens."""
    pixels, lenses = len(rays.du), len(rays.u)
    for a in range(begin, end):
        for b in range(pixels):
            du, dv = rays.du[b], rays.dv[a]
            start, step, z_len = _template(du, dv, rays, reading)
            limit = math.inf if reading.always else step
            us = [_cells(u, du, start, step, z_len, reading.consecutive) for u in rays.u]
            for m in range(len(rays.v)):
                vs = _cells(rays.v[m], dv, start, step, z_len, reading.consecutive)
                place = (m * len(rays.dv) + a) * lenses * pixels + b
                for n in range(lenses):
                    if reading.reverse:
                        source = _first_hit(
                            depth, rows, columns, rays.u[n], du, rays.v[m], dv, rays.depths
                        )
                    else:
                        source = _match(
                            depth, rows, columns, us[n], vs, start, step, limit, reading.along_ray
                        )
                    sources[place + n * pixels] = source


def _template(du, dv, rays, reading):
    """First depth of a template, depth step of Eq. 5, and z_len of Eq. 6; none if undefined."""
    offset = abs(du) if reading.x_only else max(abs(du), abs(dv))
    if reading.reverse or (reading.undefined and offset == 0.0):
        return rays.z_min, 0.0, 0
    steps = offset / rays.stride * (rays.z_max - rays.z_min)
    if steps < (1.0 if reading.up else 0.5):
        return rays.single, rays.z_max - rays.z_min, 1
    z_len = (math.ceil(steps) if reading.up else math.floor(steps + 0.5)) + 1
    return rays.z_min, rays.stride / offset, z_len


def _cells(x0, dx, start, step, z_len, consecutive):
    """Rows or columns of a template's entries (Eq. 7, 8)."""
    if consecutive:
        first, towards = math.floor(x0 + dx * start), 1 if dx >= 0.0 else -1
        return [first + towards * entry for entry in range(z_len)]
    return [math.floor(x0 + dx * (start + entry * step)) for entry in range(z_len)]


def _match(depth, rows, columns, us, vs, start, step, limit, along_ray):
    """Entry of the matrix nearest to its template depth (Eq. 9, 10)."""
    best, source, z_len = limit, HOLE, len(us)
    for i in range(z_len):
        v = vs[i]
        if v < 0 or v >= rows:
            continue
        line, z = depth[v], start + i * step
        first, end = (i, i + 1) if along_ray else (0, z_len)
        for u in us[first:end]:
            if 0 <= u < columns:
                mismatch = abs(line[u] - z)
                if mismatch < best:
                    best, source = mismatch, v * columns + u
    return source


def _first_hit(depth, rows, columns, u0, du, v0, dv, depths):
    """First sample that is not in front of the picture's surface."""
    for z in depths:
        u, v = math.floor(u0 + du * z), math.floor(v0 + dv * z)
        if 0 <= u < columns and 0 <= v < rows and depth[v][u] >= z:
            return v * columns + u
    return HOLE


def search_arrays(rays: Search, depth: np.ndarray, reading: Reading) -> Sources:
    """Search with NumPy: for each ray the matrix, or array, of the depths of the picture.

    The picture is padded. Consecutive rows and columns are slices of it.
    """
    pad = max(_template(du, dv, rays, reading)[2] for du in rays.du for dv in rays.dv) + 2
    padded, columns = np.pad(depth, pad, constant_values=-np.inf), depth.shape[1]
    sources = np.full((len(rays.v), len(rays.dv), len(rays.u), len(rays.du)), HOLE, np.int32)
    is_array = reading.along_ray or reading.reverse
    for a, dv in enumerate(rays.dv.tolist()):
        for b, du in enumerate(rays.du.tolist()):
            start, step, z_len = _template(du, dv, rays, reading)
            z = rays.depths if reading.reverse else start + step * np.arange(z_len)
            if not len(z):
                continue
            limit = math.inf if reading.always else step
            us, vs = (
                _entries(x + pad, dx, z, reading.consecutive)
                for x, dx in ((rays.u, du), (rays.v, dv))
            )
            if not is_array:
                z = z[:, None]
            for m, v in enumerate(vs):
                lines = padded if is_array else padded[v]
                for n, u in enumerate(us):
                    block = lines[v, u] if is_array else lines[:, u]
                    if reading.reverse:
                        hits = block >= z
                        best = int(hits.argmax())
                        is_match = hits[best]
                    else:
                        mismatch = np.abs(block - z)
                        best = int(mismatch.argmin())
                        is_match = mismatch.flat[best] < limit
                    if is_match:
                        i, j = (best, best) if is_array else divmod(best, z_len)
                        row, column = (_entry(index, k) - pad for index, k in ((v, i), (u, j)))
                        sources[m, a, n, b] = row * columns + column
    return sources.reshape(rays.shape)


def _entries(x: np.ndarray, dx: float, z: np.ndarray, consecutive: bool) -> Any:
    """Rows or columns of a template under each lens: indices, or slices of consecutive ones."""
    if not consecutive:
        return np.floor(x[:, None] + dx * z).astype(int)
    towards = 1 if dx >= 0 else -1
    firsts = np.floor(x + dx * z[0]).astype(int).tolist()
    return [slice(first, first + towards * len(z), towards) for first in firsts]


def _entry(index: Any, k: int) -> int:
    return int(index.start + k * index.step if isinstance(index, slice) else index[k])
