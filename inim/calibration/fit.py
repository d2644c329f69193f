"""Fit of a display, a camera and its poses to the lenses in photographs, with standard errors.

Robust least squares over all parameters at once. Wide priors keep the search in the range of real
displays and cameras. They do not decide results: a parameter determined by a prior has a large
standard error and is not reported. Standard errors are those of M-estimates under residuals of any
distribution, correlated along a column and along a row of lenses (Huber's sandwich, clustered:
Liang and Zeger, Biometrika 73, 13, 1986), because panel pixels beat with the lenses over whole
columns and rows. Both sums are added. This counts uncorrelated residuals twice, which is
conservative.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np

from inim.calibration.lattice import Lenses
from inim.calibration.model import (
    PARAMETERS,
    SHARED,
    Guess,
    Intrinsics,
    Observations,
    Pose,
    first_lens_mm,
    rotation,
)
from inim.calibration.start import (
    check_pitch,
    find_placement,
    focal_guess,
    number_lenses,
    pose_guess,
)
from inim.display import Display
from inim.display.layouts import Square
from inim.errors import DisplayError, FileError, UsageError

#: A parameter with a larger standard error is not given; lengths as shares of the nominal pitch,
#: gap and focal length. An interval that wide would not help to make an EIA.
LIMITS = {
    "pitch_mm": 0.003,
    "rotation_deg": 0.03,
    "shift_x_mm": 0.04,
    "shift_y_mm": 0.04,
    "gap_mm": 0.05,
    "tilt_x_deg": 0.1,
    "tilt_y_deg": 0.1,
    "focal_length_mm": 0.05,
}
#: An interval of so many standard errors holds the truth in 95 % of cases.
INTERVAL = 1.96
# What displays and cameras are like: standard deviations, lengths as shares like those above.
_PRIORS = {
    "pitch_mm": 0.03,
    "rotation_deg": 20.0,
    "shift_x_mm": 1.0,
    "shift_y_mm": 1.0,
    "gap_mm": 0.3,
    "tilt_x_deg": 3.0,
    "tilt_y_deg": 3.0,
    "focal_length_mm": 0.3,
    "k1": 0.3,
    "k2": 1.0,
}
# Of the focal length, without and with a word from the photographs, and of the principal point: in
# focal lengths, in widths of the photograph.
_FOCAL_PRIOR, _STATED_FOCAL_PRIOR, _CENTRE_PRIOR = 2.0, 0.2, 0.1
# Lenses taken of a position: their number hardly matters for the errors, and the time follows it.
_MOST_LENSES = 500
# Of a position, whose place they tell.
_LEAST_WHOLE = 16
# Residuals beyond so many of their usual size count less and less (Geman: soft l1).
_ROBUST = 2.0
# To begin with: panel pixels and pixels of the photograph.
_USUAL = (0.3, 0.2)
# Typical residuals above these are no lens array of this kind: panel pixels, and shares of a lens.
_WORST_PANEL_PX = 0.5
_WORST_OUTLINE = 0.08
# How far off the model is, in the units of `Seen.imperfections`: standard deviations, 1 µm in 1 mm
# and 2 µm, of photographs through a refracting sheet whose parameters are known, by cameras of
# different blur (`reports/calibration`).
_IMPERFECT = (0.001, 0.02)
_ROUNDS = 3
# Where a search ends: a step lessens the sum of squares by less than this share of it.
_STILL, _MOST_STEPS = 1e-7, 50
_DAMPING, _MOST_DAMPING = 1e-3, 1e9
# Residuals of nothing but rounding are still divided by their size.
_LEAST_SIZE = 1e-9
_LIE = ("shift_x_mm", "shift_y_mm", "rotation_deg", "tilt_x_deg", "tilt_y_deg")


class Estimate(NamedTuple):
    """Value of a fitted parameter."""

    #: Value and its standard error.
    value: float
    error: float
    limit: float  #: Largest standard error of a determined parameter.

    @property
    def is_known(self) -> bool:
        """True if the photographs determine the parameter."""
        return self.error <= self.limit

    @property
    def interval(self) -> tuple[float, float]:
        """Ends of the 95 % interval."""
        return self.value - INTERVAL * self.error, self.value + INTERVAL * self.error


@dataclass(frozen=True)
class Calibration:
    """Result of a calibration.

    Attributes
    ----------
    nominal : Display
        The nominal display.
    guess : Guess
        Best values of all parameters, including those that are not determined.
    estimates : dict of str to Estimate
        Parameters of the display, followed by fitted camera intrinsics.
    pose_errors : tuple of (6,) array
        Standard errors of each position: rotation in radians about the camera's axes, eye in mm.
    correlation : array
        Correlation of `estimates`, in their order.
    covariance : array
        Covariance of all fitted parameters, in the order of `Guess.with_changes`; 0 if fixed.
    edges_seen : (bool, bool)
        True if the array's left and right, and top and bottom, edges are visible: the shift is
        unambiguous. Otherwise the shift is ambiguous by a pitch, and the value nearest to the
        nominal display is used.
    names : tuple of str
        Names of the positions.
    lenses : tuple of Lenses
        All detected lenses, counted from the array's top left.
    observations : Observations
        The observations in the fit.
    sizes : (positions, 2) array
        Typical size of the residuals: panel mm for rays, pixels for outlines.
    """

    nominal: Display
    guess: Guess
    estimates: dict[str, Estimate]
    pose_errors: tuple[np.ndarray, ...]
    correlation: np.ndarray
    covariance: np.ndarray
    edges_seen: tuple[bool, bool]
    names: tuple[str, ...]
    lenses: tuple[Lenses, ...]
    observations: Observations
    sizes: np.ndarray

    @property
    def display(self) -> Display:
        """Nominal display with all determined parameters replaced."""
        rows, columns = self.nominal.eia_shape
        determined: dict[str, Any] = {
            name: estimate.value
            for name, estimate in self.estimates.items()
            if name in PARAMETERS and estimate.is_known
        }
        if "pitch_mm" in determined and self.nominal.pitch_y_mm is not None:
            determined["pitch_y_mm"] = self.guess.display.row_pitch_mm
        return self.nominal.replace(
            name=f"{self.nominal.name}, calibrated",
            panel_rows=rows,
            panel_columns=columns,
            **determined,
        )

    @property
    def undetermined(self) -> list[str]:
        """Parameters of the display that these photographs do not determine."""
        return [k for k, v in self.estimates.items() if k in PARAMETERS and not v.is_known]


def check_display(display: Display) -> None:
    """Raise `UsageError` unless its lenses are in rows and columns and fill the sheet."""
    for name, required in (("lattice", Square.name), ("aperture", "square"), ("fill_factor", 1.0)):
        value = getattr(display, name)
        if value != required:
            raise UsageError(
                f"display {display.name}: {name} = {value!r} cannot be calibrated, only "
                f"{required!r}"
            )


def fit_display(
    lenses: Mapping[str, Lenses],
    nominal: Display,
    *,
    camera: Intrinsics | None = None,
    focal_px: float | None = None,
) -> Calibration:
    """Fit a display, a camera and its poses.

    * `lenses`: lenses by position, from `inim.calibration.lattice.find_lenses`.
    * `nominal`: nominal display: the start of the search, and the source of parameters that are not
      fitted.
    * `camera`: calibrated intrinsics; fitted by default, starting from `focal_px` if given.

    Raises `UsageError`: this kind of display cannot be calibrated. `FileError`: the photographs
    have different sizes, show another display, or do not fit any such display.
    """
    check_display(nominal)
    if not lenses:
        raise UsageError("no photographs of a display; give a folder that contains some")
    shapes = {position.shape for position in lenses.values()}
    if len(shapes) > 1:
        first, other = sorted(shapes)[:2]
        raise FileError(
            f"photographs of {first[1]} x {first[0]} and of {other[1]} x {other[0]} pixels: take "
            "all with one camera in the same orientation"
        )
    steady = nominal.with_fixed_panel()
    guess, counted, edges = _begin(lenses, steady, camera, focal_px)
    free = np.ones(guess.steps.size, bool)
    if camera is not None:
        free[len(PARAMETERS) : len(SHARED)] = False
    prior = _prior(steady, guess, focal_px is not None, counted[0].shape)
    names = tuple(lenses)
    guess, counted, observations, sizes = _fit(names, steady, guess, counted, edges, free, prior)
    covariance = _covariance(observations, guess, free, prior, sizes)
    errors = np.sqrt(np.diag(covariance))
    fitted = SHARED if camera is None else PARAMETERS
    count = len(fitted)
    limits = {name: _in_parameter_unit(share, name, nominal) for name, share in LIMITS.items()}
    estimates = {
        name: Estimate(float(value), float(error), limits.get(name, math.inf))
        for name, value, error in zip(fitted, _shared_values(guess), errors, strict=False)
    }
    return Calibration(
        nominal,
        guess,
        estimates,
        pose_errors=tuple(errors[len(SHARED) :].reshape(-1, 6)),
        correlation=covariance[:count, :count] / np.outer(errors[:count], errors[:count]),
        covariance=covariance,
        edges_seen=edges,
        names=names,
        lenses=counted,
        observations=observations,
        sizes=sizes,
    )


def fit_pose(lenses: Lenses, display: Display, camera: Intrinsics, name: str) -> Pose:
    """Fit the pose of a calibrated camera in front of a calibrated display.

    * `name`: name of the photographs in error messages.

    Raises `UsageError` or `FileError`: as for `calibrate`.
    """
    check_display(display)
    steady = display.with_fixed_panel()
    guess, counted, _ = _begin({name: lenses}, steady, camera, None)
    guess = guess._replace(display=steady)
    free = np.arange(guess.steps.size) >= len(SHARED)
    prior = _prior(steady, guess, True, lenses.shape)
    # Counted as the known shift has it, whether edges are seen or not.
    fitted, *_ = _fit((name,), steady, guess, counted, (True, True), free, prior)
    return fitted.poses[0]


def _fit(
    names: tuple[str, ...],
    display: Display,
    guess: Guess,
    counted: tuple[Lenses, ...],
    edges_seen: tuple[bool, bool],
    free: np.ndarray,
    prior: _Prior,
) -> tuple[Guess, tuple[Lenses, ...], Observations, np.ndarray]:
    """Best guess, renumbered lenses, the observations in the fit, and the sizes of residuals.

    Raises `FileError`: no such display explains the photographs.
    """
    sizes = np.tile([_USUAL[0] * display.pixel_pitch_mm, _USUAL[1]], (len(counted), 1))
    for _ in range(_ROUNDS):
        observations = _select_observations(counted, display, guess)
        guess = _solve(observations, guess, free, prior, sizes)
        sizes = _sizes(observations.residuals(guess))
        # The first guess may have been a lens off.
        guess, counted = renumber_lenses(guess, counted, edges_seen, display)
    observations = _select_observations(counted, display, guess)
    _check(names, display, sizes, counted)
    # One position alone begins with a distance of its own choice.
    check_pitch(display, guess.display.pitch_mm / display.pitch_mm, ", ".join(names))
    return guess, counted, observations, sizes


def _select_observations(
    lenses: tuple[Lenses, ...], display: Display, guess: Guess
) -> Observations:
    """Observations in the fit, corrected for blur."""
    return Observations.of([_thin_out(position) for position in lenses], display).without_blur(
        guess
    )


def _begin(
    lenses: Mapping[str, Lenses],
    display: Display,
    camera: Intrinsics | None,
    focal_px: float | None,
) -> tuple[Guess, tuple[Lenses, ...], tuple[bool, bool]]:
    """Values to begin with, and all lenses counted from the array's top left."""
    for name, position in lenses.items():
        if (whole := int(position.is_whole.sum())) < _LEAST_WHOLE:
            raise FileError(
                f"{name}: {whole} lenses are completely visible, at least two lenses from any "
                f"edge; {_LEAST_WHOLE} are needed; photograph more of the sheet, or omit this "
                "position"
            )
    positions = list(lenses.values())
    flat_placement: dict[str, Any] = dict.fromkeys(_LIE, 0.0)
    flat = display.replace(**flat_placement)
    first = camera or focal_guess(flat, positions, focal_px)
    # The lattice alone, as if each position's first lens were the array's.
    corner = np.append(first_lens_mm(flat), 0.0)
    poses = [pose_guess(flat, position, first, name) for name, position in lenses.items()]
    guess = Guess(flat, first, tuple(Pose(p.turn, p.eye_mm + corner) for p in poses))
    observations = Observations.of(
        [_thin_out(position) for position in positions], flat, outlines_only=True
    )
    free = np.arange(guess.steps.size) >= (len(PARAMETERS) if camera is None else len(SHARED))
    prior = _prior(flat, guess, focal_px is not None, positions[0].shape)
    guess = _solve(observations, guess, free, prior, np.tile(_USUAL, (len(positions), 1)))
    own = [Pose(p.turn, p.eye_mm - corner) for p in guess.poses]
    lies = [
        find_placement(display, position, pose, name)
        for (name, position), pose in zip(lenses.items(), own, strict=True)
    ]
    angle = math.degrees(
        np.mean(np.unwrap(np.radians([placement.rotation_deg for placement in lies])))
    )
    size = float(np.mean([placement.size for placement in lies]))
    array = number_lenses(display, lenses, lies)
    sized = display.replace(
        rotation_deg=angle,
        pitch_mm=size * display.pitch_mm,
        pitch_y_mm=None if display.pitch_y_mm is None else size * display.pitch_y_mm,
        shift_x_mm=float(array.shift_mm[0]),
        shift_y_mm=float(array.shift_mm[1]),
    )
    turn = rotation([0.0, 0.0, math.radians(angle)])
    placed = []
    for pose, offset in zip(own, array.offsets, strict=True):
        steps = np.array([sized.pitch_mm, -sized.row_pitch_mm, 0.0]) * np.append(offset, 0)
        eye = size * pose.eye_mm + np.append(first_lens_mm(sized), 0.0) + steps
        shift = np.append(array.shift_mm, 0.0)
        placed.append(Pose(pose.turn @ turn.T, turn @ eye + shift))
    counted = tuple(
        replace(position, index=position.index + by)
        for position, by in zip(positions, array.offsets, strict=True)
    )
    return Guess(sized, guess.camera, tuple(placed)), counted, array.edges_seen


