"""Covariance of the fitted parameters, and the misfit that the residuals show.

Residuals of neighbouring lenses are not independent. Panel pixels beat with the lenses over whole
columns and rows: the sandwich estimate sums over both (Huber's sandwich, clustered: Liang and
Zeger, Biometrika 73, 13, 1986). Both sums are added. This counts uncorrelated residuals twice,
which is conservative. Effects that the model does not include change smoothly over the sheet. The
residuals' components in the space of low-order polynomials give their size, and each polynomial of
this size contributes to the covariance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from inim.calibration.model import POSE, Guess, Observations

#: Residuals beyond so many of their usual size count less and less (Geman: soft l1).
ROBUST = 2.0
# How far off the model is, in the units of `Observations.imperfections`: standard deviations, 2 µm
# in 1 mm, 2 µm, and 2 µm in 1 mm, of simulated photographs by cameras of different blur
# (`reports/calibration`).
_IMPERFECT = (0.002, 0.02, 0.002)
# Standard deviation of a blur's variance, square pixels: for a usual camera, and as a share of the
# difference from it. Sharpened or unsharp photographs have responses of other shapes.
_BLUR_ERROR_PX2, _USUAL_BLUR_PX2, _UNUSUAL_SHARE = 0.08, 0.4, 0.4
# Polynomials over the array up to this degree.
_DEGREE = 3
# Least root mean square of a polynomial component: mm on the panel, pixels of the photograph.
_LEAST_MISFIT = (0.0004, 0.015)
# Without one of them, the others must still determine the parameters.
_LEAST_POSITIONS = 3
# Residuals count up to this multiple of their usual size.
_CLIP = 3.0


def inverse_sizes(observations: Observations, sizes: np.ndarray) -> np.ndarray:
    """One over the usual size, for each of `Observations.flat`."""
    counts = 2 * np.array(observations.counts)
    return np.repeat(1 / sizes.ravel(), counts.ravel())


def _polynomials(lens: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Polynomials of column and row with a mean square of 1, orthogonal, (count, lenses)."""
    x, y = ((2 * lens + 1) / shape - 1).T
    powers = [x**n * y**m for n in range(_DEGREE + 1) for m in range(_DEGREE + 1 - n)]
    basis: np.ndarray = np.linalg.qr(np.stack(powers, axis=1))[0].T * np.sqrt(len(lens))
    return basis


def low_order_misfit(observations: Observations, guess: Guess, sizes: np.ndarray) -> np.ndarray:
    """Low-order components of the residuals, (positions, 2, 2, polynomials).

    Axes: position; rays in mm on the panel, outlines in pixels; across and down; polynomial. The
    first polynomial is constant.
    """
    shape = (guess.display.lens_columns, guess.display.lens_rows)
    return np.array(
        [
            [
                _polynomials(lens, shape) @ np.clip(part, -_CLIP * size, _CLIP * size) / len(lens)
                for part, lens, size in zip(pair, lenses, own, strict=True)
            ]
            for pair, lenses, own in zip(
                observations.residuals(guess),
                zip(observations.lens, observations.outlined, strict=True),
                sizes,
                strict=True,
            )
        ]
    ).swapaxes(2, 3)


class Uncertainty(NamedTuple):
    """Uncertainty of all parameters of `Guess.with_changes`; 0 for fixed parameters."""

    covariance: np.ndarray
    #: Deviation of each value from its prior's mean in standard deviations that it has if model and
    #: prior are right.
    pulls: np.ndarray
    #: Change of the parameters without each position, to first order, in their standard errors
    #: without it: (positions, parameters); 0 for fewer than three positions.
    left_out: np.ndarray


