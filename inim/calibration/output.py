"""A calibration as a display file and as data, with positions to photograph from next."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from inim.calibration.lattice import Lenses
from inim.calibration.misfit import inverse_sizes
from inim.calibration.model import (
    PARAMETERS,
    POSE,
    SHARED,
    Deviations,
    Guess,
    Intrinsics,
    Observations,
    Pose,
)
from inim.calibration.result import INTERVAL, Calibration
from inim.display import Display
from inim.documents.display import (
    CalibrationDocument,
    CameraEstimate,
    CameraPosition,
    CertainShift,
    Correlation,
    NextPosition,
    ParameterEstimate,
    SheetDeviation,
)
from inim.documents.parts import DisplayRecord, origin
from inim.report.calibration import ResidualMaps
from inim.settings import DISPLAY_KEYS, display_xml, value_text
from inim.version import __version__

_VERSIONS = ("numpy", "scipy")
_MOST_ADVICE = 3
# Motion of the camera and changes of its focal length that cause a warning.
_LEAST_MOTION_PX, _LEAST_ZOOM = 0.5, 0.005
# Standard errors are this many times wider than without skew before a warning appears.
_WIDE = 2.0
_DIGITS = 9


def display_file(calibration: Calibration, preset: str) -> str:
    """Write the display as XML for `--display`, with standard errors as comments.

    * `preset`: preset that the file changes, for reports.
    """
    values = calibration.display.parameters()
    defaults = {field.name: field.default for field in fields(Display)}
    positions = ", ".join(calibration.names)
    about = (
        f"    <!-- {_comment(f'Calibrated by inim {__version__} from photographs: {positions}.')}",
        "         Behind each measured value stands its standard error. -->",
    )
    texts, comments = {"display": preset}, {}
    for key in DISPLAY_KEYS:
        estimate = calibration.estimates.get(key)
        if values[key] == defaults[key] and estimate is None:
            continue
        value = values[key]
        text = f"{value:.{_DIGITS}g}" if isinstance(value, float) else value_text(key, value)
        if estimate is not None and estimate.is_known:
            text = f"{value:.{_decimals(estimate.error)}f}"
        texts[key] = text
        if estimate is not None:
            comments[key] = _describe_error(key, calibration)
    return display_xml(texts, comments, about)


def _decimals(error: float) -> int:
    """Decimals of a value, to a hundredth of its standard error."""
    return max(0, 2 - math.floor(math.log10(error)))


def _comment(text: str) -> str:
    """A comment ends at two hyphens; folders may be called anything."""
    return "".join(c if c.isprintable() else " " for c in text).replace("--", "- -")


def _describe_error(key: str, calibration: Calibration) -> str:
    estimate = calibration.estimates[key]
    if not estimate.is_known:
        return f"as designed: not determined (standard error {estimate.error:.2g})"
    axis = {"shift_x_mm": 0, "shift_y_mm": 1}.get(key)
    modulo = axis is not None and not calibration.edges_seen[axis]
    return f"± {estimate.error:.2g}" + (", or whole pitches more or less" if modulo else "")


def residual_maps(calibration: Calibration) -> ResidualMaps:
    """Maps of the residuals of each position and kind, in the units of reports.

    Of lenses, all detected lenses count, with the mean of a lens's rays.
    """
    observations, guess = calibration.observations, calibration.guess
    if isinstance(observations, Observations):
        every = Observations.of(calibration.lenses, guess.display)  # type: ignore[arg-type]
        observations = every.without_blur(guess)
    columns, rows = observations.grid(guess)
    kinds = observations.kinds
    labels = [(f"{kind.title}, {axis}", kind.unit) for kind in kinds for axis in kind.axes]
    maps = {}
    for name, places, residuals in zip(
        calibration.names, observations.places, observations.residuals(guess), strict=True
    ):
        parts = zip(places, residuals, kinds, strict=True)
        maps[name] = np.concatenate(
            [_mean_map(at, -kind.scale * values, (rows, columns)) for at, values, kind in parts],
            axis=-1,
        )
    return ResidualMaps(labels, maps)


def _mean_map(index: np.ndarray, values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Mean of the values of each place, given by column and row, in (rows, columns)."""
    number = index[:, 1] * shape[1] + index[:, 0]
    size = shape[0] * shape[1]
    count = np.bincount(number, minlength=size)
    sums = [np.bincount(number, component, size) for component in values.T]
    with np.errstate(invalid="ignore"):
        mean: np.ndarray = (np.stack(sums, axis=-1) / count[:, None]).reshape(*shape, -1)
    return mean


