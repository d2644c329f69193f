# Kernels have no types of their own.
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
"""`wang2024`: local depth template matching as the paper prints it.

Wang et al., Heritage Science 2024, doi 10.1186/s40494-024-01462-4, Eq. 5 to 10. The depth range is
sampled in z_len steps, each as deep as the ray takes to move one picture pixel sideways. Every
combination of a row sample and a column sample is compared with the picture's depth at that place,
and the best match is the source.

Two printed properties are kept on purpose, to test the paper's claim: the whole z_len x z_len
matrix is searched although the ray only crosses its diagonal, and the best match wins anywhere
along the ray. docs/theory/paper.md describes the options and lists the deviations from the print.
"""

from __future__ import annotations

import math

import numpy as np

from inim.display import Display
from inim.errors import UsageError
from inim.generators.base import (
    HOLE,
    PictureShape,
    SourceGenerator,
    Sources,
    require_separable,
    run_kernel,
)
from inim.generators.raycast.cells import cell_rays
from inim.generators.registry import algorithm, one_of
from inim.image.rgbd import RGBD

_MATCHINGS = ("matrix", "ray")
_ROUNDINGS = ("nearest", "up")
_STEP_PIXELS = ("picture", "scene")
_CELLS = ("at_depth", "consecutive")
# Entries of one pixel's template: a thousand times those of usual displays.
_MOST_ENTRIES = 1_000_000


@algorithm(color="#d55e00", marker="s")
def prepare(
    display: Display,
    shape: PictureShape,
    pixel_mm: float,
    matching: str = "matrix",
    rounding: str = "nearest",
    step_pixel: str = "picture",
    cells: str = "at_depth",
    *,
    mask: np.ndarray | None = None,
) -> SourceGenerator:
    """Local depth template matching, as printed (Wang et al. 2024).

    Parameters
    ----------
    display, shape, pixel_mm, mask :
        See `inim.generators.prepare`.
    matching : {"matrix", "ray"}
        Search the whole matrix, as printed, or only the entries on the ray.
    rounding : {"nearest", "up"}
        Rounding of z_len (Eq. 6): to the nearest whole number, as printed, or up, so that z_max is
        reached.
    step_pixel : {"picture", "scene"}
        Sideways movement of the ray per depth step (Eq. 5): a pixel of the picture, or P_I of Eq.
        3.
    cells : {"at_depth", "consecutive"}
        Row and column of an entry (Eq. 7, 8): those of the ray at the entry's depth, or one more
        pixel per entry, as printed.

    Raises
    ------
    UsageError
        An invalid option, a display that is not separable or has no P_I, or templates of
        implausible length.
    """
    along_ray = one_of("matching", matching, _MATCHINGS) == "ray"
    up = one_of("rounding", rounding, _ROUNDINGS) == "up"
    require_separable(display, "wang2024")
    stride = 1.0
    if one_of("step_pixel", step_pixel, _STEP_PIXELS) == "scene":
        stride = display.scene_pixel_mm / pixel_mm
        if math.isinf(stride):
            raise UsageError(
                f"step_pixel = {step_pixel!r}: display {display.name} is focused, where P_I is "
                "infinite; use picture"
            )
    consecutive = one_of("cells", cells, _CELLS) == "consecutive"
    _check_length(display, shape, pixel_mm * stride, along_ray)
    return _Wang2024(display, shape, pixel_mm, (along_ray, consecutive), (stride, up), mask)


def _check_length(display: Display, shape: PictureShape, step_mm: float, along_ray: bool) -> None:
    """Refuse templates that would take for ever."""
    rays = cell_rays(shape, step_mm, display)
    longest = max(axis.most_cells(display.depth_range_mm) for axis in rays)
    most = _MOST_ENTRIES if along_ray else math.isqrt(_MOST_ENTRIES)
    if longest > most:
        raise UsageError(
            f"wang2024: the depth range takes a template of {longest:.3g} steps, of which at most "
            f"{most} make sense; state a shorter depth_min_mm to depth_max_mm, or larger picture "
            "pixels"
        )


