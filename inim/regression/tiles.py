"""What is kept of a rendered picture: per tile its means, its power, and how sure they are.

A picture comes as two independent halves of its samples, `a` and `b`; the picture is their mean.
Whatever noise there is shows in ``a - b``: nothing about its law or its level is assumed, and a
single firefly raises a tile's mean and its error alike, so that it never counts as a change.

| kept, per tile of n pixels   | estimate                       | why                          |
| ---------------------------- | ------------------------------ | ---------------------------- |
| mean, per colour             | ``sum (a + b) / 2n``           | shifts, swaps, gamma, colour |
| its standard error, squared  | ``deff sum_s d_s^2 / 4n^2``    | both sides' noise counts     |
| degrees of freedom           | `freedom_of_sum` over ``deff`` | few noisy pixels, few of it  |
| power, mean over the colours | ``sum a b / n``                | noise or blur of equal means |

``a b`` has the expectation of the true square whatever the number of samples: halves are
independent. Pixels of a tile that show the same pixel of the RGB-D picture err alike, as those of
a generator's EIA do: they differ between the halves by the very same number, and ``d_s`` is the
sum of ``a - b`` over such a set s; in a rendered picture each pixel is a set of its own. ``deff``,
the design effect (Kish, Survey Sampling, 1965), covers dependence that does not show in this way,
such as means over several rays: what the means of a tile's halves differ by over what independent
sets would, over the whole picture; at least 1.

At silhouettes a few samples of the RGB-D picture hit or miss, and both halves may agree by chance:
a tile in which a few such pixels spread over many looks surer than it is. So in a generator's EIA
each tile's variance is moderated, that is, averaged with the picture's at `_PRIOR_FREEDOM` degrees
of freedom (Smyth, Stat. Appl. Genet. Mol. Biol. 3, 2004), which are not counted as its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from inim.image.noisy_image import NoisyImage, row_bands
from inim.regression.verdict import freedom_of_sum

# Views: small enough to see a shift of half a pixel at an edge, large enough for a standard error.
_LEAST_TILE_PX = 8
# Statistics of a picture take 40 bytes a tile: at most 40 KB, before compression.
_MOST_TILES_ALONG = 32
# Some 200 bytes each on the way.
_PIXELS_AT_ONCE = 2**18


@dataclass(frozen=True)
class TileStatistics:
    """Statistics of one picture's tiles.

    Attributes
    ----------
    tile : (int, int)
        Rows and columns of a tile in pixels; the last ones may be cut.
    shape : (int, int)
        Rows and columns of the picture.
    mean, mean_error : (R, C, 3) float32
        Linear RGB, and its standard error.
    power, power_error : (R, C) float32
        Mean square over pixels and colours, and its standard error.
    freedom : (R, C, 3) float32
        Degrees of freedom of `mean_error`; the least of the three holds for the power.
    """

    tile: tuple[int, int]
    shape: tuple[int, int]
    mean: np.ndarray
    mean_error: np.ndarray
    power: np.ndarray
    power_error: np.ndarray
    freedom: np.ndarray

    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays by name, as they are stored."""
        return {name: getattr(self, name) for name in self.array_names()}

    @classmethod
    def array_names(cls) -> tuple[str, ...]:
        """Names of the arrays."""
        return tuple(f.name for f in fields(cls) if f.name not in ("tile", "shape"))

    @classmethod
    def of(
        cls, tile: tuple[int, int], shape: tuple[int, int], arrays: Mapping[str, np.ndarray]
    ) -> TileStatistics:
        """From what was stored; raises ValueError where shapes do not fit together."""
        rows, columns = (math.ceil(n / size) for n, size in zip(shape, tile, strict=True))
        colours = (rows, columns, 3)
        wanted = {"power": colours[:2], "power_error": colours[:2]}
        kept = {}
        for name in cls.array_names():
            array = np.asarray(arrays[name], np.float32)
            if array.shape != wanted.get(name, colours):
                raise ValueError(f"{name} has the shape {array.shape}")
            kept[name] = array
        return cls(tile, shape, **kept)


