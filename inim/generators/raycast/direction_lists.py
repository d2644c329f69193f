"""The local depth templates: one list of (cell, exit depth) per direction, shared by all lenses.

Co-located pixels of all elemental images send parallel rays. Where the picture has a whole number
of pixels per lens pitch, such rays meet the picture's cells alike, moved by whole lenses; so the
list of cells that a ray visits, and of the depths at which it leaves them, is built once per
direction (v, u) and serves every lens.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from inim.display import Display
from inim.display.pixels import stated
from inim.generators.base import PictureShape
from inim.generators.raycast.cells import CENTRE, Aside, CellRays, cell_rays
from inim.generators.raycast.ray_by_ray import rounded_up, walk


@dataclass(frozen=True)
class DirectionLists:
    """Templates of one display and picture size; direction (v, u) is number ``v * pixels + u``.

    Attributes
    ----------
    pixels : int
        Pixels per elemental image along one axis.
    per_pitch : int
        Picture cells per lens pitch.
    first : (pixels^2 + 1,) int32
        Where each direction's entries begin.
    row, column : (n,) int32
        Cells of the lens with index (0, 0); lens (m, n) adds ``per_pitch * (m, n)``. Nearest first.
    exit_mm : (n,) float32
        Depths at which the ray leaves them, rounded up: a float32 depth reaches the exact exit
        if and only if it reaches this.
    entry_mm : (n,) float32
        Depths at which it enters them, rounded down: a float32 depth lies at or below the exact
        entry if and only if it does so here. inf for the first cells: rays come from in front.
    """

    pixels: int
    per_pitch: int
    first: np.ndarray
    row: np.ndarray
    column: np.ndarray
    exit_mm: np.ndarray
    entry_mm: np.ndarray


def cells_per_pitch(display: Display, pixel_mm: float) -> int | None:
    """Picture pixels per lens pitch where that is a whole number, alike on both axes, else None."""
    ratio = stated(display.pitch_mm) / stated(pixel_mm)
    square = stated(display.row_pitch_mm) == stated(display.pitch_mm)
    return int(ratio) if ratio.denominator == 1 and square and display.is_separable else None


def shares_directions(display: Display) -> bool:
    """Whether co-located pixels of all elemental images are parallel, as templates need."""
    if not display.has_integer_ratio:
        return False
    pixels = round(display.pixels_per_lens)
    return all(
        axis.offset == axis.offset[:pixels] * (len(axis.offset) // pixels)
        for axis in (display.columns, display.rows)
    )


def build_lists(
    display: Display, shape: PictureShape, pixel_mm: float, aside: Aside = CENTRE
) -> DirectionLists:
    """Templates by exact traversal, in float64, from the rays of the first lens."""
    per_pitch = cells_per_pitch(display, pixel_mm)
    assert per_pitch is not None and shares_directions(display)
    pixels = round(display.pixels_per_lens)
    column_rays, row_rays = cell_rays(shape, pixel_mm, display, aside)
    longest = sum(rays.most_cells(display.depth_range_mm) for rays in (column_rays, row_rays))
    cells, exits = np.empty((longest, 2), np.int64), np.empty(longest)
    visited, left, first = [], [], [0]
    for v in range(pixels):
        for u in range(pixels):
            count = walk(
                *_ray(column_rays, u), *_ray(row_rays, v), *display.depth_range_mm, cells, exits
            )
            visited.append(cells[:count].copy())
            left.append(exits[:count].copy())
            first.append(first[-1] + count)
    place = np.concatenate(visited).astype(np.int32)
    exit_mm = np.concatenate(left)
    entry = np.roll(exit_mm, 1)
    entry[first[:-1]] = np.inf
    return DirectionLists(
        pixels,
        per_pitch,
        np.array(first, np.int32),
        np.ascontiguousarray(place[:, 0]),
        np.ascontiguousarray(place[:, 1]),
        rounded_up(exit_mm),
        -rounded_up(-entry),
    )


def _ray(rays: CellRays, index: int) -> tuple[float, float, float]:
    return float(rays.start[index]), float(rays.slope[index]), rays.scale