class _Wang2024(SourceGenerator):
    def __init__(
        self,
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        search: tuple[bool, bool],
        steps: tuple[float, bool],
        mask: np.ndarray | None,
    ) -> None:
        super().__init__(display, shape, pixel_mm, mask)
        self._search = search
        self._steps = steps

    def find(self, rgbd: RGBD) -> Sources:
        columns, rows = cell_rays(self.shape, self.pixel_mm, self.display)
        z_min, z_max = self.display.depth_range_mm
        single = self.display.central_depth_mm
        if not z_min <= single <= z_max:
            single = (z_min + z_max) / 2
        depth = np.where(rgbd.covered, rgbd.depth_mm.astype(np.float64), np.inf)
        # Covered columns of each row, first and last; none for a row without relic.
        first = np.where(rgbd.covered.any(axis=1), rgbd.covered.argmax(axis=1), self.shape[1])
        last = self.shape[1] - 1 - rgbd.covered[:, ::-1].argmax(axis=1)
        return run_kernel(
            _match_all,
            self.display.eia_shape[0],
            self.display.eia_shape,
            HOLE,
            self.selected.ravel(),
            depth,
            first,
            last,
            *columns.in_cells,
            *rows.in_cells,
            z_min,
            z_max,
            single,
            *self._steps,
            *self._search,
        )


def _match_all(
    begin, end, selected, depth, first, last, u0, du, v0, dv, z_min, z_max, single, stride, up,
    along_ray, consecutive, sources,
):  # fmt: skip
    """Match all selected panel pixels; u and v are columns and rows in picture pixels."""
    steepest = max(np.abs(du).max(), np.abs(dv).max())
    _, longest = _steps(steepest, steepest, z_min, z_max, stride, up)
    cells = np.empty(longest, np.int64)
    for i in range(begin, end):
        for j in range(len(u0)):
            if not selected[i * len(u0) + j]:
                continue
            step, z_len = _steps(du[j], dv[i], z_min, z_max, stride, up)
            start = single if z_len == 1 else z_min
            for entry in range(z_len):
                cells[entry] = _cell(u0[j], du[j], start, step, entry, consecutive)
            sources[i * len(u0) + j] = _match(
                depth, first, last, cells[:z_len], v0[i], dv[i], start, step, along_ray, consecutive
            )


def _steps(du, dv, z_min, z_max, stride, up):
    """Depth step of Eq. 5, `stride` picture pixels of sideways travel, and z_len of Eq. 6."""
    travel = max(abs(du), abs(dv)) / stride
    if travel * (z_max - z_min) < (1.0 if up else 0.5):
        return z_max - z_min, 1
    step = 1.0 / travel
    steps = (z_max - z_min) / step
    return step, (math.ceil(steps) if up else math.floor(steps + 0.5)) + 1


def _match(depth, first, last, cells, v0, dv, start, step, along_ray, consecutive):
    """Eq. 7 to 10: the entry of the z_len x z_len matrix nearest to its template depth.

    `cells` are the columns of the entries. Rows and columns without relic never match.
    """
    rows, columns = depth.shape
    z_len = len(cells)
    left, right = min(cells[0], cells[-1]), max(cells[0], cells[-1])
    best, source = step, HOLE
    for i in range(z_len):
        v = _cell(v0, dv, start, step, i, consecutive)
        if v < 0 or v >= rows or first[v] > right or last[v] < left:
            continue
        z = start + i * step
        begin, end = (i, i + 1) if along_ray else (0, z_len)
        for u in cells[begin:end]:
            if u < 0 or u >= columns:
                continue
            mismatch = abs(depth[v, u] - z)
            if mismatch < best:
                best, source = mismatch, v * columns + u
    return source


def _cell(x0, dx, start, step, entry, consecutive):
    """Row or column of a template's entry (Eq. 7, 8)."""
    if not consecutive:
        return math.floor(x0 + dx * (start + entry * step))
    return math.floor(x0 + dx * start) + (entry if dx >= 0 else -entry)
