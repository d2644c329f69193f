"""Tolerances of a display: `tolerate.json`."""

from __future__ import annotations

from inim.documents.document import Part
from inim.documents.parts import DisplayRecord, SceneFileRecord, TitledDocument


class LossCurve(Part):
    """Loss of an error e, 1 - exp(-(abs(e) / w) ** power), fitted to the draws."""

    power: float  #: The exponent.
    below: float  #: w of negative errors.
    above: float  #: w of positive errors.
    line: list[tuple[float, float]]  #: Pairs of an error and its loss, to draw the curve with.


class DrawAlone(Part):
    """A display with an error of one parameter."""

    error: float  #: Error of the parameter.
    score: float  #: SSIM on the relic to the reference, the mean over the viewpoints.


class ParameterTolerance(Part):
    """Errors of one parameter, all others exact."""

    name: str  #: Name of the parameter among the misalignments.
    #: Distribution of the error where all parameters are drawn at once: `normal` or `uniform`.
    distribution: str
    spread: float  #: Standard deviation of a normal error, half of the range of a uniform one.
    farthest: float  #: Largest error drawn alone, either way.
    #: The largest error, either way, that costs no more than the criterion; null: it is larger than
    #: all errors drawn, or too few displays have a score.
    tolerance: float | None
    #: 95 % interval of the tolerance, by bootstrap of the draws; an end of null is larger than all
    #: errors drawn.
    interval: tuple[float | None, float | None] | None
    curve: LossCurve | None  #: Loss against error; null: too few displays have a score.
    scatter: float | None  #: Median distance of the draws from the curve, as a standard deviation.
    #: Standard error that a calibration reaches; null: none was given, or not determined.
    calibration_standard_error: float | None
    draws: list[DrawAlone]  #: The displays drawn, without those that could not be validated.


class DrawTogether(Part):
    """A display with errors of all parameters."""

    errors: dict[str, float]  #: Errors by parameter.
    score: float  #: SSIM on the relic to the reference, the mean over the viewpoints.
    #: Sum of the losses of its errors alone, by the curves; null: a curve is missing.
    sum_of_losses: float | None


class Together(Part):
    """Displays with errors of all parameters at once."""

    share: float  #: Share of the displays that lose no more than the criterion.
    interval: tuple[float, float]  #: 95 % interval of the share (Wilson).
    #: Median ratio of a display's loss to the sum of the losses of its errors alone, of displays
    #: where that sum is half of the criterion or more; null: there is none.
    to_sum: float | None
    #: The part of its tolerance that each error may have at once if losses add up; null: no
    #: parameter has a tolerance.
    part_of_each: float | None
    draws: list[DrawTogether]  #: The displays drawn, without those that could not be validated.


class FailedDisplay(Part):
    """A display that could not be validated."""

    display: str  #: Names of the scene, the display and its errors.
    error: str  #: The reason, in a line.


class ToleranceDocument(TitledDocument, tag="inim.tolerate/2"):
    """Tolerances of a display.

    `tolerate.json` in the folder of `inim tolerate`: losses of errors of a display that its
    elemental images do not take into account, and the largest tolerable errors. Lengths are in mm
    and angles in degrees, as the parameters' names show. Fitted figures are rounded to four
    significant digits.
    """

    scene: SceneFileRecord
    display: DisplayRecord
    viewpoints: list[str]  #: Names of the viewpoints over which scores are averaged.
    algorithm: str  #: Algorithm, with options, of the EIA that is made for the display as designed.
    criterion: float  #: Tolerable loss of SSIM on the relic to the reference.
    reach: float  #: Largest error drawn alone, as a multiple of the parameter's spread.
    seed: int  #: Seed of the draws.
    #: Score of the display as designed: SSIM on the relic to the reference, the mean over the
    #: viewpoints.
    aligned: float
    parameters: list[ParameterTolerance]  #: Each parameter alone, all others exact.
    #: All parameters at once; null: no such display was drawn, or none has a score.
    together: Together | None
    failed: list[FailedDisplay]  #: Displays that could not be validated.
