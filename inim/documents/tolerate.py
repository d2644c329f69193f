"""Tolerances of a display: `tolerate.json`."""

from __future__ import annotations

from typing import Annotated

from inim.documents.document import Part, doc
from inim.documents.parts import DisplayRecord, SceneFileRecord, TitledDocument

_SCORE = "SSIM on the relic to the reference, the mean over the viewpoints."


class LossCurve(Part):
    """Loss of an error e, 1 - exp(-(abs(e) / w) ** power), fitted to the draws."""

    power: Annotated[float, doc("The exponent.")]
    below: Annotated[float, doc("w of negative errors.")]
    above: Annotated[float, doc("w of positive errors.")]
    line: Annotated[
        list[tuple[float, float]], doc("Pairs of an error and its loss, to draw the curve with.")
    ]


class DrawAlone(Part):
    """A display with an error of one parameter."""

    error: Annotated[float, doc("Error of the parameter.")]
    score: Annotated[float, doc(_SCORE)]


class ParameterTolerance(Part):
    """Errors of one parameter, all others exact."""

    name: Annotated[str, doc("Name of the parameter among the misalignments.")]
    distribution: Annotated[
        str,
        doc(
            "Distribution of the error where all parameters are drawn at once: `normal` or "
            "`uniform`."
        ),
    ]
    spread: Annotated[
        float, doc("Standard deviation of a normal error, half of the range of a uniform one.")
    ]
    farthest: Annotated[float, doc("Largest error drawn alone, either way.")]
    tolerance: Annotated[
        float | None,
        doc(
            "The largest error, either way, that costs no more than the criterion; null: it is "
            "larger than all errors drawn, or too few displays have a score."
        ),
    ]
    interval: Annotated[
        tuple[float | None, float | None] | None,
        doc(
            "95 % interval of the tolerance, by bootstrap of the draws; an end of null is larger "
            "than all errors drawn."
        ),
    ]
    curve: Annotated[
        LossCurve | None, doc("Loss against error; null: too few displays have a score.")
    ]
    scatter: Annotated[
        float | None,
        doc("Median distance of the draws from the curve, as a standard deviation."),
    ]
    calibration_standard_error: Annotated[
        float | None,
        doc("Standard error that a calibration reaches; null: none was given, or not determined."),
    ]
    draws: Annotated[
        list[DrawAlone], doc("The displays drawn, without those that could not be validated.")
    ]


class DrawTogether(Part):
    """A display with errors of all parameters."""

    errors: Annotated[dict[str, float], doc("Errors by parameter.")]
    score: Annotated[float, doc(_SCORE)]
    sum_of_losses: Annotated[
        float | None,
        doc("Sum of the losses of its errors alone, by the curves; null: a curve is missing."),
    ]


class Together(Part):
    """Displays with errors of all parameters at once."""

    share: Annotated[float, doc("Share of the displays that lose no more than the criterion.")]
    interval: Annotated[tuple[float, float], doc("95 % interval of the share (Wilson).")]
    to_sum: Annotated[
        float | None,
        doc(
            "Median ratio of a display's loss to the sum of the losses of its errors alone, of "
            "displays where that sum is half of the criterion or more; null: there is none."
        ),
    ]
    part_of_each: Annotated[
        float | None,
        doc(
            "The part of its tolerance that each error may have at once if losses add up; null: "
            "no parameter has a tolerance."
        ),
    ]
    draws: Annotated[
        list[DrawTogether], doc("The displays drawn, without those that could not be validated.")
    ]


class FailedDisplay(Part):
    """A display that could not be validated."""

    display: Annotated[str, doc("Names of the scene, the display and its errors.")]
    error: Annotated[str, doc("The reason, in a line.")]


class ToleranceDocument(TitledDocument, tag="inim.tolerate/2"):
    """Tolerances of a display.

    `tolerate.json` in the folder of `inim tolerate`: losses of errors of a display that its
    elemental images do not take into account, and the largest tolerable errors. Lengths are in mm
    and angles in degrees, as the parameters' names show. Fitted figures are rounded to four
    significant digits.
    """

    scene: SceneFileRecord
    display: DisplayRecord
    viewpoints: Annotated[list[str], doc("Names of the viewpoints over which scores are averaged.")]
    algorithm: Annotated[
        str, doc("Algorithm, with options, of the EIA that is made for the display as designed.")
    ]
    criterion: Annotated[float, doc("Tolerable loss of SSIM on the relic to the reference.")]
    reach: Annotated[
        float, doc("Largest error drawn alone, as a multiple of the parameter's spread.")
    ]
    seed: Annotated[int, doc("Seed of the draws.")]
    aligned: Annotated[float, doc(f"Score of the display as designed: {_SCORE}")]
    parameters: Annotated[list[ParameterTolerance], doc("Each parameter alone, all others exact.")]
    together: Annotated[
        Together | None,
        doc("All parameters at once; null: no such display was drawn, or none has a score."),
    ]
    failed: Annotated[list[FailedDisplay], doc("Displays that could not be validated.")]
