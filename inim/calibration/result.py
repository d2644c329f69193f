"""Result of a calibration: a display with standard errors, and tests of the model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from inim.calibration.model import CHANGES, PARAMETERS, POSE, SHARED, STEPS, Guess, Residuals
from inim.display import Display

if TYPE_CHECKING:
    from inim.calibration.fringes import Fringes
    from inim.calibration.lattice import Lenses

#: An interval of so many standard errors holds the truth in 95 % of cases.
INTERVAL = 1.96
# The model fails above these pulls, and changes without a position.
_MOST_PULL, _MOST_CHANGE = 5.0, 5.0
_CAUSES = {
    "refractive_index": "another refractive_index, lens_thickness_mm or glass over the panel than "
    "the display file has",
    "bow_": "a bowed sheet",
    "zoom": "zoom or focus that changed for this position",
    "skew": "skewed photographs, by a rolling shutter or image stabilisation",
    "p": "a camera with other distortion than the model",
}
_CAUSES |= {
    "thickness": _CAUSES["refractive_index"],
    "glass": _CAUSES["refractive_index"],
    "stretch": _CAUSES["skew"],
}


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
    pose_errors : tuple of (9,) array
        Standard errors of each position: rotation in radians about the camera's axes, eye in mm,
        `inim.calibration.model.CHANGES`.
    correlation : array
        Correlation of `estimates`, in their order.
    covariance : array
        Covariance of all fitted parameters, in the order of `Guess.with_changes`; 0 if fixed.
    edges_seen : (bool, bool)
        True if the array's left and right, and top and bottom, edges are visible, or if it has
        cylinders, all of which are equal: the shift is unambiguous. Otherwise it is ambiguous by a
        pitch, and the value nearest to the nominal display is used.
    names : tuple of str
        Names of the positions.
    lenses : tuple of Lenses or of Fringes
        All detected lenses, counted from the array's top left, or samples of the fringes.
    observations : Residuals
        The observations in the fit.
    sizes : (positions, 2) array
        Typical size of the residuals of both kinds, such as panel mm and pixels.
    misfit : (positions, 2, polynomials) array
        Low-order components of the residuals; see `inim.calibration.misfit.low_order_misfit`.
    pulls, left_out : arrays
        Tests of the model; see `inim.calibration.misfit.Uncertainty`.
    """

    nominal: Display
    guess: Guess
    estimates: dict[str, Estimate]
    pose_errors: tuple[np.ndarray, ...]
    correlation: np.ndarray
    covariance: np.ndarray
    edges_seen: tuple[bool, bool]
    names: tuple[str, ...]
    lenses: tuple[Lenses | Fringes, ...]
    observations: Residuals
    sizes: np.ndarray
    misfit: np.ndarray
    pulls: np.ndarray
    left_out: np.ndarray

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
        distance = self.nominal.layout.design_distance_mm
        if distance is not None:  # elemental images for the viewer that the design has
            gap = determined.get("gap_mm", self.nominal.gap_mm)
            pitch = determined.get("pitch_mm", self.nominal.pitch_mm)
            determined["elemental_pitch_mm"] = pitch * (1 + gap / distance)
            determined["focal_length_mm"] = self.nominal.focal_length_mm * gap / self.nominal.gap_mm
        return self.nominal.replace(
            name=f"{self.nominal.name}, calibrated",
            panel_rows=rows,
            panel_columns=columns,
            **determined,
        )

    @property
    def failures(self) -> list[str]:
        """Sentences on effects that the model does not explain; with any, no value holds."""
        sentences, shared = [], len(SHARED)
        names = [*SHARED, *("" for _ in range(len(self.pulls) - shared))]
        for n in np.flatnonzero(np.abs(self.pulls) > _MOST_PULL):
            position, change = divmod(n - shared, POSE)
            name = names[n] or CHANGES[change - (POSE - len(CHANGES))]
            place = "all positions" if n < shared else self.names[position]
            causes = [cause for begin, cause in _CAUSES.items() if name.startswith(begin)]
            if causes:
                sentences.append(
                    f"{place}: {name} deviates by {abs(self.pulls[n]):.0f} standard deviations; "
                    f"likely cause: {causes[0]}"
                )
        for name, smooth, change, lenses in zip(
            self.names, self.smooth, np.abs(self.left_out).max(axis=1), self.lenses, strict=True
        ):
            cause = "a bowed or uneven sheet, or another display than the given one"
            if lenses.motion_px > 1:
                cause = f"a camera that moved by {lenses.motion_px:.1f} pixels"
            panel_px = smooth[0] / self.nominal.pixel_pitch_mm
            of_rays, second = self.observations.kinds
            if panel_px > of_rays.most_smooth or smooth[1] > second.most_smooth:
                sentences.append(
                    f"{name}: the residuals have a pattern across the sheet, {panel_px:.2g} panel "
                    f"pixels and {second.scale * smooth[1]:.2g} {second.unit}; likely cause: "
                    f"{cause}"
                )
            elif change > _MOST_CHANGE:
                sentences.append(
                    f"{name}: without this position, the result changes by {change:.0f} standard "
                    "errors; likely cause: zoom or display changed between the positions"
                )
        return sentences

    @property
    def smooth(self) -> np.ndarray:
        """Root mean square of the low-order components, such as panel mm and pixels,
        (positions, 2).
        """
        smooth: np.ndarray = np.sqrt((self.misfit**2).mean(axis=2))
        return smooth

    @property
    def view_error(self) -> float | None:
        """Standard error of the views at the worst corner of the panel, in lenses.

        For the viewer that the design has; None of a display without cylinders.
        """
        nominal, fitted = self.nominal, self.guess.display
        distance = nominal.layout.design_distance_mm
        if distance is None:
            return None

        def lens_numbers(display: Display) -> np.ndarray:
            angle = math.radians(display.rotation_deg)
            x = np.array([-1.0, -1.0, 1.0, 1.0]) * nominal.width_mm / 2
            y = np.array([-1.0, 1.0, -1.0, 1.0]) * nominal.height_mm / 2
            across = math.cos(angle) * x + math.sin(angle) * y
            shift = math.cos(angle) * display.shift_x_mm
            numbers: np.ndarray = (
                across / (1 + display.gap_mm / distance) - shift
            ) / display.pitch_mm
            return numbers

        names = [name for name in self.estimates if name in PARAMETERS]
        steps = [1e-3 * STEPS[name] for name in names]
        slopes = [
            (lens_numbers(fitted.replace(**{k: getattr(fitted, k) + step})) - lens_numbers(fitted))
            / step
            for k, step in zip(names, steps, strict=True)
        ]
        own = [SHARED.index(name) for name in names]
        variances = np.einsum("ic,ij,jc->c", slopes, self.covariance[np.ix_(own, own)], slopes)
        return float(np.sqrt(variances.max()))

    @property
    def excess_by_skew(self) -> float:
        """Largest ratio of a standard error to the one without skew and stretch."""
        changes = [n for n, name in enumerate(CHANGES) if name != "zoom"]
        first = np.arange(len(SHARED), len(self.covariance), POSE) + POSE - len(CHANGES)
        skews = (first[:, None] + changes).ravel()
        skews = skews[np.diag(self.covariance)[skews] > 0]
        if not skews.size:
            return 1.0
        display = np.array([SHARED.index(k) for k in self.estimates if k in PARAMETERS])
        shared = self.covariance[np.ix_(display, skews)]
        of_skews = self.covariance[np.ix_(skews, skews)]
        variance = np.diag(self.covariance)[display]
        explained = (shared * np.linalg.solve(of_skews, shared.T).T).sum(axis=1)
        return float(np.sqrt((variance / (variance - explained)).max()))

    @property
    def undetermined(self) -> list[str]:
        """Parameters of the display that these photographs do not determine."""
        return [k for k, v in self.estimates.items() if k in PARAMETERS and not v.is_known]