def renumber_lenses(
    guess: Guess, counted: tuple[Lenses, ...], edges_seen: tuple[bool, bool], nominal: Display
) -> tuple[Guess, tuple[Lenses, ...]]:
    """Renumber the lenses for the smallest shift of the array, along axes without visible edges.

    An array shifted one pitch to the right, with each lens index reduced by one, is the same array.
    """
    display = guess.display
    angle = math.radians(display.rotation_deg)
    turn = rotation([0.0, 0.0, angle])[:2, :2]
    step = np.array([display.pitch_mm, -display.row_pitch_mm])
    shift = np.array([display.shift_x_mm, display.shift_y_mm])
    off = (shift - [nominal.shift_x_mm, nominal.shift_y_mm]) @ turn
    by = np.where(edges_seen, 0, np.rint(off / step)).astype(int)
    index = np.concatenate([position.index for position in counted])
    there = np.array(display.layout.grid[::-1])
    by = np.clip(by, -index.min(axis=0), there - 1 - index.max(axis=0))
    shift = shift - turn @ (by * step)
    moved = display.replace(shift_x_mm=float(shift[0]), shift_y_mm=float(shift[1]))
    return guess._replace(display=moved), tuple(
        replace(position, index=position.index + by) for position in counted
    )


def _thin_out(lenses: Lenses) -> Lenses:
    """Choose at most `_MOST_LENSES` lenses at random: every n-th would beat with the pixels."""
    order = np.random.default_rng(0).permutation(len(lenses.index))
    chosen = np.sort(order[:_MOST_LENSES])
    parts = {f.name: getattr(lenses, f.name) for f in fields(lenses) if f.name != "shape"}
    return replace(lenses, **{name: part[chosen] for name, part in parts.items()})


