"""Scores of one picture against another, on display-referred sRGB.

All three are pinned: window, data range, viewing conditions. Scores are compared with the same
scene's ceiling only, never across scenes.
"""

from __future__ import annotations

import math

import numpy as np

from inim.color import srgb_from_linear
from inim.errors import UsageError
from inim.row_bands import row_bands

__all__ = ["SSIM_WINDOW", "flip", "flip_map", "psnr_db", "score", "ssim", "ssim_map"]

# Wang et al. 2004: Gaussian window of 1.5 pixels.
_SSIM_SIGMA = 1.5
#: Side of that window in pixels, as scikit-image cuts it off at 3.5 sigma; the least picture side.
SSIM_WINDOW = 11
# A view at about arm's length on an ordinary monitor (0.7 m, 0.7 m wide, 3840 pixels).
_FLIP_PIXELS_PER_DEGREE = 67.0


def ssim_map(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    """Structural similarity of each pixel, (rows, columns) float32, mean over the channels.

    Parameters
    ----------
    reference, test : (rows, columns, 3) float32, linear RGB

    Source: Wang, Bovik, Sheikh and Simoncelli, IEEE TIP 2004, as in scikit-image, without the
    sample-covariance correction, as the paper defines it.
    """
    from skimage.metrics import structural_similarity

    _check_alike(reference, test)
    rows, columns = reference.shape[:2]
    found = np.empty((rows, columns), np.float32)
    for band in row_bands(rows, columns):
        # With what the window reaches beyond it, and no less than a window, seams do not show.
        first = max(0, min(band.start - SSIM_WINDOW // 2, rows - SSIM_WINDOW))
        reach = slice(first, max(band.stop + SSIM_WINDOW // 2, SSIM_WINDOW))
        _, local = structural_similarity(
            srgb_from_linear(reference[reach]),
            srgb_from_linear(test[reach]),
            data_range=1.0,
            channel_axis=-1,
            gaussian_weights=True,
            sigma=_SSIM_SIGMA,
            use_sample_covariance=False,
            full=True,
        )
        found[band] = local[band.start - first : band.stop - first].mean(axis=-1)
    return found


def ssim(reference: np.ndarray, test: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Mean of `ssim_map`, over a (rows, columns) bool mask if one is given."""
    return _mean(ssim_map(reference, test), mask)


def _mean(local: np.ndarray, mask: np.ndarray | None = None) -> float:
    return float(local.mean() if mask is None else local[mask].mean() if mask.any() else math.nan)


def psnr_db(reference: np.ndarray, test: np.ndarray) -> float:
    """Peak signal-to-noise ratio of sRGB in 0..1, dB; infinite for equal pictures."""
    _check_alike(reference, test)
    by_row: list[float] = []  # and these exactly: in bands of any height the same
    for band in row_bands(*reference.shape[:2]):
        first, second = (srgb_from_linear(image[band]) for image in (reference, test))
        squares = np.square(first.astype(np.float64) - second)
        by_row += squares.reshape(len(squares), -1).sum(axis=1).tolist()
    error = math.fsum(by_row) / reference.size
    return math.inf if error == 0 else -10 * math.log10(error)


def flip(reference: np.ndarray, test: np.ndarray) -> float:
    """Mean of `flip_map`."""
    return _mean(flip_map(reference, test))


def flip_map(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    """LDR-FLIP error of each pixel, (rows, columns), 0 (equal) to 1.

    Source: Andersson et al., HPG 2020, at 67 pixels per degree.
    """
    import flip_evaluator

    _check_alike(reference, test)
    # Floats: 8-bit input silently scores 0.
    local, _, _ = flip_evaluator.evaluate(
        srgb_from_linear(reference),
        srgb_from_linear(test),
        "LDR",
        inputsRGB=True,
        applyMagma=False,
        computeMeanError=False,
        parameters={"ppd": _FLIP_PIXELS_PER_DEGREE},
    )
    return np.asarray(local, np.float32).reshape(reference.shape[:2])


def score(
    reference: np.ndarray, test: np.ndarray, mask: np.ndarray | None = None
) -> dict[str, float]:
    """SSIM, PSNR and FLIP under their report names; with a mask, SSIM on the relic too."""
    local = ssim_map(reference, test)
    scores = {
        "ssim": _mean(local),
        "psnr_db": psnr_db(reference, test),
        "flip": flip(reference, test),
    }
    return scores if mask is None else scores | {"ssim_on_relic": _mean(local, mask)}


def _check_alike(reference: np.ndarray, test: np.ndarray) -> None:
    if reference.shape != test.shape or reference.ndim != 3 or reference.shape[2] != 3:
        raise UsageError(
            f"pictures of shape {reference.shape} and {test.shape} cannot be compared; "
            "both must be (rows, columns, 3)"
        )
    for name, image in (("reference", reference), ("test", test)):
        bands = row_bands(*image.shape[:2])
        bad = sum(int(np.count_nonzero(~np.isfinite(image[b]).all(axis=-1))) for b in bands)
        if bad:
            raise UsageError(f"the {name} picture has {bad} pixels that are not finite")
