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
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from inim.calibration.fringes import FringeObservations, Fringes, begin_fringes
from inim.calibration.lattice import PER_LENS, Lenses
from inim.calibration.misfit import (
    ROBUST,
    inverse_sizes,
    low_order_misfit,
    uncertainty,
)
from inim.calibration.model import (
    CHANGES,
    PARAMETERS,
    POSE,
    SHARED,
    Deviations,
    Guess,
    Intrinsics,
    Observations,
    Pose,
    Residuals,
    first_lens_mm,
    rotation,
)
from inim.calibration.result import Calibration, Estimate
from inim.calibration.start import (
    check_pitch,
    find_placement,
    focal_guess,
    lattice_map,
    number_lenses,
    panel_step,
    pose_of_plane,
)
from inim.display import Display
from inim.display.layouts import Square
from inim.errors import DisplayError, FileError, UsageError
from inim.lens import check_lens_model

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
#: The same of cylinders. Their shift is across. Their focal length follows the gap, for they focus
#: on the panel.
CYLINDER_LIMITS = {
    "pitch_mm": 0.001,
    "rotation_deg": 0.03,
    "shift_x_mm": 0.04,
    "gap_mm": 0.05,
}
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
    "p1": 0.002,
    "p2": 0.002,
    "refractive_index": 0.03,
    "thickness": 0.15,
    "glass_mm": 0.7,
    "bow_x_mm": 0.03,
    "bow_y_mm": 0.03,
    "bow_xy_mm": 0.03,
    "zoom": 0.02,
    "skew": 0.0004,
    "stretch": 0.0004,
}
# Skew and stretch of a camera that stands still: a rolling shutter does not change its pictures.
# They move between photographs by less than this root mean square.
_STEADY_SKEW, _STEADY_MOTION_PX = 2e-5, 0.1
# Of the focal length, without and with a word from the photographs, and of the principal point: in
# focal lengths, in widths of the photograph.
_FOCAL_PRIOR, _STATED_FOCAL_PRIOR, _CENTRE_PRIOR = 2.0, 0.2, 0.1
# Lenses taken of a position: their number hardly matters for the errors, and the time follows it.
_MOST_LENSES = 2000
# Of a position, whose place they tell.
_LEAST_WHOLE = 16
# Typical residuals above these are no lens array of this kind: panel pixels, and shares of a lens.
# Where a sharp camera sees the black matrix of the panel, little light gives noise of a pixel.
_WORST_PANEL_PX = 1.2
_WORST_OUTLINE = 0.08
# The same of cylinders: shares of a lens, for the panel and for the views.
_WORST_CYLINDERS = (0.4, 0.06)
# Glass over the panel of cylinders, a share of the gap.
_GLASS_SHARE = 0.5
_ROUNDS = 3
# Where a search ends: a step lessens the sum of squares by less than this share of it.
_STILL, _MOST_STEPS = 1e-7, 50
_DAMPING, _MOST_DAMPING = 1e-3, 1e9
_LIE = ("shift_x_mm", "shift_y_mm", "rotation_deg", "tilt_x_deg", "tilt_y_deg")


def check_display(display: Display) -> None:
    """Raise `UsageError` unless its lenses fill the sheet, in rows and columns or as cylinders.

    Raises `DisplayError`: cylinders that the thick lens model does not have.
    """
    if display.layout.of_cylinders:
        check_lens_model("thick", display)
        return
    for name, required in (("lattice", Square.name), ("aperture", "square"), ("fill_factor", 1.0)):
        value = getattr(display, name)
        if value != required:
            raise UsageError(
                f"display {display.name}: {name} = {value!r} cannot be calibrated, only "
                f"{required!r}"
            )


