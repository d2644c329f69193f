"""Tile statistics of a rendered image: means, power and their errors.

An image is the mean of two independent halves of its samples, `a` and `b`; ``a - b`` is pure noise.

| stored, per tile of n pixels | estimate                       | purpose                      |
| ---------------------------- | ------------------------------ | ---------------------------- |
| mean, per colour             | ``sum (a + b) / 2n``           | shifts, swaps, gamma, colour |
| its standard error, squared  | ``deff sum_s d_s^2 / 4n^2``    | noise of both runs           |
| degrees of freedom           | `freedom_of_sum` over ``deff`` | few if few pixels are noisy  |
| power, mean over the colours | ``sum a b / n``                | noise or blur of equal means |

``d_s`` is the sum of ``a - b`` over a set s of pixels with equal errors: those of a generator's EIA
that show the same pixel of the RGB-D picture, otherwise each pixel. ``deff``, the design effect,
covers other dependence. Variances in a generator's EIA are moderated by the image's variance,
because both halves may agree by chance. Reasons and sources: docs/theory/regression.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from inim.image.noisy_image import NoisyImage
from inim.scores.regression.verdict import freedom_of_sum
from inim.system.row_bands import row_bands

# Views: small enough to detect a shift of half a pixel at an edge, large enough for an error.
_MIN_TILE_PX = 8
# Statistics take 40 bytes per tile: at most 40 KB per image, before compression.
_MAX_TILES_PER_SIDE = 32
# Intermediate results take about 200 bytes per pixel.
_PIXELS_AT_ONCE = 2**18


@dataclass(frozen=True)
class TileStatistics:
    """Statistics of an image's tiles."""

    tile: tuple[int, int]  #: Rows and columns of a tile in pixels; the last ones may be cut.
    shape: tuple[int, int]  #: Rows and columns of the image.
    #: (R, C, 3) float32: linear RGB, and its standard error.
    mean: np.ndarray
    mean_error: np.ndarray
    #: (R, C) float32: mean square over pixels and colours, and its standard error.
    power: np.ndarray
    power_error: np.ndarray
    #: (R, C, 3) float32: degrees of freedom of `mean_error`; the smallest of the three also applies
    #: to the power.
    freedom: np.ndarray

    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays to store, by name."""
        return {name: getattr(self, name) for name in self.array_names()}

    @classmethod
    def array_names(cls) -> tuple[str, ...]:
        """Names of the arrays."""
        return tuple(f.name for f in fields(cls) if f.name not in ("tile", "shape"))

    @classmethod
    def of(
        cls, tile: tuple[int, int], shape: tuple[int, int], arrays: Mapping[str, np.ndarray]
    ) -> TileStatistics:
        """Build from stored arrays; raises ValueError for inconsistent shapes."""
        rows, columns = (math.ceil(n / size) for n, size in zip(shape, tile, strict=True))
        with_colours = (rows, columns, 3)
        shapes = {"power": with_colours[:2], "power_error": with_colours[:2]}
        values = {}
        for name in cls.array_names():
            array = np.asarray(arrays[name], np.float32)
            if array.shape != shapes.get(name, with_colours):
                raise ValueError(f"{name} has the shape {array.shape}")
            values[name] = array
        return cls(tile, shape, **values)


def view_tile(shape: tuple[int, int]) -> tuple[int, int]:
    """Tile of a view: a square of eight pixels, or larger for at most 32 tiles along a side."""
    size = max(_MIN_TILE_PX, *(math.ceil(n / _MAX_TILES_PER_SIDE) for n in shape))
    return size, size


def eia_tile(shape: tuple[int, int], lens_counts: tuple[int, int]) -> tuple[int, int]:
    """Tile of an EIA: approximately a whole number of elemental images.

    Both arguments are (rows, columns): of the EIA, and of its lenses.
    """
    steps = [math.ceil(lenses / _MAX_TILES_PER_SIDE) for lenses in lens_counts]
    rows, columns = (
        max(1, round(n / lenses * step))
        for n, lenses, step in zip(shape, lens_counts, steps, strict=True)
    )
    return rows, columns


def tile_statistics(
    image: NoisyImage, tile: tuple[int, int], *, generated: bool = False
) -> TileStatistics:
    """Compute the statistics of an image from the two halves of its samples; see the module.

    `tile` are the rows and columns of a tile; `generated` is True for a generator's EIA, whose
    pixels may show the same pixel of the RGB-D picture.
    """
    rows, columns = image.shape
    # Whole rows of tiles, so that a tile's statistics depend on its own pixels only.
    tiles = max(1, _PIXELS_AT_ONCE // (columns * tile[0]))
    bands = [
        _Sums.of(*image.halves(band), tile, generated=generated)
        for band in row_bands(rows, columns, tiles * tile[0] * columns)
    ]
    sums = _Sums(*(np.concatenate(arrays) for arrays in zip(*bands, strict=True)))
    count = sums.pixels
    variance = sums.squares / np.square(count)[..., None]
    effect = _design_effect(np.square(sums.halves / count[..., None]) / 4, variance)
    power_variance = sums.spread / np.square(count)
    # At most the number of pixels, regardless of how uneven their noise is.
    freedom = freedom_of_sum(sums.squares, sums.fourths)
    freedom = np.maximum(np.minimum(freedom, count[..., None]) / effect, 1.0)
    if generated:
        variance = _moderate(variance, freedom)
        power_variance = _moderate(power_variance, freedom.min(axis=-1))
    mean = sums.mean / count[..., None]
    power = sums.power / count
    return TileStatistics(
        tile,
        (rows, columns),
        mean.astype(np.float32),
        np.sqrt(effect * variance).astype(np.float32),
        power.astype(np.float32),
        np.sqrt(effect * power_variance).astype(np.float32),
        freedom.astype(np.float32),
    )


class _Sums(NamedTuple):
    """Sums over the pixels of each tile; see the module."""

    pixels: np.ndarray  #: (R, C) float64: number of pixels.
    #: (R, C, 3) float64: sums of ``(a + b) / 2`` and ``a - b``.
    mean: np.ndarray
    halves: np.ndarray
    #: (R, C, 3) float64: sums over sets of powers of the set's ``(a - b) / 2``.
    squares: np.ndarray
    fourths: np.ndarray
    power: np.ndarray  #: (R, C) float64: sum of `a b`.
    spread: np.ndarray  #: (R, C) float64: sum of squared errors of `a b`.

    @classmethod
    def of(
        cls, first: np.ndarray, second: np.ndarray, tile: tuple[int, int], *, generated: bool
    ) -> _Sums:
        """Sum over a band of whole tiles, from its two halves."""
        a, b = first.astype(np.float64), second.astype(np.float64)
        difference = a - b
        count = _sums(np.ones(a.shape[:2]), tile)
        sums_of_powers = _pixel_powers(tile)
        if generated:
            sums_of_powers = _Sets(difference, tile, count.shape).sums_of_powers
        squares, fourths = sums_of_powers(difference / 2)
        noise = np.square(difference)
        # var(a b) = 2 x^2 s^2 + s^4 with s^2 from (a - b)^2 / 2 and s^4 from (a - b)^4 / 12,
        # Gaussian. A pixel's colours come from the same paths, so errors are added, not squares.
        spread = _mean_colour(np.sqrt(np.square((a + b) / 2) * noise + np.square(noise) / 12))
        return cls(
            count,
            _sums((a + b) / 2, tile),
            _sums(a, tile) - _sums(b, tile),
            squares,
            fourths,
            _sums(_mean_colour(a * b), tile),
            sums_of_powers(spread[..., None])[0][..., 0],
        )


def _mean_colour(values: np.ndarray) -> np.ndarray:
    """Mean over the last axis of length 3; faster than NumPy's."""
    mean: np.ndarray = (values[..., 0] + values[..., 1] + values[..., 2]) / 3
    return mean


