# Kernels have no types of their own.
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
"""Colours of rays, evaluated after their sources: nearest pixel, interpolated or averaged.

Definition. The sources of an algorithm do not depend on the colour. ``nearest`` copies the colour
of the source. The others also read its neighbours on the same surface: covered pixels whose depth
differs by no more than `STEEPEST` times their distance; of several layers the nearest in depth.

Interpolation (``linear``, ``smooth``). The point at which a ray meets the surface is the ray's
position at the depth of the source, moved to the border of the source's pixel if it is outside. The
colour is interpolated bilinearly between the centres of the four nearest pixels. Pixels of another
surface have no weight, and the weights of the others are divided by their sum.

Footprint (``averaged``, ``smooth``). A ray stands for a rectangle of the panel: the emitting area
of its pixel or sub-pixel, divided by the number of samples. At depth z its image has a width of
w = |z| / g times that of the rectangle. Colours are averaged over this width, in linear light, on
the picture: each pixel has one depth, and so one width. The average is a diffusion. Its variance
along each axis is w^2 / 12, in picture pixels, minus the variance that the picture's pixel
already has: 1/12 if the nearest pixel is copied, and 1/6 if colours are interpolated. Pass
k = 0, 1, 2, ... adds the differences to the four neighbours at a distance of s = 2^k pixels, each
with half of the pass's variance divided by s^2. It contributes at most s^2 / 4. The first
passes are used up first. A negative variance sharpens (at most -1/6, in the first pass), which
compensates the blur of interpolation; it is zero for ``averaged``.

``linear`` interpolates linear light. ``smooth`` averages linear light and interpolates its square
roots, which are close to code values: dark pixels next to bright ones keep their weight.

The mean over the rays of a pixel is taken in linear light, as always; a hole counts as black.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from inim.backend.kernels import compiled, prange
from inim.display import Display
from inim.display.pixels import SUBPIXELS, pixel_rays, row_blocks
from inim.generators.base import PictureShape, Ray, SourceGenerator, Sources
from inim.generators.raycast.cells import cell_rays, free_cell_rays
from inim.generators.raycast.columns import STEEPEST
from inim.generators.raycast.supersampling import (
    decode_light,
    encode_light,
    light_code,
    opacity_code,
    transfer_tables,
)
from inim.image.rgbd import RGBD, LayeredRGBD

NEAREST, LINEAR, AVERAGED, SMOOTH = "nearest", "linear", "averaged", "smooth"

# Variance that the picture's pixel and the lookup already have; least variance of the diffusion.
_VARIANCE = {AVERAGED: (1 / 12, 0.0), SMOOTH: (1 / 6, -1 / 6)}


class Coloured(SourceGenerator):
    """Generator whose rays take interpolated or averaged colours.

    Its sources are those of the generator.

    Parameters
    ----------
    generator : SourceGenerator
    display, shape, pixel_mm :
        As the generator was prepared.
    colour : {"linear", "averaged", "smooth"}
    """

    def __init__(
        self,
        generator: SourceGenerator,
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        colour: str,
    ) -> None:
        super().__init__(display, shape, pixel_mm)
        self._generator, self._colour = generator, colour
        rays = generator.rays()
        channels = dict.fromkeys(ray.channels for ray in rays)
        self._rays = {c: [ray for ray in rays if ray.channels == c] for c in channels}

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        return self._generator.find(rgbd)

    def find_into(self, rgbd: RGBD, out: Sources) -> Sources:
        """See `SourceGenerator.find_into`."""
        return self._generator.find_into(rgbd, out)

    def rays(self) -> list[Ray]:
        """See `SourceGenerator.rays`."""
        return self._generator.rays()

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`."""
        self.check(rgbd)
        out = self.place(rgbd, out)
        front = _fronts(rgbd)
        light = decode_light(rgbd.palette.reshape(-1, rgbd.color.shape[2]))
        if self._colour != LINEAR:
            light = self._averaged(front, light)
        if self._colour == AVERAGED:
            return self._generator.generate(_with_light(rgbd, light), out)
        if self._colour == SMOOTH:
            np.sqrt(light[:, :3], out=light[:, :3])
        alpha = np.full(out.shape[:2], 1, np.uint16)  # to round the mean to the nearest
        for channels, rays in self._rays.items():
            self._interpolate(rgbd, front, light, channels, rays, out)
            if out.dtype == np.uint8 and len(self._rays) > 1:
                alpha += out[..., 3] * np.uint16(len(channels))
        if out.dtype == np.uint8 and len(self._rays) > 1:
            out[..., 3] = alpha // 3
        return out

    def _averaged(self, front: np.ndarray, light: np.ndarray) -> np.ndarray:
        """Light of all pixels averaged over the footprints of rays, (n, 4) float32."""
        footprints: dict[tuple[float, float], list[int]] = {}
        for channels, rays in self._rays.items():
            footprint = _footprint(self.display, self.pixel_mm, channels, len(rays))
            footprints.setdefault(footprint, []).extend(channels)
        averages = {
            footprint: diffused(front, light, footprint, self.pixel_mm, *_VARIANCE[self._colour])
            for footprint in footprints
        }
        if len(averages) == 1:
            return next(iter(averages.values()))
        for footprint, average in averages.items():
            selected = footprints[footprint]
            light[:, selected] = average[:, selected]
        return light

    def _interpolate(
        self,
        rgbd: RGBD,
        front: np.ndarray,
        light: np.ndarray,
        channels: tuple[int, ...],
        rays: list[Ray],
        out: np.ndarray,
    ) -> None:
        """Write the mean colour of some rays of all pixels to their channels."""
        sources = np.stack([ray.generator.sources(rgbd) for ray in rays])
        selected = np.isin(np.arange(3), channels)
        tables = transfer_tables()[2:]
        steepest = np.float32(STEEPEST * self.pixel_mm)
        for rows, u, v in self._lines(rays):
            arguments = (
                sources[:, rows], u, v, front, light, steepest, self._colour == SMOOTH, selected,
            )  # fmt: skip
            if out.dtype == np.uint8:
                _mean_codes(*arguments, *tables, out[rows])
            else:
                _mean_light(*arguments, out[rows])

    def _lines(self, rays: list[Ray]) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Columns u and rows v of rays, in picture pixels, in blocks of panel rows.

        Yields
        ------
        rows : slice
        u, v : (rays, 2, block rows, columns) float64
            ``u[:, 0] + u[:, 1] z`` at depth z.
        """
        if self.display.is_separable:
            axes = [
                [np.stack([axis.start, axis.slope]) / axis.scale for axis in pair]
                for pair in (
                    cell_rays(self.shape, self.pixel_mm, self.display, ray.pixel_offset)
                    for ray in rays
                )
            ]
            panel = (len(rays), 2, *self.display.eia_shape)
            u = np.stack([columns for columns, _ in axes])[:, :, None, :]
            v = np.stack([rows for _, rows in axes])[:, :, :, None]
            yield slice(0, panel[2]), np.broadcast_to(u, panel), np.broadcast_to(v, panel)
            return
        for rows in row_blocks(self.display):
            lines = []
            for ray in rays:
                offset = float(ray.pixel_offset[0]), float(ray.pixel_offset[1])
                block = pixel_rays(self.display, rows, offset)
                lines.append(np.broadcast_arrays(*free_cell_rays(self.shape, self.pixel_mm, block)))
            blocks = np.array(lines)
            yield rows, blocks[:, :2], blocks[:, 2:]


def _footprint(
    display: Display, pixel_mm: float, channels: tuple[int, ...], samples: int
) -> tuple[float, float]:
    """Height and width of a ray's footprint, in picture pixels per millimetre of depth."""
    width = 1.0 if len(channels) == 3 else float(SUBPIXELS[display.subpixels][channels[0]].width)
    side = display.pixel_pitch_mm * display.pixel_fill / samples**0.5 / display.gap_mm / pixel_mm
    return side, width * side