def calibration_document(
    calibration: Calibration, title: str, command: str, is_steady: bool = False
) -> CalibrationDocument:
    """The calibration as a document, without the list of its files."""
    advice = next_positions(calibration)
    return CalibrationDocument(
        title=title,
        **origin(command, _VERSIONS),
        display=DisplayRecord.of(calibration.display),
        parameters={
            name: _estimate(calibration, name)
            for name in calibration.estimates
            if name in PARAMETERS
        },
        not_determined=calibration.undetermined,
        view_standard_error=calibration.view_error,
        shift_is_certain=CertainShift(x=calibration.edges_seen[0], y=calibration.edges_seen[1]),
        camera=_camera(calibration),
        correlation=Correlation(
            names=list(calibration.estimates), matrix=calibration.correlation.tolist()
        ),
        sheet=_sheet(calibration),
        positions=[_position(calibration, n) for n in range(len(calibration.names))],
        failures=calibration.failures,
        next=advice[:_MOST_ADVICE],
        warnings=_warnings(calibration, advice, is_steady),
        files=[],
    )


def _estimate(calibration: Calibration, name: str) -> ParameterEstimate:
    estimate = calibration.estimates[name]
    low, high = estimate.interval
    return ParameterEstimate(
        value=estimate.value,
        standard_error=estimate.error,
        low=low,
        high=high,
        largest_standard_error=estimate.limit,
        is_determined=estimate.is_known,
        nominal=getattr(calibration.nominal, name),
    )


def _camera(calibration: Calibration) -> CameraEstimate:
    camera, (height, width) = calibration.guess.camera, calibration.lenses[0].shape
    is_given = "focal_px" not in calibration.estimates
    return CameraEstimate(
        is_given=is_given,
        width_px=width,
        height_px=height,
        **camera._asdict(),
        standard_errors={
            name: None if is_given else calibration.estimates[name].error for name in camera._fields
        },
    )


def _position(calibration: Calibration, n: int) -> CameraPosition:
    pose, errors = calibration.guess.poses[n], calibration.pose_errors[n]
    lenses, (x, y, z) = calibration.lenses[n], pose.eye_mm
    right, down, away = map(tuple, pose.turn.tolist())
    second = calibration.observations.kinds[1]
    blur_px = None
    if isinstance(lenses, Lenses):
        blur_px = math.copysign(math.sqrt(abs(lenses.blur_px2)), lenses.blur_px2)
    return CameraPosition(
        name=calibration.names[n],
        eye_mm=tuple(pose.eye_mm.tolist()),
        eye_standard_error_mm=tuple(errors[3:6].tolist()),
        turn=(right, down, away),
        turn_standard_error_deg=tuple(np.degrees(errors[:3]).tolist()),
        off_straight_deg=math.degrees(math.atan2(math.hypot(x, y), z)),
        lenses=len(lenses.index),
        whole_lenses=int(lenses.is_whole.sum()) if isinstance(lenses, Lenses) else 0,
        panel_residual_um=1e3 * float(calibration.sizes[n, 0]),
        second_residual=second.scale * float(calibration.sizes[n, 1]),
        smooth_residual_um=1e3 * float(calibration.smooth[n, 0]),
        smooth_second=second.scale * float(calibration.smooth[n, 1]),
        second_kind=f"{second.title}, {second.unit}",
        change_without=float(np.abs(calibration.left_out[n]).max()) or None,
        zoom=pose.zoom,
        skew=pose.skew,
        stretch=pose.stretch,
        motion_px=lenses.motion_px,
        blur_px=blur_px,
    )


def _sheet(calibration: Calibration) -> dict[str, SheetDeviation]:
    first = SHARED.index(Deviations._fields[0])
    return {
        name: SheetDeviation(
            value=value,
            standard_error=math.sqrt(calibration.covariance[n, n]),
            pull=float(calibration.pulls[n]),
        )
        for n, (name, value) in enumerate(calibration.guess.deviations._asdict().items(), first)
    }