# Function of values, (rows, columns, channels): sums over the sets of each tile of the second and
# of the fourth power of a set's sum, both (R, C, channels).
_SumsOfPowers = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def _pixel_powers(tile: tuple[int, int]) -> _SumsOfPowers:
    """Same as `_Sets.sums_of_powers` if each pixel is its own set."""

    def sums_of_powers(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        squares = np.square(values)
        return _sums(squares, tile), _sums(np.square(squares), tile)

    return sums_of_powers


class _Sets:
    """Sets of a tile's pixels with equal differences of the halves; see the module."""

    def __init__(
        self, difference: np.ndarray, tile: tuple[int, int], tiles: tuple[int, ...]
    ) -> None:
        self._tile, self._tiles = tile, tiles
        # One number per colour: equal for equal colours, and almost never for others. A matrix
        # product's rounding could depend on the position in the array, so add term by term.
        red, green, blue = (difference[..., c] for c in range(3))
        keys = self._by_tile(red + 0.754877666 * green + 0.569840291 * blue)
        self._order = np.argsort(keys, axis=-1)
        keys = np.take_along_axis(keys, self._order, axis=-1)
        begins = np.ones(keys.shape, bool)
        begins[:, 1:] = np.diff(keys, axis=-1) != 0
        self._starts = np.flatnonzero(begins)
        counts = np.count_nonzero(begins, axis=-1)
        self._tile_starts = np.concatenate([[0], np.cumsum(counts)[:-1]])

    def sums_of_powers(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `_SumsOfPowers`."""
        channels = [self._channel(values[..., c]) for c in range(values.shape[-1])]
        squares, fourths = zip(*channels, strict=True)
        return np.stack(squares, axis=-1), np.stack(fourths, axis=-1)

    def _channel(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        ordered = np.take_along_axis(self._by_tile(values), self._order, axis=-1)
        squares = np.square(np.add.reduceat(ordered.ravel(), self._starts))
        fourths = np.square(squares)
        by_tile = (np.add.reduceat(powers, self._tile_starts) for powers in (squares, fourths))
        squares, fourths = (sums.reshape(self._tiles) for sums in by_tile)
        return squares, fourths

    def _by_tile(self, values: np.ndarray) -> np.ndarray:
        """Pixels of each tile, (tiles, pixels); cut tiles are padded with zeros."""
        padding = [
            (0, n * size - m)
            for n, size, m in zip(self._tiles, self._tile, values.shape, strict=True)
        ]
        padded = np.pad(values, padding)
        (rows, columns), (height, width) = self._tiles, self._tile
        blocks = padded.reshape(rows, height, columns, width).swapaxes(1, 2)
        return blocks.reshape(rows * columns, height * width)


def _sums(values: np.ndarray, tile: tuple[int, int]) -> np.ndarray:
    """Sums over tiles; the last ones may be cut."""
    for axis, size in enumerate(tile):
        values = np.add.reduceat(values, np.arange(0, values.shape[axis], size), axis=axis)
    return values


def _moderate(variance: np.ndarray, freedom: np.ndarray) -> np.ndarray:
    """Average variances with their mean over all noisy tiles; see the module."""
    noisy = variance > 0
    if not noisy.any():
        return variance
    prior = variance[noisy].mean()
    mixed = (_PRIOR_FREEDOM * prior + freedom * variance) / (_PRIOR_FREEDOM + freedom)
    return np.where(noisy, mixed, 0.0)


def _design_effect(observed: np.ndarray, independent: np.ndarray) -> float:
    """Variance of tiles' means relative to that of independent pixels; at least 1.

    The larger of two estimates: the ratio of the sums over all tiles, dominated by the noisiest
    tiles, and the median ratio over the median of a squared standard normal.
    """
    noisy = independent > 0
    if not noisy.any():
        return 1.0
    observed, independent = observed[noisy], independent[noisy]
    median = float(np.median(observed / independent)) / _MEDIAN_CHI_SQUARE_1
    return max(1.0, float(observed.sum() / independent.sum()), median)


# At 5, p-values of fresh seeds below 1e-4 have the nominal frequency where a generator repeats
# pixels most (wang2024 on a jade disc, 24 x 24 lenses, 16 samples); without it, three times that.
_PRIOR_FREEDOM = 5.0
# Median of a squared standard normal.
_MEDIAN_CHI_SQUARE_1 = 0.454936