def _fronts(rgbd: RGBD) -> np.ndarray:
    """Depth of all layers, (layers, H, W) float32; -inf where there is no surface."""
    no_depth = np.float32(-np.inf)
    return np.stack([np.where(layer.covered, layer.front_mm, no_depth) for layer in rgbd.layers])


def _with_light(rgbd: RGBD, light: np.ndarray) -> RGBD:
    """A picture with other colours, of linear light (layers x H x W, 4)."""
    colour = light[:, :3] if rgbd.color.dtype != np.uint8 else encode_light(light)
    layers = np.ascontiguousarray(colour).reshape(-1, *rgbd.color.shape)
    if not isinstance(rgbd, LayeredRGBD):
        return replace(rgbd, color=layers[0])
    deeper = tuple(
        replace(layer, color=color) for layer, color in zip(rgbd.deeper, layers[1:], strict=True)
    )
    return replace(rgbd, color=layers[0], deeper=deeper)


def diffused(
    front: np.ndarray,
    light: np.ndarray,
    footprint: tuple[float, float],
    pixel_mm: float,
    present: float,
    least: float,
) -> np.ndarray:
    """Light of pixels averaged over the surfaces around them; see the module's definition.

    Parameters
    ----------
    front : (layers, H, W) float32
        Depth in mm; -inf where there is no surface.
    light : (layers x H x W, 4) float32
        Linear RGB, and opacity, which does not change.
    footprint : (down, across)
        Height and width of a ray's footprint, in picture pixels per millimetre of depth.
    pixel_mm : float
        Width of a picture pixel.
    present, least : float
        Variance that the picture already has, and least variance of the diffusion.

    Returns
    -------
    (layers x H x W, 4) float32
    """
    farthest = float(np.abs(front, where=front > -np.inf, out=np.zeros_like(front)).max())
    scale = np.array(footprint, np.float32) / np.float32(12**0.5)
    steepest = np.float32(STEEPEST * pixel_mm)
    for stride in _strides((max(footprint) * farthest) ** 2 / 12 - present):
        result = np.empty_like(light)
        _diffuse(
            front, light, scale, np.float32(present),
            np.float32(least if stride == 1 else 0), stride, steepest, result,
        )  # fmt: skip
        light = result
    return light


