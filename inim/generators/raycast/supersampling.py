"""Supersampling: several rays per panel pixel, averaged in linear light, and rays per sub-pixel.

One ray per pixel aliases: an elemental image is a small, sharp picture of the scene, and textures
and silhouettes finer than its pixels flicker.

The rays of a red stripe start at the left of the pixel, a third of a pixel from the green stripe's:
each colour channel is a separate image with its own rays.

Only pixels whose rays have different sources are averaged. In all others, most of a panel, the mean
of equal colours is that colour, bit for bit, because the weights are powers of two.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cache, cached_property

import numpy as np

from inim.backend.kernels import compiled, prange
from inim.display import Display
from inim.display.pixels import SUBPIXELS, SubPixel, exact_length
from inim.generators.base import CENTRE, PixelOffset, Ray, SourceGenerator, Sources
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.image.rgbd import RGBD

_WHOLE = SUBPIXELS["none"][0]
_A = Fraction(1, 4)
_PLACES: dict[int, tuple[PixelOffset, ...]] = {
    2: ((-_A, -_A), (_A, _A)),
    4: ((-_A, -_A), (-_A, _A), (_A, -_A), (_A, _A)),
}
# Equal steps of linear light, each with one code's begin at most: sRGB is steepest at black, with
# 12.92 * 255 codes to the unit.
_STEPS = 4096


def averaged(
    display: Display, samples: int, make: Callable[[PixelOffset], SourceGenerator]
) -> SourceGenerator:
    """Generator with one or several rays per panel pixel or sub-pixel.

    Parameters
    ----------
    display : Display
    samples : {1, 2, 4}
        Rays through the centre; through two points on the diagonal; through the centres of the
        quarters of the emitting area (`Display.pixel_fill`). Colours are averaged in linear light,
        and a hole counts as black.
    make : callable
        Creates the generator of the rays through one point of every pixel.
    """

    def of_subpixel(subpixel: SubPixel) -> SourceGenerator:
        if samples == 1:
            return make((Fraction(0), subpixel.right))
        return Supersampled(make, _sampled_places(samples, subpixel, display.pixel_fill))

    if display.subpixels == "none":
        return of_subpixel(_WHOLE)
    return Subpixelled(display.subpixels, of_subpixel)


def _sampled_places(samples: int, subpixel: SubPixel, pixel_fill: float) -> tuple[PixelOffset, ...]:
    """Ray offsets for a sample count: centres of the quarters of a pixel's emitting area.

    Parameters
    ----------
    samples : {2, 4}
        Two quarters on a diagonal, or all.
    subpixel : SubPixel
    pixel_fill : float
        `Display.pixel_fill`.
    """
    fill = exact_length(pixel_fill)
    return tuple(
        (down * fill, subpixel.right + right * subpixel.width * fill)
        for down, right in _PLACES[samples]
    )


class Supersampled(SourceGenerator):
    """Generator that averages the colours of several rays per pixel.

    Its sources are those of the pixel centres.

    Parameters
    ----------
    make : callable
        Creates the generator of the rays through one point of every pixel.
    places : sequence of PixelOffset
        Two or four offsets.
    """

    def __init__(
        self, make: Callable[[PixelOffset], SourceGenerator], places: Sequence[PixelOffset]
    ) -> None:
        self._make = make
        self._each = [make(place) for place in places]
        first = self._each[0]
        super().__init__(first.display, first.shape, first.pixel_mm, first.pixels)

    @cached_property
    def _centre(self) -> SourceGenerator:
        """Made when sources are wanted: pictures do without."""
        return self._make(CENTRE)

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        return self._centre.find(rgbd)

    def rays(self) -> list[Ray]:
        """See `SourceGenerator.rays`."""
        return [ray for generator in self._each for ray in generator.rays()]

    @cached_property
    def _sources(self) -> np.ndarray:
        """Arrays for `samples`, reused for the next picture."""
        return np.empty((len(self._each), *self.result_shape), np.int32)

    def samples(self, rgbd: RGBD) -> np.ndarray:
        """Sources of each ray of every pixel, (rays, rows, columns), until the next call."""
        for generator, sources in zip(self._each, self._sources, strict=True):
            generator.sources(rgbd, sources)
        return self._sources

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`; a hole counts as black."""
        out = self.place(rgbd, out)
        palette = rgbd.palette.reshape(-1, rgbd.color.shape[2])
        if rgbd.color.dtype != np.uint8:
            _mean_colours(self.samples(rgbd), palette, out)
            return out
        # Light adds up, code values do not: average linear light, then encode again.
        # A hole's colour comes first.
        words = np.zeros(len(palette) + 1, np.uint32)
        linear = np.zeros((len(words), 4), np.float32)
        words[1:] = palette.view(np.uint32)[:, 0]
        decode_light(palette, linear[1:])
        mean = out.view(np.uint32)[..., 0]
        _mean_codes(self.samples(rgbd), words, linear, *transfer_tables()[2:], mean)
        return out


