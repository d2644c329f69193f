# Kernels have no types of their own.
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
"""Hole filling, a step of every algorithm that finds sources.

docs/theory/templates.md, "Hidden regions", defines it. The picture is continued beyond its edge as
far as rays reach. A pixel that still has no source is a hole of one view. In that view, the next
pixel with a source in each of eight directions gives a surface, which is extended at its depth to
the hole. It is a candidate only if the picture could not see it there. The hole receives the mean
of the candidates' colours in linear light, weighted by nearness.

Each hole is filled from sources in its own view, never from another filled hole: results do not
depend on order, and the cost grows with the number of holes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from inim.display import Display
from inim.display.pixels import PixelAxis
from inim.generators.base import HOLE, NO_LENS, PictureShape, Ray, Sources
from inim.generators.raycast.cells import cell_rays
from inim.generators.raycast.columns import STEEPEST, visible_depth
from inim.generators.raycast.light import light_of_codes
from inim.image.color import srgb_from_linear, srgb_to_uint8
from inim.image.rgbd import RGBD, Layer, LayeredRGBD
from inim.system.backend.kernels import compiled, share_rows

# Lenses to look aside from a hole: the parallax of any display, and a bound on the time.
_REACH = 64


def fill_holes(
    rgbd: RGBD,
    display: Display,
    rays: Sequence[Ray],
    sources_of: Mapping[int, Callable[[], Sources]],
    out: np.ndarray,
    *,
    unknown: bool,
) -> None:
    """Fill the holes of an EIA from their own views; filled pixels have the alpha of shown ones.

    * `rgbd`: continued picture.
    * `rays`, `sources_of`: rays of every pixel; by the number of each with holes, its sources, with
      holes where they are only an assumption.
    * `unknown`: fill uncovered regions as well.
    """
    if not sources_of:
        return
    visible = _VisibleSurfaces.of(rgbd, unknown=unknown)
    positions, light = [], []
    for number, sources in sources_of.items():
        ray = rays[number]
        holes, colour = _missing(ray, sources(), rgbd, display, visible)
        share = np.zeros(4, np.float32)  # of the pixel's light, and of its alpha
        alike = sum(other.channels == ray.channels for other in rays)
        share[list(ray.channels)] = 1 / alike
        share[3] = len(ray.channels) / 3 / alike
        positions.append(holes)
        light.append(colour * share)
    pixels, of = np.unique(np.concatenate(positions), return_inverse=True)
    total = np.zeros((len(pixels), 4), np.float32)
    np.add.at(total, of, np.concatenate(light))
    _add_light(out.reshape(-1, out.shape[-1]), pixels, total)


def _missing(
    ray: Ray, sources: Sources, rgbd: RGBD, display: Display, visible: _VisibleSurfaces
) -> tuple[np.ndarray, np.ndarray]:
    """Panel pixels with holes that can be filled, and their fill colours.

    Returned values:
    * `pixels`, (n,) int64: ``row * columns + column`` of the panel.
    * `colour`, (n, 4) float32: linear RGB, and 1.
    """
    holes = np.flatnonzero(sources == HOLE)
    if sources.max() < 0:  # every view is empty; searches to all sides would take minutes
        holes = holes[:0]
    colour = np.ones((len(holes), 4), np.float32)
    filled = np.zeros(len(holes), np.bool_)
    columns, rows = cell_rays(rgbd.shape, rgbd.pixel_mm, display, ray.pixel_offset)
    down = _views(display.rows, display.elemental_row_pitch_mm, display)
    across = _views(display.columns, display.elemental_image_pitch_mm, display)
    share_rows(
        _fill, len(holes), holes, sources, down, across, rows, columns, *visible,
        STEEPEST * rgbd.pixel_mm, display.row_pitch_mm / display.pitch_mm,
        display.traced_range_mm[0], bool((visible.front > -np.inf).all()), colour, filled,
    )  # fmt: skip
    return holes[filled], colour[filled]


def continued_shape(display: Display, shape: PictureShape, pixel_mm: float) -> PictureShape:
    """Rows and columns of a picture that is continued, on opposite sides equally, to all rays."""
    reached = display.capture_shape(display.pitch_mm / pixel_mm)
    rows, columns = (n + 2 * max(0, (m - n + 1) // 2) for n, m in zip(shape, reached, strict=True))
    return rows, columns


def continued(rgbd: RGBD, shape: PictureShape) -> RGBD:
    """Picture whose border is repeated outwards to a number of rows and columns."""
    if shape == rgbd.shape:
        return rgbd
    margins = [((n - m) // 2,) * 2 for n, m in zip(shape, rgbd.shape, strict=True)]

    def extend(values: np.ndarray) -> np.ndarray:
        return np.pad(values, margins + [(0, 0)] * (values.ndim - 2), mode="edge")

    first, *deeper = (
        Layer(*map(extend, (layer.color, layer.front_mm, layer.back_mm, layer.covered)))
        for layer in rgbd.layers
    )
    front = first.color, first.front_mm, first.covered, rgbd.pixel_mm
    if isinstance(rgbd, LayeredRGBD):
        return LayeredRGBD(*front, first.back_mm, tuple(deeper))
    return RGBD(*front)


def fills_frame(rgbd: RGBD) -> bool:
    """True if most pixels at the border of a picture are covered.

    Photographs and light fields fill their frame; relics in front of a background do not.
    """
    covered = rgbd.covered
    border = np.concatenate([covered[0], covered[-1], covered[:, 0], covered[:, -1]])
    return bool(border.mean() > 0.5)


class _VisibleSurfaces(NamedTuple):
    """Visible surfaces of a picture, with all its layers.

    * `front`, (H, W) float32: depth behind which the view is blocked; -inf at background, the
      lowest finite number at unknown pixels.
    * `depth`, (layers x H x W,) float32: depth of each source; -inf at uncovered pixels.
    * `palette`, (layers x H x W, 3) float32: linear RGB.
    """

    front: np.ndarray
    depth: np.ndarray
    palette: np.ndarray

    @classmethod
    def of(cls, rgbd: RGBD, *, unknown: bool) -> _VisibleSurfaces:
        uncovered = np.finfo(np.float32).min if unknown else np.float32(-np.inf)
        depth = [visible_depth(layer) for layer in rgbd.layers]
        color = rgbd.palette.reshape(-1, rgbd.color.shape[2])[:, :3]
        if color.dtype == np.uint8:
            color = light_of_codes()[color]
        front = np.where(rgbd.covered, rgbd.depth_mm, uncovered)
        return cls(front, np.concatenate(depth).reshape(-1), color)


def _add_light(pixels: np.ndarray, at: np.ndarray, light: np.ndarray) -> None:
    """Add light, (n, 4) with its share of the pixel, to float RGB or sRGB codes with alpha."""
    if pixels.dtype != np.uint8:
        pixels[at] += light[:, :3]
        return
    light_sum = light_of_codes()[pixels[at, :3]] + light[:, :3]
    pixels[at, :3] = srgb_to_uint8(srgb_from_linear(light_sum))
    alpha = pixels[at, 3] + np.rint(light[:, 3] * np.float32(255))
    pixels[at, 3] = np.minimum(alpha, 255).astype(np.uint8)


def _views(
    axis: PixelAxis, pitch_mm: float, display: Display
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Lens of each panel pixel; first pixel of each lens and the one after its last; their pitch.

    The pitch is in panel pixels: where it is no whole number, the pixel at the same place under
    another lens is the nearest one.
    """
    first, end = axis.elemental_images()
    return axis.lens, first, end, pitch_mm / display.pixel_pitch_mm


