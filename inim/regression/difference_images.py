"""Pictures of what changed, as far as a baseline's statistics can show it."""

from __future__ import annotations

import numpy as np

from inim.display import Display
from inim.regression.inference import FALSE_ALARM_RATE, sidak
from inim.regression.pictures import tile_change
from inim.regression.reference_eia import Fingerprint, sampled_pixels
from inim.regression.tiles import TileStatistics

__all__ = ["changed_pixels", "tile_pictures"]

# Changes are shown this many times larger, and those that failed at least this bright.
_GAIN = 8.0
_LEAST_SHOWN = 0.35
_BRIGHTER, _DARKER = np.array([1.0, 0.25, 0.05]), np.array([0.05, 0.3, 1.0])


def tile_pictures(
    baseline: TileStatistics, candidate: TileStatistics
) -> tuple[np.ndarray, np.ndarray]:
    """The baseline's tiles and their change, each (rows, columns, 3) float32, linear RGB.

    Red grew brighter, blue darker; only tiles that failed are in colour, others at a tenth.
    """
    change = tile_change(baseline, candidate, sidak(FALSE_ALARM_RATE, 4 * baseline.power.size))
    codes = np.nan_to_num(change.codes, nan=255.0)
    largest = np.argmax(np.abs(codes), axis=-1)[..., None]
    signed = np.take_along_axis(codes, largest, axis=-1)[..., 0]
    size = np.minimum(1.0, _GAIN * np.abs(signed) / 255)
    size = np.where(change.failed, np.maximum(size, _LEAST_SHOWN), 0.1 * size)
    colour = np.where((signed > 0)[..., None], _BRIGHTER, _DARKER) * size[..., None]
    return _enlarged(np.nan_to_num(baseline.mean), baseline), _enlarged(colour, baseline)


def _enlarged(tiles: np.ndarray, found: TileStatistics) -> np.ndarray:
    whole = np.repeat(np.repeat(tiles, found.tile[0], axis=0), found.tile[1], axis=1)
    cut: np.ndarray = whole[: found.shape[0], : found.shape[1]].astype(np.float32)
    return cut


def changed_pixels(old: Fingerprint, new: Fingerprint, display: Display) -> np.ndarray:
    """Where the looked-at pixels of the fixed picture's EIA are: grey if equal, red if changed."""
    picture = np.zeros((*display.eia_shape, 3), np.float32)
    flat = picture.reshape(-1, 3)
    changed = (np.abs(old.sample.astype(np.int16) - new.sample) > 1).any(axis=-1)
    at = sampled_pixels(display)
    flat[at] = 0.2
    flat[at[changed]] = _BRIGHTER
    return picture