def _warnings(
    calibration: Calibration, advice: Sequence[NextPosition], is_steady: bool
) -> list[str]:
    warnings = list(calibration.failures)
    for name, lenses, pose, errors in zip(
        *(calibration.names, calibration.lenses),
        *(calibration.guess.poses, calibration.pose_errors),
        strict=True,
    ):
        if lenses.motion_px > _LEAST_MOTION_PX:
            warnings.append(
                f"{name}: the camera moved by {lenses.motion_px:.1f} pixels between the "
                "photographs; this is corrected, but a firm support gives better results"
            )
        if abs(pose.zoom) > max(_LEAST_ZOOM, INTERVAL * errors[6]):
            warnings.append(
                f"{name}: the focal length differs by {pose.zoom:+.1%}; this is fitted, but a "
                "fixed zoom and focus give better results"
            )
    excess = calibration.excess_by_skew
    if excess > _WIDE and not is_steady:
        warnings.append(
            f"intervals are up to {excess:.0f} times wider than with a steady camera, because a "
            "rolling shutter skews the photographs of a moving one; if it stood on a firm support "
            "and nobody touched it, give --steady"
        )
    if calibration.undetermined:
        place = f"{advice[0].description}, too" if advice else "elsewhere"
        warnings.append(
            f"not determined by these photographs, and left as designed: "
            f"{', '.join(calibration.undetermined)}; photograph from {place}"
        )
    for axis, is_visible in zip("xy", calibration.edges_seen, strict=True):
        if not is_visible:
            edges = "left and right" if axis == "x" else "upper and lower"
            warnings.append(
                f"shift_{axis}_mm is known modulo a pitch, for the sheet's {edges} edges are not "
                "both seen: the one nearest to the design is given"
            )
    return warnings


# Directions to look from: right and up, in shares of the angle at which views flip.
_ASIDE = {
    "straight on": (0.0, 0.0),
    "the left": (-0.8, 0.0),
    "the right": (0.8, 0.0),
    "above": (0.0, 0.8),
    "below": (0.0, -0.8),
}
# Distances, in those that there are: nearer, as near, as far, farther.
_NEARER, _FARTHER = 0.75, 1.5


def next_positions(calibration: Calibration) -> list[NextPosition]:
    """Positions worth adding, the best one first.

    Each is one of some directions and distances; the best leaves the least product of standard
    errors. Residuals there are taken to be those of the positions there are.
    """
    display, camera, poses, _ = calibration.guess
    distances = sorted(float(pose.eye_mm[2]) for pose in poses)
    steps = calibration.guess.steps[: len(SHARED)]
    free = np.diag(calibration.covariance)[: len(SHARED)] > 0
    own = calibration.covariance[: len(SHARED), : len(SHARED)] / np.outer(steps, steps)
    own = own[np.ix_(free, free)]
    half_angle = math.radians(display.viewing_half_angle_deg)
    advised = []
    for distance in sorted(
        {_NEARER * distances[0], distances[0], distances[-1], _FARTHER * distances[-1]}
    ):
        for words, (right, up) in _ASIDE.items():
            eye = distance * np.array(
                [math.tan(right * half_angle), math.tan(up * half_angle), 1.0]
            )
            more = _information(display, camera, _pose_facing_display(eye), calibration, free)
            if more is None:
                continue
            # (own^-1 + more)^-1, of a covariance that may be nearly singular.
            left = np.linalg.solve(np.eye(len(own)) + own @ more, own)
            errors = np.sqrt(np.diag(left)) * steps[free]
            fitted = [SHARED[n] for n in np.flatnonzero(free)]
            named = {
                name: float(error)
                for name, error in zip(fitted, errors, strict=True)
                if name in PARAMETERS
            }
            off = math.degrees(math.hypot(right, up) * half_angle)
            direction = f", {off:.0f}° off straight" if off else ""
            place = f"{words}{direction}, {distance:.0f} mm away"
            advised.append(
                NextPosition(description=place, eye_mm=tuple(eye.tolist()), standard_errors=named)
            )
    return sorted(
        advised, key=lambda position: sum(map(math.log, position.standard_errors.values()))
    )


def _pose_facing_display(eye: np.ndarray) -> Pose:
    """A camera that looks at the display's middle, upright."""
    z = -eye / np.linalg.norm(eye)
    x = np.cross([0.0, -1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return Pose(np.stack([x, np.cross(z, x), z]), eye)


def _information(
    display: Display, camera: Intrinsics, pose: Pose, calibration: Calibration, free: np.ndarray
) -> np.ndarray | None:
    """Information of a new position about `SHARED`; None if it sees too little."""
    guess = Guess(display, camera, (pose,))
    observations = calibration.observations.seen_from(guess, calibration.lenses[0].shape)
    if observations is None:
        return None
    fitted = np.append(free, np.ones(POSE, bool))
    slopes = (
        observations.slopes(guess, np.zeros(fitted.size), fitted) * guess.steps[fitted][:, None]
    )
    # The rays of a lens count as one: they see the same few pixels of the panel.
    sizes = calibration.sizes.mean(axis=0) * [math.sqrt(observations.rays_at_a_place), 1.0]
    slopes = slopes * inverse_sizes(observations, sizes)
    whole = slopes @ slopes.T
    a, b, d = whole[:-POSE, :-POSE], whole[:-POSE, -POSE:], whole[-POSE:, -POSE:]
    information: np.ndarray = a - b @ np.linalg.solve(d, b.T)
    return information