class _Prior(NamedTuple):
    """Means and standard deviations of `SHARED`."""

    mean: np.ndarray
    deviation: np.ndarray


def _shared_values(guess: Guess) -> np.ndarray:
    return np.array([*(getattr(guess.display, name) for name in PARAMETERS), *guess.camera])


def _prior(display: Display, guess: Guess, focal_is_stated: bool, shape: tuple[int, int]) -> _Prior:
    height, width = shape
    focal = guess.camera.focal_px
    standard_deviations = {
        name: _in_parameter_unit(_PRIORS[name], name, display) for name in PARAMETERS
    }
    standard_deviations |= {
        "focal_px": focal * (_STATED_FOCAL_PRIOR if focal_is_stated else _FOCAL_PRIOR),
        "centre_x_px": _CENTRE_PRIOR * width,
        "centre_y_px": _CENTRE_PRIOR * width,
        "k1": _PRIORS["k1"],
        "k2": _PRIORS["k2"],
    }
    mean = _shared_values(guess._replace(display=display))
    mean[len(PARAMETERS) :] = focal, width / 2, height / 2, 0.0, 0.0
    return _Prior(mean, np.array([standard_deviations[name] for name in SHARED]))


def _in_parameter_unit(share: float, name: str, display: Display) -> float:
    """An entry of `LIMITS` or of the priors in the parameter's unit."""
    if name.startswith("shift"):
        return share * display.pitch_mm
    return share * float(getattr(display, name)) if name.endswith("_mm") else share


