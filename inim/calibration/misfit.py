"""Covariance of the fitted parameters, and the misfit that the residuals show.

Residuals of neighbouring lenses are not independent. Panel pixels beat with the lenses over whole
columns and rows: the sandwich estimate sums over both (Huber's sandwich, clustered: Liang and
Zeger, Biometrika 73, 13, 1986). Both sums are added. This counts uncorrelated residuals twice,
which is conservative. Samples of photographs that are smoothed over cylinders are independent.
Effects that the model does not include change smoothly over the sheet. The residuals' components in
the space of low-order polynomials give their size, and each polynomial of this size contributes to
the covariance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from inim.calibration.model import POSE, Guess, Residuals

#: Residuals beyond so many of their usual size count less and less (Geman: soft l1).
ROBUST = 2.0
# Polynomials over the array up to this degree.
_DEGREE = 3
# Without one of them, the others must still determine the parameters.
_LEAST_POSITIONS = 3
# Residuals count up to this multiple of their usual size.
_CLIP = 3.0


def inverse_sizes(observations: Residuals, sizes: np.ndarray) -> np.ndarray:
    """One over the usual size, for each of `Observations.flat`."""
    return np.repeat(1 / sizes.ravel(), observations.counts.ravel())


def _polynomials(lens: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Polynomials of column and row with a mean square of 1, orthogonal, (count, lenses)."""
    x, y = ((2 * lens + 1) / shape - 1).T
    powers = [x**n * y**m for n in range(_DEGREE + 1) for m in range(_DEGREE + 1 - n)]
    basis: np.ndarray = np.linalg.qr(np.stack(powers, axis=1))[0].T * np.sqrt(len(lens))
    return basis


def low_order_misfit(observations: Residuals, guess: Guess, sizes: np.ndarray) -> np.ndarray:
    """Low-order components of the residuals, (positions, 2, polynomials).

    Axes: position; kind of residuals; polynomial, the first of which is constant. Each is the root
    mean square over the components of a residual.
    """
    shape = observations.grid(guess)
    return np.array(
        [
            [
                np.sqrt(
                    (
                        (_polynomials(place, shape) @ np.clip(part, -_CLIP * size, _CLIP * size))
                        ** 2
                    ).mean(axis=1)
                )
                / len(place)
                for part, place, size in zip(pair, places, own, strict=True)
            ]
            for pair, places, own in zip(
                observations.residuals(guess), observations.places, sizes, strict=True
            )
        ]
    )


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
    observations: Residuals,
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
    gains = slopes * stretch**-1.5
    own = (steps / deviation[free]) ** 2
    ends = np.cumsum(observations.counts.sum(axis=1))
    parts = [slice(begin, end) for begin, end in zip([0, *ends], ends, strict=False)]
    noise = _noise(observations, [scores[:, part] for part in parts])
    unknown = _unknown_effects(observations, guess, gains * weights, misfit, parts)
    curvatures = np.stack([gains[:, part] @ slopes[:, part].T for part in parts])

    def estimates(chosen: list[int], fitted: np.ndarray) -> tuple[np.ndarray, ...]:
        """Inverse curvature, covariance, and covariance without effects outside the model."""
        grid = np.ix_(fitted, fitted)
        inverse = np.linalg.inv((np.diag(own) + curvatures[chosen].sum(axis=0))[grid])
        random = (np.diag(own) + noise[chosen].sum(axis=0))[grid]
        effects = unknown[chosen].sum(axis=0)[fitted]
        return (
            inverse,
            inverse @ (random + effects @ effects.T) @ inverse,
            inverse @ random @ inverse,
        )

    everything = list(range(len(parts)))
    inverse, own_covariance, random_covariance = estimates(everything, np.ones(steps.size, bool))
    covariance, pulls = np.zeros((free.size, free.size)), np.zeros(free.size)
    covariance[np.ix_(free, free)] = own_covariance * np.outer(steps, steps)
    # The error of a value is opposite to the part of the true deviation that the prior withholds.
    has_prior = own > 0
    variance = (np.diag(random_covariance) - 2 * np.diag(inverse))[has_prior] + 1 / own[has_prior]
    pulls[np.flatnonzero(free)[has_prior]] = (off[free] / steps)[has_prior] / np.sqrt(variance)
    left_out = np.zeros((len(parts), free.size))
    if len(left_out) < _LEAST_POSITIONS:
        return Uncertainty(covariance, pulls, left_out)
    sums = np.stack([scores[:, part].sum(axis=1) for part in parts])
    gradient = sums.sum(axis=0) + own * off[free] / steps
    full = inverse @ gradient
    for n in everything:
        begin = free.size - POSE * (len(parts) - n)
        fitted = np.ones(free.size, bool)
        fitted[begin : begin + POSE] = False
        fitted = fitted[free]
        inverse, without, _ = estimates([m for m in everything if m != n], fitted)
        change = full[fitted] - inverse @ (gradient - sums[n])[fitted]
        change /= np.sqrt(np.diag(without))
        left_out[n, np.flatnonzero(free)[fitted]] = change
    return Uncertainty(covariance, pulls, left_out)


def _noise(observations: Residuals, scores: list[np.ndarray]) -> np.ndarray:
    """Covariance of the sum of each position's scores, (positions, parameters, parameters)."""
    covariances = []
    components = [len(kind.axes) for kind in observations.kinds]
    for own, places in zip(scores, observations.places, strict=True):
        parameters = len(own)
        covariance = np.zeros((parameters, parameters))
        if not observations.is_striped:
            covariances.append(own @ own.T)
            continue
        lines = [np.repeat(a, n, axis=0) for a, n in zip(places, components, strict=True)]
        for line in np.concatenate(lines).T:
            order = np.argsort(line, kind="stable")
            begins = np.flatnonzero(np.diff(line[order], prepend=-1))
            sums = np.add.reduceat(own[:, order], begins, axis=1)
            left = max(begins.size - parameters / len(scores), 1)
            covariance += sums @ sums.T * (begins.size / left)
        covariances.append(covariance)
    return np.stack(covariances)


def _unknown_effects(
    observations: Residuals,
    guess: Guess,
    gains: np.ndarray,
    misfit: np.ndarray,
    parts: list[slice],
) -> np.ndarray:
    """Scores by effects outside the model, (positions, parameters, effects).

    Each effect acts on all positions. Imperfections come first, then polynomials of the misfit's
    size. The fit has absorbed a part of the misfit: as many of its components as there are
    parameters.
    """
    imperfect = observations.imperfections(guess) * observations.imperfection_sizes[:, None]
    shape = observations.grid(guess)
    components = [len(kind.axes) for kind in observations.kinds]
    size_count = misfit[:, 0].size * sum(components)
    left = size_count / max(size_count - len(gains), 1)
    least = np.array([kind.least_misfit for kind in observations.kinds])
    size = np.sqrt((misfit**2).mean(axis=(0, 2)) * left + np.square(least))
    effects = []
    for n, part in enumerate(parts):
        begin, smooth = part.start, []
        for place, amplitude, count in zip(observations.places[n], size, components, strict=True):
            end = begin + count * len(place)
            basis = amplitude * _polynomials(place, shape)
            smooth += [gains[:, begin + axis : end : count] @ basis.T for axis in range(count)]
            begin = end
        own = np.concatenate(smooth, axis=1)
        of_others = np.zeros((len(gains), own.shape[1]))
        smooth_effects = [own if m == n else of_others for m in range(len(parts))]
        effects.append(np.concatenate([gains[:, part] @ imperfect[:, part].T, *smooth_effects], 1))
    return np.stack(effects)
