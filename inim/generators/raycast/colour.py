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

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cache
from typing import NamedTuple

import numpy as np

from inim.backend.kernels import share_rows
from inim.display import Display
from inim.display.pixels import CENTRE, SUBPIXELS, PixelOffset, SubPixel, exact_length, row_blocks
from inim.generators.base import (
    JoinedRays,
    PictureShape,
    Ray,
    SourceGenerator,
    Sources,
)
from inim.generators.raycast.interpolation import Interpolation
from inim.generators.raycast.light import (
    code_table,
    decode_light,
    diffused,
    mean_codes,
    mean_light,
    pack_light,
    sharpened,
)
from inim.image.noisy_image import row_bands
from inim.image.rgbd import RGBD, LayeredRGBD

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
    width = height = 1.0
    if len(channels) < 3:
        subpixel = SUBPIXELS[display.subpixels][channels[0]]
        width, height = float(subpixel.width), float(subpixel.height)
    side = display.pixel_pitch_mm * display.pixel_fill / samples**0.5 / display.gap_mm / pixel_mm
    # Cylinders send all light of a pixel to the same eye's height: it does not widen along them.
    return 0.0 if display.layout.of_cylinders else height * side, width * side


_A = Fraction(1, 4)
# Down and right from the centre of an area, in its height and width.
_PLACES: dict[int, tuple[tuple[Fraction, Fraction], ...]] = {
    1: ((Fraction(0), Fraction(0)),),
    2: ((-_A, -_A), (_A, _A)),
    4: ((-_A, -_A), (-_A, _A), (_A, -_A), (_A, _A)),
}


def averaged(
    display: Display, samples: int, make: Callable[[PixelOffset], SourceGenerator]
) -> SourceGenerator:
    """Generator with one or several rays per panel pixel or sub-pixel.

    * `samples`, {1, 2, 4}: rays through the centre; through two points on the diagonal; through the
      centres of the quarters of the emitting area (`Display.pixel_fill`). Colours are averaged in
      linear light, and a hole counts as black.
    * `make`: creates the generator of the rays through one point of every pixel.
    """
    channels: dict[SubPixel, list[int]] = {}
    for channel, subpixel in enumerate(SUBPIXELS[display.subpixels]):
        place = replace(subpixel, turn=None)  # wherever it shines
        channels.setdefault(place, []).append(channel)
    fill = exact_length(display.pixel_fill)
    offsets = [
        (
            PixelOffset(
                down * subpixel.height * fill,
                subpixel.right + right * subpixel.width * fill,
                subpixel.channel,
            ),
            tuple(of_ray),
        )
        for subpixel, of_ray in channels.items()
        for down, right in _PLACES[samples]
    ]
    rays = [Ray(offset, of_ray, make(offset)) for offset, of_ray in offsets]
    if len(rays) == 1:
        return rays[0].generator
    first = rays[0].generator
    return ColouredRays(rays, cache(lambda: make(CENTRE)), display, first.shape, first.pixel_mm)


class ColouredRays(SourceGenerator):
    """Generator that shows the mean colours of the rays of each pixel.

    Its sources are those of the pixel centres.

    * `centre`: returns the generator of the sources, which pictures do without.
    * `display`, `shape`, `pixel_mm`: as for `SourceGenerator`.
    * `colour`, {"nearest", "linear", "averaged", "smooth"}: see `raycast.colour`.
    """

    def __init__(
        self,
        rays: Sequence[Ray],
        centre: Callable[[], SourceGenerator],
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        colour: str = NEAREST,
        reads: type = LayeredRGBD,
    ) -> None:
        super().__init__(display, shape, pixel_mm)
        self._rays, self._centre, self._colour = list(rays), centre, colour
        self._reads, self._groups = reads, group_rays(rays)

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        return self._centre().sources(rgbd)

    def rays(self) -> list[Ray]:
        """See `SourceGenerator.rays`."""
        return self._rays

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`; a hole counts as black."""
        self.check(rgbd)
        out = self.place(rgbd, out)
        if isinstance(rgbd, LayeredRGBD) and self._reads is RGBD:
            rgbd = RGBD(rgbd.color, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
        show_colours(rgbd, self.display, self._colour, self._groups, out)
        return out