def fit_display(
    lenses: Mapping[str, Lenses | Fringes],
    nominal: Display,
    *,
    camera: Intrinsics | None = None,
    focal_px: float | None = None,
    is_steady: bool = False,
) -> Calibration:
    """Fit a display, a camera and its poses.

    * `lenses`: lenses by position, from `inim.calibration.lattice.find_lenses`; of a lenticular
      display, from `inim.calibration.fringes.find_fringes`.
    * `nominal`: nominal display: the start of the search, and the source of parameters that are not
      fitted.
    * `camera`: calibrated intrinsics; fitted by default, starting from `focal_px` if given.
    * `is_steady`: True for a camera that nothing moved; its photographs are not skewed.

    Raises `UsageError`: this kind of display cannot be calibrated; a steady camera that moved.
    `FileError`: the photographs
    have different sizes, show another display, or do not fit any such display.
    """
    check_display(nominal)
    if not lenses:
        raise UsageError("no photographs of a display; give a folder that contains some")
    for name, position in lenses.items():
        if is_steady and position.motion_px > _STEADY_MOTION_PX:
            raise UsageError(
                f"--steady: the camera moved by {position.motion_px:.2f} pixels between the "
                f"photographs of {name}; leave the option out"
            )
    shapes = {position.shape for position in lenses.values()}
    if len(shapes) > 1:
        first, other = sorted(shapes)[:2]
        raise FileError(
            f"photographs of {first[1]} x {first[0]} and of {other[1]} x {other[0]} pixels: take "
            "all with one camera in the same orientation"
        )
    steady = nominal.with_fixed_panel()
    limits = CYLINDER_LIMITS if nominal.layout.of_cylinders else LIMITS
    guess, counted, edges = _begin(lenses, steady, camera, focal_px)
    free = _free(guess, display=limits, camera=camera is None, changes=len(lenses) > 1)
    prior = _prior(steady, guess, focal_px is not None, counted[0].shape, is_steady)
    names = tuple(lenses)
    guess, counted, observations, sizes = _fit(steady, guess, counted, edges, free, prior)
    misfit = low_order_misfit(observations, guess, sizes)
    off = _values(guess) - prior.mean
    covariance, pulls, left_out = uncertainty(
        observations, guess, free, off, prior.deviation, sizes, misfit
    )
    _check(names, steady, guess, sizes, counted)
    errors = np.sqrt(np.diag(covariance))
    fitted = [n for n in range(len(PARAMETERS) + len(Intrinsics._fields)) if free[n]]
    limits = {name: _in_parameter_unit(share, name, nominal) for name, share in limits.items()}
    values = _values(guess)
    estimates = {
        SHARED[n]: Estimate(float(values[n]), float(errors[n]), limits.get(SHARED[n], math.inf))
        for n in fitted
    }
    return Calibration(
        nominal,
        guess,
        estimates,
        pose_errors=tuple(errors[len(SHARED) :].reshape(-1, POSE)),
        correlation=covariance[np.ix_(fitted, fitted)] / np.outer(errors[fitted], errors[fitted]),
        covariance=covariance,
        edges_seen=edges,
        names=names,
        lenses=counted,
        observations=observations,
        sizes=sizes,
        misfit=misfit,
        pulls=pulls,
        left_out=left_out,
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
    free = _free(guess, display=(), camera=False, changes=False)
    prior = _prior(steady, guess, True, lenses.shape)
    # Counted as the known shift has it, whether edges are seen or not.
    fitted, counted, _, sizes = _fit(steady, guess, counted, (True, True), free, prior)
    _check((name,), steady, fitted, sizes, counted)
    return fitted.poses[0]


def _fit(
    display: Display,
    guess: Guess,
    counted: tuple[Any, ...],
    edges_seen: tuple[bool, bool],
    free: np.ndarray,
    prior: _Prior,
) -> tuple[Guess, tuple[Any, ...], Residuals, np.ndarray]:
    """Best guess, renumbered lenses, the observations in the fit, and the sizes of residuals."""
    observations = _select_observations(counted, display, guess)
    sizes = np.tile(_in_mm([kind.usual for kind in observations.kinds], display), (len(counted), 1))
    for _ in range(_ROUNDS):
        observations = _select_observations(counted, display, guess)
        guess = _solve(observations, guess, free, prior, sizes)
        sizes = _sizes(observations, guess, display)
        # The first guess may have been a lens off.
        if not display.layout.of_cylinders:
            guess, counted = renumber_lenses(guess, counted, edges_seen, display)
    observations = _select_observations(counted, display, guess)
    return guess, counted, observations, sizes


def _in_mm(sizes: list[float], display: Display) -> list[float]:
    """Sizes of both kinds of residuals, of which the first is given in panel pixels."""
    return [sizes[0] * display.pixel_pitch_mm, sizes[1]]


def _select_observations(lenses: tuple[Any, ...], display: Display, guess: Guess) -> Residuals:
    """Observations in the fit, corrected for blur."""
    if display.layout.of_cylinders:
        return FringeObservations.of(lenses, display)
    return Observations.of([_thin_out(position) for position in lenses], display).without_blur(
        guess
    )


def _begin(
    lenses: Mapping[str, Any],
    display: Display,
    camera: Intrinsics | None,
    focal_px: float | None,
) -> tuple[Guess, tuple[Any, ...], tuple[bool, bool]]:
    """Values to begin with, and all lenses counted from the array's top left."""
    if display.layout.of_cylinders:
        guess = begin_fringes(lenses, display, camera, focal_px)
        return guess, tuple(lenses.values()), (True, True)
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
    maps = [lattice_map(flat, position) for position in positions]
    steps = [panel_step(flat, position) for position in positions]
    first = camera or focal_guess(
        maps,
        positions[0].shape,
        focal_px,
        lambda number, away: steps[number] / (1 + flat.gap_mm / away),
    )
    # The lattice alone, as if each position's first lens were the array's.
    corner = np.append(first_lens_mm(flat), 0.0)
    poses = [pose_of_plane(a, first, name) for a, name in zip(maps, lenses, strict=True)]
    guess = Guess(flat, first, tuple(Pose(p.turn, p.eye_mm + corner) for p in poses))
    observations = Observations.of(
        [_thin_out(position) for position in positions], flat, outlines_only=True
    )
    free = _free(guess, display=(), camera=camera is None, changes=False)
    prior = _prior(flat, guess, focal_px is not None, positions[0].shape)
    usual = [kind.usual for kind in Observations.kinds]
    guess = _solve(observations, guess, free, prior, np.tile(usual, (len(positions), 1)))
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
    parts = {name: getattr(lenses, name)[chosen] for name in PER_LENS}
    return replace(lenses, **parts)


class _Prior(NamedTuple):
    """Means and standard deviations of all parameters; infinite for turns and eyes."""

    mean: np.ndarray
    deviation: np.ndarray


def _free(guess: Guess, *, display: Collection[str], camera: bool, changes: bool) -> np.ndarray:
    """Mask of the fitted parameters, of the display those given; turns and eyes always are."""
    parts = [
        np.array([name in display for name in PARAMETERS]),
        np.full(len(Intrinsics._fields), camera),
        np.full(len(Deviations._fields), bool(display)),
        np.tile([True] * (POSE - len(CHANGES)) + [changes] * len(CHANGES), len(guess.poses)),
    ]
    return np.concatenate(parts)


def _values(guess: Guess) -> np.ndarray:
    """Values of all parameters; 0 for turns and eyes."""
    own = [getattr(guess.display, name) for name in PARAMETERS]
    changes = [[0.0] * (POSE - len(CHANGES)) + [*pose[2:]] for pose in guess.poses]
    return np.concatenate([own, guess.camera, guess.deviations, np.ravel(changes)])


def _prior(
    display: Display,
    guess: Guess,
    focal_is_stated: bool,
    shape: tuple[int, int],
    is_steady: bool = False,
) -> _Prior:
    height, width = shape
    focal = guess.camera.focal_px
    standard_deviations = {
        name: _in_parameter_unit(_PRIORS[name], name, display) for name in PARAMETERS
    }
    standard_deviations |= {
        "focal_px": focal * (_STATED_FOCAL_PRIOR if focal_is_stated else _FOCAL_PRIOR),
        "centre_x_px": _CENTRE_PRIOR * width,
        "centre_y_px": _CENTRE_PRIOR * width,
    }
    standard_deviations = _PRIORS | standard_deviations
    if display.layout.of_cylinders:
        standard_deviations["glass_mm"] = _GLASS_SHARE * display.gap_mm
    if is_steady:
        standard_deviations |= {"skew": _STEADY_SKEW, "stretch": _STEADY_SKEW}
    camera = Intrinsics(focal, width / 2, height / 2)
    poses = tuple(Pose(pose.turn, pose.eye_mm) for pose in guess.poses)
    mean = _values(Guess(display, camera, poses))
    own = [math.inf] * (POSE - len(CHANGES)) + [standard_deviations[name] for name in CHANGES]
    shared = [standard_deviations[name] for name in SHARED]
    return _Prior(mean, np.array(shared + own * len(poses)))


def _in_parameter_unit(share: float, name: str, display: Display) -> float:
    """An entry of `LIMITS` or of the priors in the parameter's unit."""
    if name.startswith("shift"):
        return share * display.pitch_mm
    return share * float(getattr(display, name)) if name.endswith("_mm") else share


def _solve(
    observations: Residuals, start: Guess, free: np.ndarray, prior: _Prior, sizes: np.ndarray
) -> Guess:
    """The best guess, from one that is near it, by Levenberg's and Marquardt's method.

    Of normal equations with weights of the soft l1 loss: there are a thousand residuals for each
    unknown, and `scipy.optimize.least_squares` decomposes all of them in every step, which took
    about half of the time.
    """
    steps, weights = start.steps[free], inverse_sizes(observations, sizes)
    prior_steps = steps / prior.deviation[free]

    def moved(z: np.ndarray) -> tuple[np.ndarray, Guess]:
        by = np.zeros(free.size)
        by[free] = z * steps
        return by, start.with_changes(by)

    def residuals(guess: Guess) -> tuple[np.ndarray, np.ndarray, float]:
        with np.errstate(all="ignore"):  # a step too far is not taken
            own = observations.flat(guess) * weights
        off = ((_values(guess) - prior.mean) / prior.deviation)[free]
        robust = 2 * ROBUST**2 * float((np.sqrt(1 + (own / ROBUST) ** 2) - 1).sum())
        return own, off, robust + float(off @ off)

    at, damping = np.zeros(steps.size), _DAMPING
    by, guess = moved(at)
    own, off, cost = residuals(guess)
    for _ in range(_MOST_STEPS):
        slopes = observations.slopes(start, by, free)
        slopes *= weights
        slopes *= steps[:, None]
        weighted = slopes / np.sqrt(1 + (own / ROBUST) ** 2)
        curvature, gradient = weighted @ slopes.T, weighted @ own
        curvature += np.diag(prior_steps**2)
        gradient += prior_steps * off
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


def _sizes(observations: Residuals, guess: Guess, display: Display) -> np.ndarray:
    """Usual size of each position's residuals, as a normal distribution's standard deviation.

    Those of a noiseless photograph would give its rays, with small systematic errors, all weight.
    """
    least = _in_mm([kind.least for kind in observations.kinds], display)
    return np.array(
        [
            np.hypot([1.4826 * float(np.median(np.abs(part))) for part in pair], least)
            for pair in observations.residuals(guess)
        ]
    )


def _check(
    names: tuple[str, ...],
    display: Display,
    guess: Guess,
    sizes: np.ndarray,
    lenses: tuple[Any, ...],
) -> None:
    """Raise `FileError` where no display of this kind explains the photographs."""
    if display.layout.of_cylinders:
        for name, (of_rays, of_views) in zip(names, sizes, strict=True):
            panel = of_rays / display.pitch_mm
            if panel > _WORST_CYLINDERS[0] or of_views > _WORST_CYLINDERS[1]:
                raise FileError(
                    f"{name}: the photographs differ from display {display.name} by {panel:.2g} "
                    f"lenses on the panel and {of_views:.2g} in the views; check that the patterns "
                    "are those of this display and fill its panel pixel for pixel, with fixed zoom "
                    "and focus, or omit this position"
                )
        return
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
    # One position alone begins with a distance of its own choice.
    check_pitch(display, guess.display.pitch_mm / display.pitch_mm, ", ".join(names))