class Subpixelled(SourceGenerator):
    """Generator that takes each colour channel from a separate generator of its sub-pixels.

    Its sources are those of the pixel centres. Pixels that lack a colour (`SubPixel.turn`) receive
    the value of their neighbours' sub-pixel: panels are driven by whole pixels and
    omit colours that they cannot show. In RGBA, alpha is the mean of the three.

    Parameters
    ----------
    pattern : str
        `Display.subpixels`.
    make : callable
        Creates the generator of one sub-pixel of every pixel.
    """

    def __init__(self, pattern: str, make: Callable[[SubPixel], SourceGenerator]) -> None:
        self._make = make
        channels: dict[SubPixel, list[int]] = {}
        for channel, subpixel in enumerate(SUBPIXELS[pattern]):
            place = SubPixel(subpixel.right, subpixel.width)  # wherever it shines
            channels.setdefault(place, []).append(channel)
        self._each = [(make(place), channel) for place, channel in channels.items()]
        first = self._each[0][0]
        super().__init__(first.display, first.shape, first.pixel_mm, first.pixels)

    @cached_property
    def _centre(self) -> SourceGenerator:
        """Made when sources are wanted: pictures do without."""
        return self._make(_WHOLE)

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        return self._centre.find(rgbd)

    def rays(self) -> list[Ray]:
        """See `SourceGenerator.rays`."""
        return [
            ray._replace(channels=tuple(channels))
            for generator, channels in self._each
            for ray in generator.rays()
        ]

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`."""
        out = self.place(rgbd, out)
        alpha = np.full(out.shape[:2], 1, np.uint16)  # to round the mean to the nearest
        for generator, channels in self._each:
            image = generator.generate(rgbd)
            for channel in channels:
                out[..., channel] = image[..., channel]
            if out.dtype == np.uint8:
                alpha += image[..., 3] * np.uint16(len(channels))
        if out.dtype == np.uint8:
            out[..., 3] = alpha // 3
        return out


def decode_light(colours: np.ndarray, light: np.ndarray | None = None) -> np.ndarray:
    """Linear light and opacity, (n, 4) float32, of sRGB codes (n, 4) or linear RGB (n, 3)."""
    if light is None:
        light = np.empty((len(colours), 4), np.float32)
    if colours.dtype == np.uint8:
        _decode(colours, *transfer_tables()[:2], light)
    else:
        light[:, :3], light[:, 3] = colours, 1
    return light


def encode_light(light: np.ndarray) -> np.ndarray:
    """The sRGB codes and alpha, (n, 4) uint8, of linear light and opacity."""
    codes = np.empty(light.shape, np.uint8)
    _encode(light, *transfer_tables()[2:], codes)
    return codes


@cache
def transfer_tables() -> tuple[np.ndarray, ...]:
    """Light and opacity of each 8-bit code, code at the start of each step, and lowest light of
    each code.

    The codes equal those of `inim.image.color` for float32, without interpolation.
    """
    opacity = np.arange(256, dtype=np.float32) / np.float32(255)
    # The codes grow with the light, and positive floats with their bits: bisect on these.
    codes = np.arange(1, 256)
    below, begins = np.zeros(255, np.uint32), np.full(255, np.float32(1).view(np.uint32))
    while (begins - below > 1).any():
        middle = below + (begins - below) // 2
        reached = _code(middle.view(np.float32)) >= codes
        below, begins = np.where(reached, below, middle), np.where(reached, middle, begins)
    first = np.append(begins.view(np.float32), np.float32(np.inf))  # nothing follows white
    step_code = _code(np.arange(_STEPS + 1, dtype=np.float32) / np.float32(_STEPS))
    return linear_from_srgb(opacity), opacity, step_code, first


def _code(linear: np.ndarray) -> np.ndarray:
    return srgb_to_uint8(srgb_from_linear(linear))


@compiled(parallel=True)
def _mean_colours(sources, palette, mean):  # type: ignore[no-untyped-def]
    """Mean over (rays, rows, columns) sources of the colours of a palette, (n, channels)."""
    rays, rows, columns = sources.shape
    share = np.float32(1 / rays)
    for row in prange(rows):
        for column in range(columns):
            first, same = sources[0, row, column], True
            for ray in range(1, rays):
                same &= sources[ray, row, column] == first
            for c in range(mean.shape[2]):
                light = np.float32(0)
                if not same:
                    for ray in range(rays):
                        source = sources[ray, row, column]
                        if source >= 0:
                            light += share * palette[source, c]
                elif first >= 0:
                    light = palette[first, c]
                mean[row, column, c] = light


@compiled(parallel=True)
def _decode(codes, light, opacity, linear):  # type: ignore[no-untyped-def]
    """Light and opacity of (n, 4) codes; see `transfer_tables`."""
    for n in prange(len(codes)):
        for c in range(3):
            linear[n, c] = light[codes[n, c]]
        linear[n, 3] = opacity[codes[n, 3]]


@compiled(parallel=True)
def _encode(light, step_code, code_begins, codes):  # type: ignore[no-untyped-def]
    """Codes of (n, 4) light and opacity."""
    for n in prange(len(light)):
        for c in range(3):
            codes[n, c] = light_code(light[n, c], step_code, code_begins)
        codes[n, 3] = opacity_code(light[n, 3])


@compiled(parallel=True)
def _mean_codes(sources, words, linear, step_code, code_begins, mean):  # type: ignore[no-untyped-def]
    """Mean RGBA words over (2 or 4, rows, columns) sources of colours, in their light (n, 4).

    A source's colour is at the next index, a hole's at the first. With two rays the other two count
    as holes, which add zero.
    """
    rays, rows, columns = sources.shape
    share = np.float32(1 / rays)
    for row in prange(rows):
        third, fourth = sources[rays - 2, row], sources[rays - 1, row]
        for column in range(columns):
            a = _colour(sources[0, row, column])
            b = _colour(sources[1, row, column])
            c, d = _colour(third[column]), _colour(fourth[column])
            word = words[a]
            if words[b] == word and words[c] == word and words[d] == word:
                mean[row, column] = word
                continue
            if rays == 2:
                c = d = np.uintp(0)
            word = opacity_code(_sum(linear, a, b, c, d, 3, share)) << np.uint32(24)
            for channel in range(3):
                total = _sum(linear, a, b, c, d, channel, share)
                word |= light_code(total, step_code, code_begins) << np.uint32(8 * channel)
            mean[row, column] = word


@compiled
def _colour(source):  # type: ignore[no-untyped-def]
    """Index of a source's colour."""
    return np.uintp(max(source, -1) + 1)


@compiled
def _sum(linear, a, b, c, d, channel, share):  # type: ignore[no-untyped-def]
    return (
        share * linear[a, channel]
        + share * linear[b, channel]
        + share * linear[c, channel]
        + share * linear[d, channel]
    )


@compiled
def light_code(light, step_code, code_begins):  # type: ignore[no-untyped-def]
    """The sRGB code of linear light; see `transfer_tables`."""
    clipped = min(light, np.float32(1))
    code = np.uint32(step_code[np.uintp(clipped * np.float32(_STEPS))])
    return code + np.uint32(clipped >= code_begins[np.uintp(code)])


@compiled
def opacity_code(alpha):  # type: ignore[no-untyped-def]
    """The code of an opacity, to the nearest and the even one, without a call of the C library."""
    whole = np.float32(2**23)
    return np.uint32((alpha * np.float32(255) + whole) - whole)