def uncertainty(
    observations: Observations,
    guess: Guess,
    free: np.ndarray,
    off: np.ndarray,
    deviation: np.ndarray,
    sizes: np.ndarray,
    misfit: np.ndarray,
) -> Uncertainty:
    """Covariance of the parameters, and tests of the model.

    * `off`, `deviation`: difference of the values to the priors' means, and standard deviations of
      the priors.
    * `misfit`: see `low_order_misfit`.
    """
    steps = guess.steps[free]
    weights = inverse_sizes(observations, sizes)
    residual = observations.flat(guess) * weights
    slopes = observations.slopes(guess, np.zeros(free.size), free) * weights * steps[:, None]
    # psi of the soft l1 loss, and its slope.
    stretch = 1 + (residual / ROBUST) ** 2
    scores = slopes * (residual / np.sqrt(stretch))
    own = (steps / deviation[free]) ** 2
    gains = slopes * stretch**-1.5
    curvature = gains @ slopes.T + np.diag(own)
    unusual = np.abs(np.array(observations.blur_px2) - _USUAL_BLUR_PX2)
    blur = _BLUR_ERROR_PX2 + _UNUSUAL_SHARE * unusual
    imperfect = observations.imperfections(guess) * np.array([*_IMPERFECT, *blur])[:, None]
    smooth = _smooth_effects(observations, guess, gains * weights, misfit, steps.size)
    unknown = np.concatenate([gains @ (imperfect * weights).T, smooth], axis=1)
    noise = np.zeros_like(curvature)
    for line in _lines(observations):
        order = np.argsort(line, kind="stable")
        begins = np.flatnonzero(np.diff(line[order], prepend=-1))
        sums = np.add.reduceat(scores[:, order], begins, axis=1)
        noise += sums @ sums.T * (begins.size / max(begins.size - steps.size, 1))
    inverse = np.linalg.inv(curvature)
    own_covariance = inverse @ (np.diag(own) + noise + unknown @ unknown.T) @ inverse
    random_covariance = inverse @ (np.diag(own) + noise) @ inverse
    covariance, pulls = np.zeros((free.size, free.size)), np.zeros(free.size)
    covariance[np.ix_(free, free)] = own_covariance * np.outer(steps, steps)
    # The error of a value is opposite to the part of the true deviation that the prior withholds.
    has_prior = own > 0
    variance = (np.diag(random_covariance) - 2 * np.diag(inverse))[has_prior] + 1 / own[has_prior]
    pulls[np.flatnonzero(free)[has_prior]] = (off[free] / steps)[has_prior] / np.sqrt(variance)
    left_out = np.zeros((len(observations.lens), free.size))
    if len(left_out) < _LEAST_POSITIONS:
        return Uncertainty(covariance, pulls, left_out)
    ends = np.cumsum([2 * sum(counts) for counts in observations.counts])
    size = POSE * len(ends)
    for n, end in enumerate(ends):
        part = np.s_[:, end - 2 * sum(observations.counts[n]) : end]
        remains = np.ones(steps.size, bool)
        remains[steps.size - size + POSE * n :][:POSE] = False
        remaining = np.linalg.inv(
            (curvature - gains[part] @ slopes[part].T)[np.ix_(remains, remains)]
        )
        larger = np.diag(remaining) * (np.diag(own_covariance) / np.diag(inverse))[remains]
        change = remaining @ scores[part].sum(axis=1)[remains] / np.sqrt(larger)
        left_out[n, np.flatnonzero(free)[remains]] = change
    return Uncertainty(covariance, pulls, left_out)


def _smooth_effects(
    observations: Observations, guess: Guess, gains: np.ndarray, misfit: np.ndarray, fitted: int
) -> np.ndarray:
    """Scores by polynomials of the misfit's size, (parameters, polynomials of all residuals).

    The fit has absorbed a part of the misfit: as many of its components as there are parameters.
    """
    shape = (guess.display.lens_columns, guess.display.lens_rows)
    left = misfit.size / max(misfit.size - fitted, 1)
    size = np.sqrt((misfit**2).mean(axis=(0, 2, 3)) * left + np.square(_LEAST_MISFIT))
    effects, begin = [], 0
    for lenses in zip(observations.lens, observations.outlined, strict=True):
        for lens, amplitude in zip(lenses, size, strict=True):
            end = begin + 2 * len(lens)
            basis = amplitude * _polynomials(lens, shape)
            effects += [gains[:, begin + axis : end : 2] @ basis.T for axis in (0, 1)]
            begin = end
    return np.concatenate(effects, axis=1)


def _lines(observations: Observations) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the lens column and the lens row of each entry of `Observations.flat`."""
    position, index = [], []
    for n, (rays, outlines) in enumerate(
        zip(observations.lens, observations.outlined, strict=True)
    ):
        lens_of_residual = np.repeat(np.concatenate([rays, outlines]), 2, axis=0)
        index.append(lens_of_residual)
        position.append(np.full(len(lens_of_residual), n))
    column, row = np.concatenate(index).T
    first = np.concatenate(position) * (1 + max(int(column.max()), int(row.max())))
    return first + column, first + row
