"""Scores of one picture against another, on display-referred sRGB.

All three are pinned: window, data range, viewing conditions. Scores are compared with the same
scene's ceiling only, never across scenes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from inim.color import srgb_from_linear
from inim.errors import UsageError
from inim.row_bands import row_bands

__all__ = [
    "SSIM_WINDOW",
    "flip",
    "flip_map",
    "psnr_db",
    "score",
    "score_maps",
    "scores_of",
    "ssim",
    "ssim_map",
]

# Wang et al. 2004: Gaussian window of 1.5 pixels.
_SSIM_SIGMA = 1.5
#: Side of that window in pixels, as scikit-image cuts it off at 3.5 sigma; the least picture side.
SSIM_WINDOW = 11
# A view at about arm's length on an ordinary monitor (0.7 m, 0.7 m wide, 3840 pixels).
_FLIP_PIXELS_PER_DEGREE = 67.0
# How far its filters reach at that: three sigma of the blue-yellow contrast sensitivity, the
# widest, `sqrt(0.04 / (2 pi^2))` degrees.
_FLIP_REACH = math.ceil(3 * math.sqrt(0.04 / 2) / math.pi * _FLIP_PIXELS_PER_DEGREE)


def ssim_map(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    """Structural similarity of each pixel, (rows, columns) float32, mean over the channels.

    Parameters
    ----------
    reference, test : (rows, columns, 3) float32, linear RGB

    Source: Wang, Bovik, Sheikh and Simoncelli, IEEE TIP 2004, as in scikit-image, without the
    sample-covariance correction, as the paper defines it.
    """
    return score_maps(reference, test, ["ssim"])["ssim"]


def ssim(reference: np.ndarray, test: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Mean of `ssim_map`, over a (rows, columns) bool mask if one is given."""
    return _mean(ssim_map(reference, test), mask)


def _mean(local: np.ndarray, mask: np.ndarray | None = None) -> float:
    if mask is not None:
        local = local[mask]
    return float(local.mean(dtype=np.float64)) if local.size else math.nan


def psnr_db(reference: np.ndarray, test: np.ndarray) -> float:
    """Peak signal-to-noise ratio of sRGB in 0..1, dB; infinite for equal pictures."""
    _check_alike(reference, test)
    by_row: list[float] = []  # and these exactly: in bands of any height the same
    for band in row_bands(*reference.shape[:2]):
        first, second = (srgb_from_linear(image[band]) for image in (reference, test))
        squares = np.square(first.astype(np.float64) - second)
        by_row += squares.reshape(len(squares), -1).sum(axis=1).tolist()
    return _decibels(math.fsum(by_row) / reference.size)


def _decibels(squared_error: float) -> float:
    return math.inf if squared_error == 0 else -10 * math.log10(squared_error)


def flip(reference: np.ndarray, test: np.ndarray) -> float:
    """Mean of `flip_map`."""
    return _mean(flip_map(reference, test))