def view_tile(shape: tuple[int, int]) -> tuple[int, int]:
    """Tile of a view: eight pixels square, larger where that makes more than 32 along a side."""
    size = max(_LEAST_TILE_PX, *(math.ceil(n / _MOST_TILES_ALONG) for n in shape))
    return size, size


def eia_tile(shape: tuple[int, int], lens_counts: tuple[int, int]) -> tuple[int, int]:
    """Tile of an EIA: about a whole number of elemental images, one where they are few.

    Parameters
    ----------
    shape : (rows, columns)
        Of the EIA.
    lens_counts : (rows, columns)
    """
    along = [math.ceil(lenses / _MOST_TILES_ALONG) for lenses in lens_counts]
    rows, columns = (
        max(1, round(n / lenses * step))
        for n, lenses, step in zip(shape, lens_counts, along, strict=True)
    )
    return rows, columns


def tile_statistics(
    image: NoisyImage,
    tile: tuple[int, int],
    *,
    generated: bool = False,
) -> TileStatistics:
    """Statistics of a picture from the two halves of its samples; see the module.

    Parameters
    ----------
    image : NoisyImage
        Read a band of rows at a time.
    tile : (int, int)
        Rows and columns of a tile.
    generated : bool
        Whether pixels may show the same pixel of another picture, as a generator's EIA does.
    """
    rows, columns = image.shape
    # Whole rows of tiles: what is found of a tile depends on its own pixels only.
    tiles = max(1, _PIXELS_AT_ONCE // (columns * tile[0]))
    found = [
        _Sums.of(*image.halves(band), tile, generated=generated)
        for band in row_bands(rows, columns, tiles * tile[0] * columns)
    ]
    all_tiles = _Sums(*(np.concatenate(each) for each in zip(*found, strict=True)))
    count = all_tiles.pixels
    variance = all_tiles.squares / np.square(count)[..., None]
    effect = _design_effect(np.square(all_tiles.halves / count[..., None]) / 4, variance)
    power_variance = all_tiles.spread / np.square(count)
    # No more than there are pixels, however even their noise happened to be.
    freedom = freedom_of_sum(all_tiles.squares, all_tiles.fourths)
    freedom = np.maximum(np.minimum(freedom, count[..., None]) / effect, 1.0)
    if generated:
        variance = _moderated(variance, freedom)
        power_variance = _moderated(power_variance, freedom.min(axis=-1))
    mean = all_tiles.mean / count[..., None]
    power = all_tiles.power / count
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
    """Sums over the pixels of each tile; see the module.

    Attributes
    ----------
    pixels, power, spread : (R, C) float64
        How many, `a b`, and squared errors of `a b`.
    mean, halves : (R, C, 3) float64
        Of ``(a + b) / 2`` and ``a - b``.
    squares, fourths : (R, C, 3) float64
        Powers of ``(a - b) / 2`` summed over each set.
    """

    pixels: np.ndarray
    mean: np.ndarray
    halves: np.ndarray
    squares: np.ndarray
    fourths: np.ndarray
    power: np.ndarray
    spread: np.ndarray

    @classmethod
    def of(
        cls, first: np.ndarray, second: np.ndarray, tile: tuple[int, int], *, generated: bool
    ) -> _Sums:
        """Of the two halves of a band of whole tiles."""
        a, b = first.astype(np.float64), second.astype(np.float64)
        difference = a - b
        count = _sums(np.ones(a.shape[:2]), tile)
        powers = _Sets(difference, tile, count.shape).powers if generated else _each(tile)
        noise = np.square(difference)
        # var(a b) = 2 x^2 s^2 + s^4 with s^2 from (a - b)^2 / 2 and s^4 from (a - b)^4 / 12,
        # Gaussian; a pixel's colours come from the same paths, so their errors are added, not their
        # squares.
        spread = np.sqrt(np.square((a + b) / 2) * noise + np.square(noise) / 12).mean(axis=-1)
        return cls(
            count,
            _sums((a + b) / 2, tile),
            _sums(a, tile) - _sums(b, tile),
            powers(difference / 2, 2),
            powers(difference / 2, 4),
            _sums((a * b).mean(axis=-1), tile),
            powers(spread[..., None], 2)[..., 0],
        )


def _each(tile: tuple[int, int]) -> Callable[[np.ndarray, int], np.ndarray]:
    """As `_Sets.powers` where each pixel is a set of its own."""
    return lambda values, power: _sums(values**power, tile)


class _Sets:
    """Pixels of a tile that err alike; see the module.

    Parameters
    ----------
    difference : (rows, columns, 3) float64
        Of the halves.
    tile : (int, int)
    tiles : (int, int)
        How many there are.
    """

    def __init__(
        self, difference: np.ndarray, tile: tuple[int, int], tiles: tuple[int, ...]
    ) -> None:
        self._tile, self._tiles = tile, tiles
        # One number for three colours: equal for equal ones, and for others only by chance.
        # Term by term: a matrix product's rounding may depend on where in the array a pixel stands.
        red, green, blue = (difference[..., c] for c in range(3))
        mixed = self._listed(red + 0.754877666 * green + 0.569840291 * blue)
        self._order = np.argsort(mixed, axis=-1)
        mixed = np.take_along_axis(mixed, self._order, axis=-1)
        begins = np.ones(mixed.shape, bool)
        begins[:, 1:] = np.diff(mixed, axis=-1) != 0
        self._starts = np.flatnonzero(begins)
        counts = np.count_nonzero(begins, axis=-1)
        self._tile_starts = np.concatenate([[0], np.cumsum(counts)[:-1]])

    def powers(self, values: np.ndarray, power: int) -> np.ndarray:
        """Per tile, the sum over its sets of a power of the set's sum, (R, C, channels)."""
        channels = [self._power(values[..., c], power) for c in range(values.shape[-1])]
        return np.stack(channels, axis=-1)

    def _power(self, values: np.ndarray, power: int) -> np.ndarray:
        ordered = np.take_along_axis(self._listed(values), self._order, axis=-1)
        sums = np.add.reduceat(ordered.ravel(), self._starts) ** power
        totals: np.ndarray = np.add.reduceat(sums, self._tile_starts)
        return totals.reshape(self._tiles)

    def _listed(self, values: np.ndarray) -> np.ndarray:
        """Each tile's pixels, (tiles, pixels); zeros, which add nothing, where it is cut."""
        sides = [
            (0, n * size - m)
            for n, size, m in zip(self._tiles, self._tile, values.shape, strict=True)
        ]
        padded = np.pad(values, sides)
        (rows, columns), (height, width) = self._tiles, self._tile
        blocks = padded.reshape(rows, height, columns, width).swapaxes(1, 2)
        return blocks.reshape(rows * columns, height * width)


def _sums(values: np.ndarray, tile: tuple[int, int]) -> np.ndarray:
    """Sums over tiles; the last ones may be cut."""
    for axis, size in enumerate(tile):
        values = np.add.reduceat(values, np.arange(0, values.shape[axis], size), axis=axis)
    return values


def _moderated(variance: np.ndarray, freedom: np.ndarray) -> np.ndarray:
    """Variances averaged with their mean over all noisy tiles; see the module."""
    noisy = variance > 0
    if not noisy.any():
        return variance
    prior = variance[noisy].mean()
    mixed = (_PRIOR_FREEDOM * prior + freedom * variance) / (_PRIOR_FREEDOM + freedom)
    return np.where(noisy, mixed, 0.0)


def _design_effect(observed: np.ndarray, independent: np.ndarray) -> float:
    """How many times the variance of tiles' means is that of independent pixels; 1 at least.

    The larger of two estimates: the ratio of the sums over all tiles, which the noisiest tiles
    decide, and the median ratio over that of a squared standard normal, which the many decide.
    """
    known = independent > 0
    if not known.any():
        return 1.0
    seen, alone = observed[known], independent[known]
    many = float(np.median(seen / alone)) / _MEDIAN_CHI_SQUARE_1
    return max(1.0, float(seen.sum() / alone.sum()), many)


# At 5, p-values of fresh seeds below 1e-4 are as frequent as they say where a generator repeats
# pixels most (wang2024 on a jade disc, 24 x 24 lenses, 16 samples); without, three times as much.
_PRIOR_FREEDOM = 5.0
# Half of all squared standard normal numbers lie below it.
_MEDIAN_CHI_SQUARE_1 = 0.454936
