"""Colours of rays, evaluated after their sources: nearest pixel, interpolated or averaged.

docs/theory/templates.md, "Colour of a ray", has the definition. ``nearest`` copies the colour of
the source. The others also read its neighbours on the same surface: ``linear`` and ``smooth``
interpolate where the ray meets the surface (`raycast.interpolation`); ``averaged`` and ``smooth``
average over the footprint of the ray (`raycast.light`). All ways to find sources share the kernels,
which take the sources of some panel rows, so their colours agree bit for bit.

One ray per pixel aliases: an elemental image is a small, sharp picture of the scene, and textures
and silhouettes finer than its pixels flicker. Several rays are averaged in linear light; a hole
counts as black. The rays of a red stripe start at the left of the pixel, a third of a pixel from
the green stripe's: each colour channel is a separate image with its own rays. Pixels that lack a
colour (`SubPixel.turn`) receive the value of their neighbours' sub-pixel: panels are driven by
whole pixels and omit colours that they cannot show. In RGBA, alpha is the mean of the three.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from inim.display import Display
from inim.display.pixels import SUBPIXELS, row_blocks
from inim.generators.base import Ray, RaySearch
from inim.generators.raycast.columns import visible_depth
from inim.generators.raycast.interpolation import Interpolation
from inim.generators.raycast.light import (
    Diffusion,
    code_table,
    copy_codes,
    decode_light,
    mean_codes,
    mean_light,
    pack_light,
)
from inim.image.rgbd import RGBD
from inim.system.backend.kernels import parts_of, share, share_rows
from inim.system.row_bands import row_bands

NEAREST, LINEAR, AVERAGED, SMOOTH = "nearest", "linear", "averaged", "smooth"

# Variance that the picture's pixel, or the interpolation, already has.
_VARIANCE = {AVERAGED: 1 / 12, SMOOTH: 1 / 6}
# Sources at once, of all rays: they stay in the cache that the threads share.
_SOURCES_AT_ONCE = 2**22

#: Writes the mean colours of rays, from the sources of some panel rows.
_Writer = Callable[[slice, np.ndarray, np.ndarray], None]


def show_colours(
    rgbd: RGBD,
    display: Display,
    colour: str,
    rays: Sequence[Ray],
    search: RaySearch,
    out: np.ndarray,
) -> None:
    """Write the mean colours of the rays of every pixel.

    * `colour`: {"nearest", "linear", "averaged", "smooth"}.
    * `rays`: one, two or four of each colour channel.
    * `search`: finds the sources of each.
    * `out`, (rows, columns, 3) float32 or (rows, columns, 4) uint8: alpha is the mean of the
      channels.
    """
    picture = _Picture(rgbd, display, colour)
    groups: dict[tuple[int, ...], dict[int, Ray]] = {}
    for number, ray in enumerate(rays):
        groups.setdefault(ray.channels, {})[number] = ray
    if len(groups) == 1:
        _show_group(picture, groups[rays[0].channels], search, out)
        return
    alpha = np.ones(out.shape[:2], np.uint16)
    part = np.empty_like(out)
    for channels, group in groups.items():
        _show_group(picture, group, search, part)
        out[..., channels] = part[..., channels]
        if out.dtype == np.uint8:
            alpha += part[..., 3] * np.uint16(len(channels))
    if out.dtype == np.uint8:
        out[..., 3] = alpha // 3


def _show_group(
    picture: _Picture, rays: Mapping[int, Ray], search: RaySearch, out: np.ndarray
) -> None:
    """Write the mean colours of the rays of some channels, by number, to all channels."""
    write = picture.writer([*rays.values()])

    def show(bands: Sequence[slice]) -> None:
        sources = np.empty((len(rays), _length(bands[0]), out.shape[1]), np.int32)
        for rows in bands:
            band = sources[:, : _length(rows)]
            for number, of_ray in zip(rays, band, strict=True):
                search(number, rows, of_ray)
            write(rows, band, out[rows])

    if out.shape[:2] == picture.display.eia_shape and not picture.display.is_separable:
        # Most of the time goes to the rays of pixels, outside of kernels.
        share(show, parts_of(list(row_blocks(picture.display))))
    else:
        show(list(row_bands(out.shape[0], out.shape[1] * len(rays), _SOURCES_AT_ONCE)))


def _length(rows: slice) -> int:
    return int(rows.stop - rows.start)


class _Picture:
    """Colours of one picture; see `show_colours`."""

    def __init__(self, rgbd: RGBD, display: Display, colour: str) -> None:
        self.rgbd, self.display, self._colour = rgbd, display, colour
        self._coded = rgbd.color.dtype == np.uint8
        self._palette = rgbd.palette.reshape(-1, rgbd.color.shape[2])
        if colour == NEAREST:
            return
        self._light = decode_light(self._palette)
        self._opacity = self._light[:, 3].copy()
        self._light[:, 3] = 1
        self._front = np.stack([visible_depth(layer) for layer in rgbd.layers])
        if colour in (LINEAR, SMOOTH):
            self._interpolation = Interpolation(rgbd, display, self._front)

    def writer(self, rays: Sequence[Ray]) -> _Writer:
        """Function that writes the mean colours of rays."""
        if self._colour in (LINEAR, SMOOTH):
            covered = self._front.reshape(-1) > -np.inf
            opaque = not self._coded or (self._opacity[covered] == 1).all()
            return self._interpolation.writer(
                self._light_of(rays), None if opaque else self._opacity, self._colour == SMOOTH,
                rays,
            )  # fmt: skip
        if not self._coded:
            light = self._palette if self._colour == NEAREST else self._light_of(rays)
            return lambda _, sources, out: share_rows(mean_light, len(out), sources, light, out)
        kernel, words, *tables = self._code_kernel(rays)
        words = np.concatenate([np.zeros(1, words.dtype), words])  # that of a hole first
        return lambda _, sources, out: share_rows(
            kernel, len(out), sources, words, *tables, out.view(np.uint32)[..., 0]
        )

    def _code_kernel(self, rays: Sequence[Ray]) -> tuple[Any, ...]:
        """Kernel that writes the codes of rays; a word of each source, and further tables."""
        if self._colour == NEAREST and len(rays) == 1:
            return copy_codes, np.ascontiguousarray(self._palette).view(np.uint32)[:, 0]
        light = decode_light(self._palette) if self._colour == NEAREST else self._light_of(rays)
        if self._colour == AVERAGED:
            light[:, 3] = self._opacity
        return mean_codes, pack_light(light, len(rays)), code_table()

    def _light_of(self, rays: Sequence[Ray]) -> np.ndarray:
        """Light of each source, averaged over the footprint of rays, or its square roots."""
        light = self._light
        if self._colour in _VARIANCE:
            pixel_mm, present = self.rgbd.pixel_mm, _VARIANCE[self._colour]
            footprint = _footprint(self.display, pixel_mm, rays[0].channels, len(rays))
            diffusion = Diffusion(self._front, footprint, pixel_mm, present)
            light = diffusion.average(light)
            if self._colour == SMOOTH:
                light = diffusion.sharpen(np.sqrt(light, out=light))
        return light


def _footprint(
    display: Display, pixel_mm: float, channels: tuple[int, ...], samples: int
) -> np.ndarray:
    """Size of a ray's footprint for `Diffusion`.

    The ray from p on the panel crosses the array in q, and the depth z in q + (q - p) z / g. In a
    lens, q is the centre. Along a cylinder, q moves with p.
    """
    width = height = 1.0
    if len(channels) < 3:
        subpixel = SUBPIXELS[display.subpixels][channels[0]]
        width, height = float(subpixel.width), float(subpixel.height)
    side = display.pixel_pitch_mm * display.pixel_fill / samples**0.5 / display.gap_mm / pixel_mm
    across, up = display.layout.crossing_steps
    gap = display.gap_mm
    by_height = height * np.array([[up * gap, up - 1], [across * gap, across]])
    by_width = width * np.array([[0, 0], [0, -1]])
    sides: np.ndarray = side * np.stack([by_height, by_width], axis=1)
    return sides
