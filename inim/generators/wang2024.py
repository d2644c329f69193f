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

import math
from dataclasses import dataclass

import numpy as np

from inim.display.pixels import RATIO_ERROR, PixelOffset
from inim.generators.base import HOLE, PanelRays, SourceFinder, Sources, each_ray
from inim.generators.options import choice
from inim.generators.raycast.cells import most_cells, search_rays
from inim.generators.registry import algorithm
from inim.image.rgbd import RGBD
from inim.system.errors import UsageError

# Entries of one pixel's template: a thousand times those of usual displays.
_MOST_ENTRIES = 1_000_000


@dataclass(frozen=True)
class Wang2024Options:
    """Options of `wang2024`."""

    matching: str = choice(
        "matrix", "search the whole matrix, as printed, or only the entries on the ray",
        "matrix", "ray",
    )  # fmt: skip
    rounding: str = choice(
        "nearest",
        "rounding of z_len (Eq. 6): to the nearest whole number, as printed, or up, so that z_max "
        "is reached",
        "nearest", "up",
    )  # fmt: skip
    step_pixel: str = choice(
        "picture",
        "sideways movement of the ray per depth step (Eq. 5): a pixel of the picture, or P_I of "
        "Eq. 3",
        "picture", "scene",
    )  # fmt: skip
    cells: str = choice(
        "at_depth",
        "row and column of an entry (Eq. 7, 8): those of the ray at the entry's depth, or one more "
        "pixel per entry, as printed",
        "at_depth", "consecutive",
    )  # fmt: skip


@algorithm(Wang2024Options, samples="1", color="#d55e00", marker="s")
def prepare(rays: PanelRays, options: Wang2024Options) -> SourceFinder:
    """Local depth template matching, as printed (Wang et al. 2024)."""
    display, along_ray, stride = rays.display, options.matching == "ray", 1.0
    if options.step_pixel == "scene":
        stride = display.scene_pixel_mm / rays.pixel_mm
        if math.isinf(stride):
            raise UsageError(
                f"wang2024: step_pixel = 'scene': display {display.name} is focused, where P_I is "
                "infinite; use picture"
            )
    _check_length(rays, stride, along_ray)
    steps = stride, options.rounding == "up", along_ray, options.cells == "consecutive"
    z_min, z_max = display.depth_range_mm
    single = display.central_depth_mm
    if not z_min <= single <= z_max:
        single = (z_min + z_max) / 2

    def find(rgbd: RGBD, pixel_offset: PixelOffset) -> Sources:
        depth = np.where(rgbd.covered, rgbd.depth_mm.astype(np.float64), np.inf)
        # Covered columns of each row, first and last; none for a row without relic.
        first = np.where(rgbd.covered.any(axis=1), rgbd.covered.argmax(axis=1), rays.shape[1])
        last = rays.shape[1] - 1 - rgbd.covered[:, ::-1].argmax(axis=1)
        return search_rays(
            _match_all, rays, pixel_offset, depth, first, last, z_min, z_max, single, *steps
        )

    return each_ray(rays, find)


def _check_length(rays: PanelRays, stride: float, along_ray: bool) -> None:
    """Refuse templates that would take for ever."""
    longest = most_cells(rays.display, rays.shape, rays.pixel_mm * stride)
    most = _MOST_ENTRIES if along_ray else math.isqrt(_MOST_ENTRIES)
    if longest > most:
        raise UsageError(
            f"wang2024: the depth range takes a template of {longest:.3g} steps, of which at most "
            f"{most} make sense; state a shorter depth_min_mm to depth_max_mm, or larger picture "
            "pixels"
        )


def _match_all(
    begin, end, u0, du, v0, dv, selected, depth, first, last, z_min, z_max, single, stride, up,
    along_ray, consecutive, sources,
):  # fmt: skip
    """Match all selected panel pixels; u and v are columns and rows in picture pixels."""
    width = u0.shape[1]
    for i in range(begin, end):
        u, u_slope, v, v_slope, is_selected = u0[i], du[i], v0[i], dv[i], selected[i]
        steepest = max(np.abs(u_slope).max(), np.abs(v_slope).max())
        cells = np.empty(_steps(steepest, steepest, z_min, z_max, stride, up)[1], np.int64)
        for j in range(width):
            if not is_selected[j]:
                continue
            step, z_len = _steps(u_slope[j], v_slope[j], z_min, z_max, stride, up)
            start = single if z_len == 1 else z_min
            for entry in range(z_len):
                cells[entry] = _cell(u[j], u_slope[j], start, step, entry, consecutive)
            sources[i * width + j] = _match(
                depth, first, last, cells[:z_len], v[j], v_slope[j], start, step, along_ray,
                consecutive,
            )  # fmt: skip


def _steps(du, dv, z_min, z_max, stride, up):
    """Depth step of Eq. 5, `stride` picture pixels of sideways travel, and z_len of Eq. 6."""
    travel = max(abs(du), abs(dv)) / stride
    steps = travel * (z_max - z_min)
    # As `exact_ratio`, where the step's number of halves decides.
    halves = math.floor(2.0 * steps + 0.5)
    if abs(2.0 * steps - halves) <= RATIO_ERROR * halves:
        steps = halves / 2.0
    if steps < (1.0 if up else 0.5):
        return z_max - z_min, 1
    return 1.0 / travel, (math.ceil(steps) if up else math.floor(steps + 0.5)) + 1


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