def _inverse_sizes(observations: Observations, sizes: np.ndarray) -> np.ndarray:
    """One over the usual size, for each of `Observations.flat`."""
    counts = 2 * np.array(observations.counts)
    return np.repeat(1 / sizes.ravel(), counts.ravel())


def _solve(
    observations: Observations, start: Guess, free: np.ndarray, prior: _Prior, sizes: np.ndarray
) -> Guess:
    """The best guess, from one that is near it, by Levenberg's and Marquardt's method.

    Of normal equations with weights of the soft l1 loss: there are a thousand residuals for each
    unknown, and `scipy.optimize.least_squares` decomposes all of them in every step, which took
    about half of the time.
    """
    steps, weights = start.steps[free], _inverse_sizes(observations, sizes)
    of_shared = free[: len(SHARED)]
    shared_steps = (start.steps[: len(SHARED)] / prior.deviation)[of_shared]

    def moved(z: np.ndarray) -> tuple[np.ndarray, Guess]:
        by = np.zeros(free.size)
        by[free] = z * steps
        return by, start.with_changes(by)

    def residuals(guess: Guess) -> tuple[np.ndarray, np.ndarray, float]:
        with np.errstate(all="ignore"):  # a step too far is not taken
            own = observations.flat(guess) * weights
        off = ((_shared_values(guess) - prior.mean) / prior.deviation)[of_shared]
        robust = 2 * _ROBUST**2 * float((np.sqrt(1 + (own / _ROBUST) ** 2) - 1).sum())
        return own, off, robust + float(off @ off)

    at, damping = np.zeros(steps.size), _DAMPING
    by, guess = moved(at)
    own, off, cost = residuals(guess)
    for _ in range(_MOST_STEPS):
        slopes = observations.slopes(start, by, free)
        slopes *= weights
        slopes *= steps[:, None]
        weighted = slopes / np.sqrt(1 + (own / _ROBUST) ** 2)
        curvature, gradient = weighted @ slopes.T, weighted @ own
        diagonal = np.arange(off.size)
        curvature[diagonal, diagonal] += shared_steps**2
        gradient[: off.size] += shared_steps * off
        gained = 0.0
        while damping < _MOST_DAMPING:
            damped = curvature + damping * np.diag(np.diag(curvature))
            step = np.linalg.solve(damped, gradient)
            try:
                by, guess = moved(at - step)
            except DisplayError:  # no such display: a shorter step
                damping *= 10
                continue
            *tried, better = residuals(guess)
            if better < cost:
                gained, at, (own, off), cost = cost - better, at - step, tried, better
                damping /= 10
                break
            damping *= 10
        if gained < _STILL * cost:
            break
    return moved(at)[1]