def flip_map(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    """LDR-FLIP error of each pixel, (rows, columns), 0 (equal) to 1.

    Source: Andersson et al., HPG 2020, at 67 pixels per degree.
    """
    return score_maps(reference, test, ["flip"])["flip"]


def score_maps(
    reference: np.ndarray, test: np.ndarray, names: Sequence[str] = ("ssim", "psnr_db", "flip")
) -> dict[str, np.ndarray]:
    """What the scores of those names are means of, (rows, columns) each; for PSNR, squared error.

    A relic stands before a black ground that is equal in both pictures. Where all that a filter
    reaches is equal, a map is as of equal pictures: whatever the weights, both sides of each
    comparison are the same numbers. So only the rest is filtered, a band of rows at a time.
    """
    _check_alike(reference, test)
    rows, columns = shape = reference.shape[:2]
    found: dict[str, np.ndarray] = {
        name: np.full(shape, _MAPS[name].where_equal, _MAPS[name].dtype) for name in names
    }
    reach = max((_MAPS[name].reach for name in names), default=0)
    near = _grown(_unlike(reference, test), reach, (rows, columns))
    for band in row_bands(near[0].stop - near[0].start, near[1].stop - near[1].start):
        part = slice(near[0].start + band.start, near[0].start + band.stop), near[1]
        # With what filters reach beyond it, seams do not show.
        around = _grown(part, reach, (rows, columns), SSIM_WINDOW)
        inside = _within(part, around)
        shown = srgb_from_linear(reference[around]), srgb_from_linear(test[around])
        for name, local in found.items():
            local[part] = _MAPS[name].of(*shown)[inside]
    return found


def _similarity(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    from skimage.metrics import structural_similarity

    _, local = structural_similarity(
        reference,
        test,
        data_range=1.0,
        channel_axis=-1,
        gaussian_weights=True,
        sigma=_SSIM_SIGMA,
        use_sample_covariance=False,
        full=True,
    )
    return _mean_of_channels(local)


def _squared_error(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    difference = reference.astype(np.float64) - test
    return _mean_of_channels(np.square(difference, out=difference))


def _flip_error(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    import flip_evaluator

    # Floats: 8-bit input silently scores 0.
    local, _, _ = flip_evaluator.evaluate(
        reference,
        test,
        "LDR",
        inputsRGB=True,
        applyMagma=False,
        computeMeanError=False,
        parameters={"ppd": _FLIP_PIXELS_PER_DEGREE},
    )
    return np.asarray(local, np.float32).reshape(reference.shape[:2])


def _mean_of_channels(values: np.ndarray) -> np.ndarray:
    """As `mean(axis=-1)`, which takes ten times as long over three."""
    mean: np.ndarray = (values[..., 0] + values[..., 1] + values[..., 2]) / 3
    return mean


class _Map(NamedTuple):
    """A map of how two pictures differ.

    Attributes
    ----------
    of : callable
        Of two (rows, columns, 3) float32 pictures in sRGB: (rows, columns).
    reach : int
        Pixels beyond its own on which a value depends.
    where_equal : float
        Value where all of them are equal.
    dtype : type
    """

    of: Callable[[np.ndarray, np.ndarray], np.ndarray]
    reach: int
    where_equal: float
    dtype: type


_MAPS = {
    "ssim": _Map(_similarity, SSIM_WINDOW // 2, 1.0, np.float32),
    "psnr_db": _Map(_squared_error, 0, 0.0, np.float64),
    "flip": _Map(_flip_error, _FLIP_REACH, 0.0, np.float32),
}


def scores_of(maps: Mapping[str, np.ndarray], mask: np.ndarray | None = None) -> dict[str, float]:
    """Scores from `score_maps`; with a (rows, columns) bool mask, SSIM on the relic too."""
    scores = {name: _mean(local) for name, local in maps.items()}
    if "psnr_db" in scores:
        scores["psnr_db"] = _decibels(scores["psnr_db"])
    return scores if mask is None else scores | {"ssim_on_relic": _mean(maps["ssim"], mask)}


def score(
    reference: np.ndarray, test: np.ndarray, mask: np.ndarray | None = None
) -> dict[str, float]:
    """SSIM, PSNR and FLIP under their report names; with a mask, SSIM on the relic too."""
    return scores_of(score_maps(reference, test), mask)


# Rows and columns of a picture.
_Part = tuple[slice, slice]


def _unlike(reference: np.ndarray, test: np.ndarray) -> _Part:
    """The smallest part of two pictures that has all their differences; empty without any."""
    rows, columns = reference.shape[:2]
    in_row, in_column = np.zeros(rows, bool), np.zeros(columns, bool)
    for band in row_bands(rows, columns):
        unlike = reference[band] != test[band]
        in_row[band] = unlike.any(axis=(1, 2))
        in_column |= unlike.any(axis=0).any(axis=-1)
    if not in_row.any():
        return slice(0, 0), slice(0, 0)
    (top, bottom), (left, right) = (np.flatnonzero(one)[[0, -1]] for one in (in_row, in_column))
    return slice(int(top), int(bottom) + 1), slice(int(left), int(right) + 1)


def _grown(part: _Part, by: int, shape: tuple[int, int], least: int = 1) -> _Part:
    """A part with what lies about it in a picture of that shape, no side less than `least`."""
    if part[0].stop == part[0].start:
        return part
    found = []
    for side, size in zip(part, shape, strict=True):
        first = max(0, min(side.start - by, size - least))
        found.append(slice(first, min(size, max(side.stop + by, first + least))))
    return found[0], found[1]


def _within(part: _Part, whole: _Part) -> _Part:
    """Where a part of the picture lies in another that holds it."""
    rows, columns = (
        slice(inner.start - outer.start, inner.stop - outer.start)
        for inner, outer in zip(part, whole, strict=True)
    )
    return rows, columns


def _check_alike(reference: np.ndarray, test: np.ndarray) -> None:
    if reference.shape != test.shape or reference.ndim != 3 or reference.shape[2] != 3:
        raise UsageError(
            f"pictures of shape {reference.shape} and {test.shape} cannot be compared; "
            "both must be (rows, columns, 3)"
        )
    for name, image in (("reference", reference), ("test", test)):
        bad = 0
        for band in row_bands(*image.shape[:2]):
            known = np.isfinite(image[band])
            if not known.all():  # seldom: a pixel's three are looked at in turn, which takes longer
                bad += int(np.count_nonzero(~known.all(axis=-1)))
        if bad:
            raise UsageError(f"the {name} picture has {bad} pixels that are not finite")