@compiled
def _fill(
    begin, end, holes, sources, down, across, row_rays, column_rays, front, depth, palette,
    same_mm, aspect, z_min, no_ground, colour, filled,
):  # fmt: skip
    """Fill each hole; see the module's definition."""
    for n in range(begin, end):
        i, j = divmod(holes[n], sources.shape[1])
        if _visible_depth(front, row_rays, i, column_rays, j, z_min) == -np.inf:
            continue
        neighbours, lenses = np.full(9, -1), np.zeros(9, np.int64)
        hidden, any_hidden, farthest = np.zeros(9, np.bool_), False, np.inf
        for k in range(9):
            step = k // 3 - 1, k % 3 - 1
            neighbours[k], lenses[k] = _next_shown(sources, i, j, step, down, across)
            if neighbours[k] < 0:
                continue
            z = depth[neighbours[k]]
            visible_depth = np.float32(np.inf)
            for on in range(lenses[k]):
                p, q = _beside(i, on * step[0], down), _beside(j, on * step[1], across)
                visible_depth = min(
                    visible_depth, _visible_depth(front, row_rays, p, column_rays, q, z)
                )
            if visible_depth == -np.inf:
                neighbours[k] = -1
                continue
            hidden[k] = visible_depth >= z - same_mm
            any_hidden |= hidden[k]
            farthest = min(farthest, z)
        weight = red = green = blue = 0.0
        for k in range(9):
            if neighbours[k] < 0:
                continue
            is_fallback = (
                no_ground and not any_hidden and depth[neighbours[k]] <= farthest + same_mm
            )
            if hidden[k] or is_fallback:
                step = k // 3 - 1, k % 3 - 1
                source = _next_of_surface(neighbours[k], step, depth, front.shape, same_mm)
                share = 1 / (lenses[k] * np.sqrt((step[0] * aspect) ** 2 + step[1] ** 2))
                weight += share
                red += share * palette[source, 0]
                green += share * palette[source, 1]
                blue += share * palette[source, 2]
        if weight > 0:
            filled[n] = True
            colour[n, 0], colour[n, 1], colour[n, 2] = red / weight, green / weight, blue / weight


