"""Colours of rays, evaluated after their sources: nearest pixel, interpolated or averaged.

Definition. The sources of an algorithm do not depend on the colour. ``nearest`` copies the colour
of the source. The others also read its neighbours on the same surface: covered pixels whose depth
differs by no more than `STEEPEST` times their distance; of several layers the nearest in depth.

Interpolation (``linear``, ``smooth``). The colour is interpolated where the ray meets the surface
of its source; see `raycast.interpolation`.

Footprint (``averaged``, ``smooth``). Colours are averaged over the image of the rectangle of the
panel that a ray stands for; see `raycast.diffusion`. ``linear`` interpolates linear light.
``smooth`` averages linear light and interpolates its square roots, which are close to code values:
dark pixels next to bright ones keep their weight.

The mean over the rays of a pixel is taken in linear light, as always; a hole counts as black.

All ways to find sources share the kernels, which take the sources of some panel rows, so their
colours agree bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from inim.backend.kernels import share_rows
from inim.display import Display
from inim.display.pixels import SUBPIXELS, row_blocks
from inim.generators.base import JoinedRays, Ray
from inim.generators.raycast.diffusion import diffused, sharpened
from inim.generators.raycast.interpolation import Interpolation
from inim.generators.raycast.light import (
    code_table,
    decode_light,
    mean_codes,
    mean_light,
    pack_light,
)
from inim.image.noisy_image import row_bands
from inim.image.rgbd import RGBD

NEAREST, LINEAR, AVERAGED, SMOOTH = "nearest", "linear", "averaged", "smooth"

# Variance that the picture's pixel, or the interpolation, already has.
_VARIANCE = {AVERAGED: 1 / 12, SMOOTH: 1 / 6}
# Sources at once, of all rays: they stay in the cache that the threads share.
_SOURCES_AT_ONCE = 2**22

#: Writes the mean colours of rays, from the sources of some panel rows.
_Writer = Callable[[slice, np.ndarray, np.ndarray], None]


class RayGroup(NamedTuple):
    """Rays of every pixel that show the same colour channels.

    * `rays`: one, two or four.
    * `joined`: all of them together.
    """

    channels: tuple[int, ...]
    rays: list[Ray]
    joined: JoinedRays | None


def group_rays(rays: Sequence[Ray]) -> list[RayGroup]:
    """Rays by their channels."""
    groups: dict[tuple[int, ...], list[Ray]] = {}
    for ray in rays:
        groups.setdefault(ray.channels, []).append(ray)
    return [
        RayGroup(channels, group, group[0].generator.joined([ray.generator for ray in group]))
        for channels, group in groups.items()
    ]


def show_colours(
    rgbd: RGBD, display: Display, colour: str, groups: Sequence[RayGroup], out: np.ndarray
) -> None:
    """Write the mean colours of the rays of every pixel.

    * `colour`: {"nearest", "linear", "averaged", "smooth"}.
    * `out`, (rows, columns, 3) float32 or (rows, columns, 4) uint8: alpha is the mean of the
      channels.
    """
    picture = _Picture(rgbd, display, colour)
    if len(groups) == 1:
        _show_group(picture, groups[0], out)
        return
    alpha = np.ones(out.shape[:2], np.uint16)
    for group in groups:
        part = np.empty_like(out)
        _show_group(picture, group, part)
        out[..., group.channels] = part[..., group.channels]
        if out.dtype == np.uint8:
            alpha += part[..., 3] * np.uint16(len(group.channels))
    if out.dtype == np.uint8:
        out[..., 3] = alpha // 3


def _show_group(picture: _Picture, group: RayGroup, out: np.ndarray) -> None:
    """Write the mean colours of the rays of some channels to all channels."""
    rgbd, display, joined = picture.rgbd, picture.display, group.joined
    if joined is not None and picture.adds_codes:
        joined.show_light(rgbd, picture.words(group), out)
        return
    searches = [ray.generator.search(rgbd) for ray in ([] if joined else group.rays)]
    search_all = joined.search(rgbd) if joined else None
    write = picture.writer(group)
    bands = list(_bands(display, out.shape[:2], len(group.rays)))
    sources = np.empty((len(group.rays), _length(bands[0]), out.shape[1]), np.int32)
    for rows in bands:
        band = sources[:, : _length(rows)]
        if search_all:
            search_all(rows, band)
        for search, of_ray in zip(searches, band, strict=False):
            search(rows, of_ray)
        write(rows, band, out[rows])


def _bands(display: Display, shape: tuple[int, int], rays: int) -> Iterator[slice]:
    """Rows of a result that are processed at once."""
    if shape == display.eia_shape and not display.is_separable:
        return row_blocks(display)
    return row_bands(shape[0], shape[1] * rays, _SOURCES_AT_ONCE)


def _length(rows: slice) -> int:
    return int(rows.stop - rows.start)


class _Picture:
    """Colours of one picture; see `show_colours`."""

    def __init__(self, rgbd: RGBD, display: Display, colour: str) -> None:
        self.rgbd, self.display, self._colour = rgbd, display, colour
        self._coded = rgbd.color.dtype == np.uint8
        self.adds_codes = self._coded and colour in (NEAREST, AVERAGED)
        palette = rgbd.palette.reshape(-1, rgbd.color.shape[2])
        if colour == NEAREST and not self._coded:
            self._light = palette
            return
        self._light = decode_light(palette)
        if colour == NEAREST:
            return
        self._opacity = self._light[:, 3].copy()
        self._light[:, 3] = 1
        no_depth = np.float32(-np.inf)
        self._front = np.stack(
            [np.where(layer.covered, layer.front_mm, no_depth) for layer in rgbd.layers]
        )
        if colour in (LINEAR, SMOOTH):
            self._interpolation = Interpolation(rgbd, display, self._front)

    def writer(self, group: RayGroup) -> _Writer:
        """Function that writes the mean colours of rays."""
        if self.adds_codes:
            words = np.concatenate([np.zeros(1, np.uint64), self.words(group)])
            return lambda _, sources, out: share_rows(
                mean_codes, len(out), sources, words, code_table(), out.view(np.uint32)[..., 0]
            )
        light = self._light_of(group)
        if self._colour in (LINEAR, SMOOTH):
            covered = self._front.reshape(-1) > -np.inf
            opaque = not self._coded or (self._opacity[covered] == 1).all()
            return self._interpolation.writer(
                light, None if opaque else self._opacity, self._colour == SMOOTH, group.rays
            )
        return lambda _, sources, out: share_rows(mean_light, len(out), sources, light, out)

    def words(self, group: RayGroup) -> np.ndarray:
        """Light of each source for the mean of rays, (n,) uint64; see `raycast.light`."""
        light = self._light_of(group)
        if self._colour == AVERAGED:
            light[:, 3] = self._opacity
        return pack_light(light, len(group.rays))

    def _light_of(self, group: RayGroup) -> np.ndarray:
        """Light of each source, averaged over the footprint of rays, or its square roots."""
        light = self._light
        if self._colour in _VARIANCE:
            pixel_mm, present = self.rgbd.pixel_mm, _VARIANCE[self._colour]
            footprint = _footprint(self.display, pixel_mm, group.channels, len(group.rays))
            light = diffused(self._front, light, footprint, pixel_mm, present)
            if self._colour == SMOOTH:
                np.sqrt(light, out=light)
                light = sharpened(self._front, light, footprint, pixel_mm, present)
        return light


def _footprint(
    display: Display, pixel_mm: float, channels: tuple[int, ...], samples: int
) -> tuple[float, float]:
    """Height and width of a ray's footprint, in picture pixels per millimetre of depth."""
    width = 1.0 if len(channels) == 3 else float(SUBPIXELS[display.subpixels][channels[0]].width)
    side = display.pixel_pitch_mm * display.pixel_fill / samples**0.5 / display.gap_mm / pixel_mm
    return side, width * side
