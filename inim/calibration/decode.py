"""Decoding: the panel pixel that each camera pixel sees, from photographs of the patterns.

A bit of the Gray code is 1 if a photograph is brighter than that of the inverse pattern. It is
certain if the two differ by a large part of the difference between white and black. Neighbouring
cells differ in one bit, so one bit may be uncertain. Two bits are uncertain where a camera pixel
sees two lenses; it is then not decoded.

The cosine's phase, from its four steps I0 to I3, is atan2(I1 - I3, I0 - I2). Constant light and
the second harmonic, which a wrong gamma causes, cancel. Its period is the one nearest to the
centre of the cell.

Decoding cannot detect that the browser scaled the patterns, because patterns of any scale decode.
The scale affects only the step between lenses, which must be the lens pitch in panel pixels.
`lattice` checks it when it indexes the lenses.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

from inim.calibration.patterns import CELL, PERIOD, Position, bit_count, read_photograph
from inim.errors import FileError

# A lens is lit where it has this share of the light that bright ones have.
_LIT_SHARE = 0.1
_BRIGHT_QUANTILE = 0.95
# Bright lenses below this are lost in noise and rounding; 1 is the brightest code.
_DARKEST = 0.03
_FEWEST_LIT = 0.005
# Codes from 254 on: JPEG moves them by one.
_SATURATED_LIGHT = 0.99
_MOST_SATURATED = 0.02
# Light of a picture and its inverse against that of white and black, relative to their difference,
# on average. Bits that have nothing in common are 0.5 off, exposures that differ by a third 0.17;
# phases in a wrong order 0.45, and a camera's tone curve bends the cosine by some 0.1.
_MOST_UNLIKE = 0.15
_MOST_BENT = 0.3
# A bit's contrast: where it is sure, and the least that half of the finest bits must have.
_SURE = 0.5
_LEAST_CONTRAST = 0.6
# Of the cosine's amplitude, where its phase means something.
_LEAST_MODULATION = 0.3
# Phases lie within their cell, give or take what one unsure bit moves; at random, 5 in 8 would.
_NEAR_CELL = 5.0
_LEAST_AGREEMENT = 0.8
_MOST_FROM_CELL = 6.0
# A lens's view departs from a smooth map of the panel by half a lens; bits in a wrong order, by
# much of the panel. Panel pixels, and share of what is seen of the panel.
_ROUGHEST_PX, _ROUGHEST_SHARE = 2.0 * PERIOD, 0.01
_MOST_FITTED = 20_000
# Of what is known, beyond the panel.
_MOST_BEYOND = 0.01
# Camera pixels along a side of the square that noise is estimated in.
_NOISE_WINDOW = 9


class Decoded(NamedTuple):
    """Panel coordinates that the pixels of a camera see, (H, W) float32 each."""

    #: Panel coordinates in pixels. 0 is the panel's left or top edge, and a pixel's centre is at n
    #: + 0.5. NaN, for both, if not decoded. They are means over a camera pixel's blur: within an
    #: aberrated lens they change less than along rays through its centre, by half the variance of
    #: the blur times the mapping's second derivative.
    column: np.ndarray
    row: np.ndarray
    #: Their estimated standard error, panel pixels: noise, and 1 / sqrt(12) of a pixel. Neighbours
    #: that see one panel pixel share this quantisation error.
    error_px: np.ndarray
    lit: np.ndarray  #: White minus black, linear; 1 is the camera's brightest code.


class _Lights(NamedTuple):
    """White and black of a position, and where lenses shine."""

    white: np.ndarray
    black: np.ndarray
    contrast: np.ndarray
    shining: np.ndarray


class _Axis(NamedTuple):
    """Coordinates along one axis, their error, and a mask of decoded pixels."""

    coordinate: np.ndarray
    error: np.ndarray
    decoded: np.ndarray


def decode(position: Position) -> Decoded:
    """Decode the photographs of one camera position.

    * `position`: its photographs are read one after another.

    Raises `FileError`: a photograph that cannot be read; too dark, saturated, unsharp; not in the
    order of the patterns; or of another display's patterns. The line names the photographs.
    """
    rows, columns = position.panel
    paths = list(position.photographs)
    lights = _lights(*paths[:2])
    split = 2 + 2 * bit_count(columns) + 4
    across = _axis(paths[2:split], lights, columns, "columns")
    down = _axis(paths[split:], lights, rows, "rows")
    decoded = across.decoded & down.decoded
    nowhere = np.float32(np.nan)
    quantised = np.float32(1 / 12)
    error = np.sqrt(quantised + np.maximum(across.error, down.error) ** 2)
    return Decoded(
        np.where(decoded, across.coordinate, nowhere),
        np.where(decoded, down.coordinate, nowhere),
        np.where(decoded, error, nowhere),
        lights.white - lights.black,
    )


def _lights(white_path: Path, black_path: Path) -> _Lights:
    white, black = read_photograph(white_path), read_photograph(black_path)
    lit = white - black
    bright = float(np.quantile(lit, _BRIGHT_QUANTILE))
    darker = float(np.quantile(-lit, _BRIGHT_QUANTILE))
    if darker > max(bright, _DARKEST):
        raise FileError(
            f"{white_path}: is darker than {black_path.name}; photograph the patterns in their "
            "order, white first"
        )
    shining = lit > _LIT_SHARE * max(bright, _DARKEST)
    if bright < _DARKEST or shining.mean() < _FEWEST_LIT:
        raise FileError(
            f"{white_path}: hardly brighter than {black_path.name} ({bright:.1%} of the brightest "
            "code); expose longer, darken the room, and let the display fill the picture"
        )
    saturated = float((white[shining] > _SATURATED_LIGHT).mean())
    if saturated > _MOST_SATURATED:
        raise FileError(
            f"{white_path}: saturated in {saturated:.0%} of the lit area; use a shorter exposure "
            "for all photographs of this position"
        )
    return _Lights(white, black, np.maximum(lit, np.float32(1e-6)), shining)


def _axis(paths: Sequence[Path], lights: _Lights, pixels: int, axis_name: str) -> _Axis:
    """Decode the pictures of one axis: pairs of bits, then four phases."""
    shining = lights.shining
    cell, second_least = _cells(paths[:-4], lights)
    first, quarter, half, last = map(read_photograph, paths[-4:])
    for pair, names in (
        ((first, half), (paths[-4], paths[-2])),
        ((quarter, last), (paths[-3], paths[-1])),
    ):
        _check_complement(pair, names, lights, _MOST_BENT)
    cosine, sine = (first - half) / 2, (quarter - last) / 2
    amplitude = np.hypot(cosine, sine)
    within = np.arctan2(sine, cosine) * np.float32(PERIOD / (2 * np.pi))
    middle = (cell.astype(np.float32) + np.float32(0.5)) * CELL
    coordinate = within + PERIOD * np.rint((middle - within) / PERIOD)
    modulated = amplitude > _LEAST_MODULATION / 2 * lights.contrast
    decoded = shining & (second_least > _SURE) & modulated
    _check_sharp(second_least, shining, paths)
    if not decoded.any():
        raise FileError(
            f"{paths[-4]}: no lens shows the cosine of the {axis_name}; take sharp photographs of "
            "the patterns"
        )
    agreement = float((np.abs(coordinate - middle)[decoded] < _NEAR_CELL).mean())
    if agreement < _LEAST_AGREEMENT:
        raise FileError(
            f"{paths[0].parent}: bits and phases of the {axis_name} ({paths[0].name} to "
            f"{paths[-1].name}) agree in {agreement:.0%} of the pixels; photograph all patterns "
            "once, in order"
        )
    decoded &= np.abs(coordinate - middle) < _MOST_FROM_CELL
    _check_order(coordinate, decoded, paths, axis_name)
    beyond = (coordinate < -CELL) | (coordinate > pixels + CELL)
    if (share := float(beyond[decoded].mean())) > _MOST_BEYOND:
        raise FileError(
            f"{paths[0].parent}: {share:.0%} of the pixels see {axis_name} beyond the panel's "
            f"{pixels}; give the display whose patterns were shown"
        )
    square = uniform_filter((first + half - quarter - last) ** 2, _NOISE_WINDOW)
    noise = np.sqrt(np.maximum(square, 0)) / 2  # sums without noise round to less than 0
    error = noise / (np.sqrt(2) * np.maximum(amplitude, np.float32(1e-6))) * (PERIOD / (2 * np.pi))
    return _Axis(coordinate, error.astype(np.float32), decoded & ~beyond)


def _cells(paths: Sequence[Path], lights: _Lights) -> tuple[np.ndarray, np.ndarray]:
    """Cell of each pixel, and the second least contrast of its bits."""
    shape = lights.white.shape
    cell, bit = np.zeros(shape, np.int32), np.zeros(shape, bool)
    least, second = np.ones(shape, np.float32), np.ones(shape, np.float32)
    for names in zip(paths[::2], paths[1::2], strict=True):
        pair = read_photograph(names[0]), read_photograph(names[1])
        _check_complement(pair, names, lights, _MOST_UNLIKE)
        difference = pair[0] - pair[1]
        bit = bit ^ (difference > 0)  # from Gray to binary, coarsest first
        cell = 2 * cell + bit
        contrast = np.abs(difference) / lights.contrast
        second = np.minimum(second, np.maximum(least, contrast))
        least = np.minimum(least, contrast)
    return cell, second


def _check_complement(
    pair: tuple[np.ndarray, np.ndarray], names: Sequence[Path], lights: _Lights, most: float
) -> None:
    """Raise where two pictures do not add up to white and black."""
    extra = pair[0] + pair[1] - lights.white - lights.black
    unlike = float(np.mean((np.abs(extra) / lights.contrast)[lights.shining]))
    if unlike > most:
        raise FileError(
            f"{names[0]} and {names[1].name}: are not a pattern and its inverse, their sum differs "
            f"from white and black by {unlike:.0%}; photograph all patterns once, in order, with "
            "camera and exposure fixed"
        )


def _check_order(
    coordinate: np.ndarray, decoded: np.ndarray, paths: Sequence[Path], axis_name: str
) -> None:
    """Raise unless panel coordinates are a smooth map of camera pixels, except at lens borders."""
    places = np.flatnonzero(decoded)
    places = places[:: 1 + len(places) // _MOST_FITTED]
    y, x = (axis / max(decoded.shape) for axis in np.unravel_index(places, decoded.shape))
    panel_coordinates = coordinate.ravel()[places]
    smooth = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    rough = np.abs(
        panel_coordinates - smooth @ np.linalg.lstsq(smooth, panel_coordinates, rcond=None)[0]
    )
    span = float(np.ptp(np.quantile(panel_coordinates, (0.05, 0.95))))
    if np.quantile(rough, 0.9) > _ROUGHEST_PX + _ROUGHEST_SHARE * span:
        raise FileError(
            f"{paths[0].parent}: the {axis_name} behind the lenses are in no order across the "
            f"photograph ({paths[0].name} to {paths[-1].name}); photograph the patterns in order"
        )


def _check_sharp(second_least: np.ndarray, shining: np.ndarray, paths: Sequence[Path]) -> None:
    contrast = float(np.median(second_least[shining]))
    if contrast < _LEAST_CONTRAST:
        raise FileError(
            f"{paths[0].parent}: blurred, half of the lit area shows less than {contrast:.0%} of "
            f"the bits' contrast (from {paths[0].name} on); focus on the lens sheet, hold the "
            "camera still, move closer"
        )