def _sizes(residuals: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Usual size of each position's residuals, as a normal distribution's standard deviation."""
    return np.array(
        [
            [max(1.4826 * float(np.median(np.abs(part))), _LEAST_SIZE) for part in pair]
            for pair in residuals
        ]
    )


def _check(
    names: tuple[str, ...], display: Display, sizes: np.ndarray, lenses: tuple[Lenses, ...]
) -> None:
    """Raise `FileError` where no display of this kind explains the photographs."""
    for name, (of_rays, of_outlines), position in zip(names, sizes, lenses, strict=True):
        panel_px = of_rays / display.pixel_pitch_mm
        lens_px = math.sqrt(
            float(np.prod(np.ptp(position.centre_px, axis=0) / np.ptp(position.index, axis=0)))
        )
        if panel_px > _WORST_PANEL_PX or of_outlines > _WORST_OUTLINE * lens_px:
            raise FileError(
                f"{name}: the photographs differ from display {display.name} by {panel_px:.2g} "
                f"panel pixels and {of_outlines:.2g} photograph pixels; check that all show the "
                "same sheet, sharp, with fixed zoom and focus; give the photographed display with "
                "--display, or omit this position"
            )


def _covariance(
    observations: Observations, guess: Guess, free: np.ndarray, prior: _Prior, sizes: np.ndarray
) -> np.ndarray:
    """Covariance of all parameters of `Guess.with_changes`; 0 for fixed parameters."""
    steps = guess.steps[free]
    weights = _inverse_sizes(observations, sizes)
    residual = observations.flat(guess) * weights
    slopes = observations.slopes(guess, np.zeros(free.size), free) * weights * steps[:, None]
    # psi of the soft l1 loss, and its slope.
    stretch = 1 + (residual / _ROBUST) ** 2
    scores = slopes * (residual / np.sqrt(stretch))
    own = np.zeros(steps.size)
    own[: int(free[: len(SHARED)].sum())] = (guess.steps[: len(SHARED)] / prior.deviation)[
        free[: len(SHARED)]
    ] ** 2
    curvature = (slopes * stretch**-1.5) @ slopes.T + np.diag(own)
    imperfect = observations.imperfections(guess) * np.array(_IMPERFECT)[:, None]
    unknown = slopes @ (imperfect * weights * stretch**-1.5).T
    spread = np.diag(own) + unknown @ unknown.T
    for line in _lines(observations):
        order = np.argsort(line, kind="stable")
        begins = np.flatnonzero(np.diff(line[order], prepend=-1))
        sums = np.add.reduceat(scores[:, order], begins, axis=1)
        spread += sums @ sums.T * (begins.size / max(begins.size - steps.size, 1))
    inverse = np.linalg.inv(curvature)
    covariance = np.zeros((free.size, free.size))
    covariance[np.ix_(free, free)] = inverse @ spread @ inverse * np.outer(steps, steps)
    return covariance


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