def _strides(variance: float) -> list[int]:
    """Distances of the neighbours in the passes for a variance, in picture pixels; at least one."""
    strides = [1]
    while variance > (4 ** len(strides) - 1) / 12:  # of all passes so far
        strides.append(2 * strides[-1])
    return strides


@compiled(parallel=True)
def _diffuse(front, light, scale, present, least, stride, steepest, result):
    """One pass of the diffusion: its share of the variance, from neighbours at a distance."""
    layers, rows, columns = front.shape
    square = np.float32(stride * stride)
    most, used = np.float32(0.25) * square, (square - np.float32(1)) / np.float32(12)
    weight = np.float32(0.5) / square
    reach = steepest * np.float32(stride)
    for index in prange(layers * rows):
        line = np.int64(index)  # the loop's index is unsigned
        layer, row = divmod(line, rows)
        for column in range(columns):
            depth = front[layer, row, column]
            here = line * columns + column
            for c in range(4):
                result[here, c] = light[here, c]
            if depth == -np.inf:
                continue
            for axis in range(2):
                width = scale[axis] * depth
                share = min(max(width * width - present - used, least), most)
                if share == 0:
                    continue
                for side in (-stride, stride):
                    r = row + side if axis == 0 else row
                    c = column if axis == 0 else column + side
                    neighbour = _neighbour(front, r, c, depth, reach)
                    if neighbour < 0:
                        continue
                    other = (neighbour * rows + r) * columns + c
                    for channel in range(3):
                        difference = light[other, channel] - light[here, channel]
                        result[here, channel] += weight * share * difference
            for channel in range(3):
                result[here, channel] = max(result[here, channel], np.float32(0))