@compiled
def _visible_depth(front, row_rays, i, column_rays, j, z):
    """Depth that the picture shows where a ray is at a depth; inf outside the picture."""
    v0, dv, v1 = row_rays
    u0, du, u1 = column_rays
    v = np.floor((v0[i] + dv[i] * z) / v1)
    u = np.floor((u0[j] + du[j] * z) / u1)
    if 0 <= v < front.shape[0] and 0 <= u < front.shape[1]:
        return front[int(v), int(u)]
    return np.float32(np.inf)


@compiled
def _next_of_surface(source, step, depth, shape, same_mm):
    """The picture's next pixel in a direction, if it is the same surface; or the pixel itself."""
    row, column = divmod(source % (shape[0] * shape[1]), shape[1])
    beside = source + step[0] * shape[1] + step[1]
    if (
        0 <= row + step[0] < shape[0]
        and 0 <= column + step[1] < shape[1]
        and abs(depth[beside] - depth[source]) <= same_mm
    ):
        return beside
    return source


@compiled
def _next_shown(sources, i, j, step, down, across):
    """Source of the next pixel of a view that shows something, or -1; and how many lenses on."""
    if step[0] == 0 and step[1] == 0:
        return np.int64(-1), 0
    for k in range(1, _REACH + 1):
        p, q = _beside(i, k * step[0], down), _beside(j, k * step[1], across)
        if p < 0 or q < 0 or sources[p, q] == NO_LENS:
            break
        if sources[p, q] >= 0:
            return np.int64(sources[p, q]), k
    return np.int64(-1), 0


@compiled
def _beside(pixel, lenses, axis):
    """The pixel of another elemental image that is nearest to the same place; -1 if none is."""
    lens, first, end, pitch = axis
    other = lens[pixel] + lenses
    if not 0 <= other < len(first) or end[other] <= first[other]:
        return np.int64(-1)
    place = np.int64(np.floor(pixel + lenses * pitch + 0.5))
    return min(max(place, first[other]), end[other] - 1)
