# Kernels have no types of their own.
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
"""Colours averaged over the footprints of rays, by a diffusion on the picture.

A ray stands for a rectangle of the panel: the emitting area of its pixel or sub-pixel, divided by
the number of samples. At depth z its image has a width of w = |z| / g times that of the rectangle.
Each picture pixel has one depth, and so one width. The average is a diffusion of linear light
between neighbours on the same surface: covered pixels whose depth differs by no more than
`STEEPEST` times their distance; of several layers the nearest in depth. Its variance along each
axis is w^2 / 12, in picture pixels, minus the variance that is there anyway: 1/12 of a picture's
pixel, or 1/6 of the interpolation.

Pass k = 0, 1, 2, ... adds the differences to the four neighbours at a distance of s = 2^k pixels,
each with half of the pass's variance divided by s^2. It contributes at most s^2 / 4. The first
passes are used up first. Where the variance is negative (at least -1/6), one pass over the square
roots sharpens them, which compensates the blur of the interpolation.
"""

from __future__ import annotations

import numpy as np

from inim.backend.kernels import compiled, share_rows
from inim.generators.raycast.columns import STEEPEST
from inim.generators.raycast.simd import choose, less, load4, minus, plus, same4, store, times


def diffused(
    front: np.ndarray,
    light: np.ndarray,
    footprint: tuple[float, float],
    pixel_mm: float,
    present: float,
) -> np.ndarray:
    """Light of pixels averaged over the surfaces around them; see the module.

    * `front`, (layers, H, W) float32: depth in mm; -inf where there is no surface.
    * `light`, (layers x H x W, 4) float32: linear RGB, and 1.
    * `footprint`, (down, across): height and width of a ray's footprint, in picture pixels per
      millimetre of depth.
    * `pixel_mm`: width of a picture pixel.
    * `present`: variance that is there without an average.

    Returns (layers x H x W, 4) float32.
    """
    farthest = float(np.abs(front, where=front > -np.inf, out=np.zeros_like(front)).max())
    for stride in _strides((max(footprint) * farthest) ** 2 / 12 - present):
        light = _diffused(
            front, light, footprint, pixel_mm, present, (0, stride * stride / 4), stride
        )
    return light


def sharpened(
    front: np.ndarray,
    roots: np.ndarray,
    footprint: tuple[float, float],
    pixel_mm: float,
    present: float,
) -> np.ndarray:
    """Square roots of light, sharpened where a footprint has less variance than is present.

    Parameters and result are those of `diffused`.
    """
    return _diffused(front, roots, footprint, pixel_mm, present, (-present, 0))


def _diffused(
    front: np.ndarray,
    light: np.ndarray,
    footprint: tuple[float, float],
    pixel_mm: float,
    present: float,
    limits: tuple[float, float],
    stride: int = 1,
) -> np.ndarray:
    """One pass of the diffusion, whose variance is within limits."""
    result = np.empty_like(light)
    share_rows(
        _diffuse, front.shape[0] * front.shape[1], front, light.reshape(-1),
        np.array(footprint, np.float32) / np.float32(12**0.5),
        np.float32(present), *map(np.float32, limits), stride, np.float32(STEEPEST * pixel_mm),
        result.reshape(-1),
    )  # fmt: skip
    return result


def _strides(variance: float) -> list[int]:
    """Distances of the neighbours in the passes for a variance, in picture pixels; at least one."""
    strides = [1]
    while variance > (4 ** len(strides) - 1) / 12:  # of all passes so far
        strides.append(2 * strides[-1])
    return strides


@compiled
def _diffuse(begin, end, front, light, scale, present, least, most, stride, steepest, result):
    """One pass of the diffusion: its share of the variance, from neighbours at a distance."""
    _, rows, columns = front.shape
    square = np.float32(stride * stride)
    used = (square - np.float32(1)) / np.float32(12)
    weight = np.float32(0.5) / square
    reach = steepest * np.float32(stride)
    for line in range(begin, end):
        layer, row = divmod(line, rows)
        for column in range(columns):
            depth = front[layer, row, column]
            here = np.uintp(4 * (line * columns + column))
            value = load4(light, here)
            total = value
            for axis in range(2):
                width = scale[axis] * depth
                share = min(max(width * width - present - used, least), most)
                if share == 0 or depth == -np.inf:
                    continue
                factor = same4(weight * share)
                for side in (-stride, stride):
                    r = row + side if axis == 0 else row
                    c = column if axis == 0 else column + side
                    neighbour = neighbour_layer(front, r, c, depth, reach)
                    if neighbour >= 0:
                        other = np.uintp(4 * ((neighbour * rows + r) * columns + c))
                        total = plus(total, times(factor, minus(load4(light, other), value)))
            zero = same4(np.float32(0))
            store(result, here, choose(less(total, zero), zero, total))


@compiled
def neighbour_layer(front, row, column, depth, reach):
    """Layer of a pixel that is nearest to a depth and on the same surface; -1 if there is none."""
    if not (0 <= row < front.shape[1] and 0 <= column < front.shape[2]):
        return -1
    nearest = -1
    for layer in range(front.shape[0]):
        distance = abs(front[layer, row, column] - depth)
        if distance <= reach:
            reach, nearest = distance, layer
            if distance == 0:
                break
    return nearest