@compiled
def _neighbour(front, row, column, depth, reach):
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


@compiled
def _interpolated(source, u0, du, v0, dv, front, light, steepest):
    """Light of a ray at its source, interpolated: red, green, blue and opacity."""
    _, rows, columns = front.shape
    line, column = divmod(source, columns)
    layer, row = divmod(line, rows)
    depth = front[layer, row, column]
    z = np.float64(depth)
    # From the centre of the source, at most half a pixel.
    right = np.float32(min(max(u0 + du * z - column - 0.5, -0.5), 0.5))
    down = np.float32(min(max(v0 + dv * z - row - 0.5, -0.5), 0.5))
    next_column = column + 1 if right > 0 else column - 1
    next_row = row + 1 if down > 0 else row - 1
    right, down = abs(right), abs(down)
    unit = np.float32(1)
    weight = (unit - right) * (unit - down)
    red, green = weight * light[source, 0], weight * light[source, 1]
    blue, opacity = weight * light[source, 2], weight * light[source, 3]
    total = weight
    for corner in range(3):
        r, c, reach = row, next_column, steepest
        weight = right * (unit - down)
        if corner == 1:
            r, c, weight = next_row, column, (unit - right) * down
        elif corner == 2:
            r, weight, reach = next_row, right * down, steepest * np.float32(np.sqrt(2.0))
        neighbour = _neighbour(front, r, c, depth, reach) if weight > 0 else -1
        if neighbour >= 0:
            other = (neighbour * rows + r) * columns + c
            red += weight * light[other, 0]
            green += weight * light[other, 1]
            blue += weight * light[other, 2]
            opacity += weight * light[other, 3]
            total += weight
    scale = unit / total
    return red * scale, green * scale, blue * scale, opacity * scale


@compiled
def _mean(sources, u, v, front, light, steepest, squared, i, j):
    """Mean light of the rays of a panel pixel, in linear light; a hole counts as black."""
    red = green = blue = opacity = np.float32(0)
    for ray in range(len(sources)):
        source = np.int64(sources[ray, i, j])
        if source < 0:
            continue
        r, g, b, a = _interpolated(
            source, u[ray, 0, i, j], u[ray, 1, i, j], v[ray, 0, i, j], v[ray, 1, i, j],
            front, light, steepest,
        )  # fmt: skip
        if squared:
            r, g, b = r * r, g * g, b * b
        red, green, blue, opacity = red + r, green + g, blue + b, opacity + a
    share = np.float32(1) / np.float32(len(sources))
    return red * share, green * share, blue * share, opacity * share


@compiled(parallel=True)
def _mean_light(sources, u, v, front, light, steepest, squared, selected, out):
    """Mean colours of rays, in the selected channels of (rows, columns, 3) linear light."""
    for i in prange(sources.shape[1]):
        for j in range(sources.shape[2]):
            mean = _mean(sources, u, v, front, light, steepest, squared, i, j)
            for channel in range(3):
                if selected[channel]:
                    out[i, j, channel] = mean[channel]


@compiled(parallel=True)
def _mean_codes(
    sources, u, v, front, light, steepest, squared, selected, step_code, code_begins, out
):
    """Mean colours of rays, in the selected channels of (rows, columns, 4) sRGB; and alpha."""
    for i in prange(sources.shape[1]):
        for j in range(sources.shape[2]):
            mean = _mean(sources, u, v, front, light, steepest, squared, i, j)
            for channel in range(3):
                if selected[channel]:
                    out[i, j, channel] = light_code(mean[channel], step_code, code_begins)
            out[i, j, 3] = opacity_code(mean[3])
