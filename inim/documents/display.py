"""Documents about a real display: calibration, photographs of it, and tolerances."""

from __future__ import annotations

from collections.abc import Mapping

from inim.documents.document import Document, Part
from inim.documents.parts import DisplayRecord, Files, SceneFileRecord, TitledDocument, Versions

Vector = tuple[float, float, float]


class ParameterEstimate(Part):
    """A parameter of the display, as determined by the photographs."""

    value: float  #: Best value, also where it is not determined.
    standard_error: float  #: Standard error of the value.
    low: float  #: Lower end of the 95 % interval.
    high: float  #: Upper end of the 95 % interval.
    #: Largest standard error of a parameter that counts as determined.
    largest_standard_error: float
    #: True if the photographs determine the parameter; the display file has the design's value
    #: otherwise.
    is_determined: bool
    nominal: float  #: The design's value.


class CertainShift(Part):
    """Axes along which both edges of the array are seen; elsewhere the shift is modulo a pitch."""

    x: bool  #: The left and the right edge are seen.
    y: bool  #: The upper and the lower edge are seen.


class CameraEstimate(Part):
    """The camera's intrinsics."""

    is_given: bool  #: True if the intrinsics were given; fitted otherwise.
    width_px: int  #: Width of the photographs, pixels.
    height_px: int  #: Height of the photographs, pixels.
    focal_px: float  #: Focal length, pixels of the photographs.
    centre_x_px: float  #: Principal point, to the right, pixels; a pixel's centre is at a half.
    centre_y_px: float  #: Principal point, downwards, pixels.
    k1: float  #: Radial distortion of the second order, OpenCV's k1.
    k2: float  #: Radial distortion of the fourth order, OpenCV's k2.
    p1: float  #: Tangential distortion, OpenCV's p1.
    p2: float  #: Tangential distortion, OpenCV's p2.
    #: Standard errors of `focal_px` to `p2`, by name; null of given ones.
    standard_errors: dict[str, float | None]


class Correlation(Part):
    """Correlations of the estimates."""

    names: list[str]  #: Parameters of the display, then of the camera where it was fitted.
    #: A row for each name, in their order, with a number for each name; null: not known.
    matrix: list[list[float | None]]


class CameraPosition(Part):
    """A position of the camera."""

    name: str  #: Name of the folder of its photographs.
    eye_mm: Vector  #: Position of the camera's pupil, display frame, mm.
    eye_standard_error_mm: Vector  #: Standard error of the position, mm.
    #: Rotation from the display's frame to the camera's (x right, y down, z away), rows.
    turn: tuple[Vector, Vector, Vector]
    #: Standard error of the rotation about the camera's axes, degrees.
    turn_standard_error_deg: Vector
    off_straight_deg: float  #: Angle between the display's axis and the line to the pupil, degrees.
    lenses: int  #: Number of detected lenses; of a lenticular display, samples of the photographs.
    whole_lenses: int  #: Lenses whose whole outline is in the photographs; 0 of a lenticular.
    #: Typical distance on the panel between the end of a ray and that of the fit, along an axis,
    #: µm.
    panel_residual_um: float
    #: Second kind of residuals, with its unit: distance between a lens's centre in the photographs
    #: and that of the fit, along an axis, pixels; of a lenticular display, difference of the views,
    #: thousandths of a lens.
    second_kind: str
    second_residual: float  #: Typical residual of the second kind.
    #: Patterns across the sheet in the residuals: root mean square of a low-order polynomial
    #: component, on the panel, µm.
    smooth_residual_um: float
    smooth_second: float  #: The same of the second kind.
    #: Largest change of a parameter without this position, in its standard errors; null for fewer
    #: than three positions.
    change_without: float | None
    zoom: float  #: Focal length relative to the camera's, minus 1.
    skew: float  #: Skew of the photographs, pixels to the right per pixel down.
    stretch: float  #: Stretch of the photographs downwards, minus 1.
    motion_px: float  #: Corrected displacement between the photographs, root mean square, pixels.
    #: Sigma of the camera's blur, pixels; negative after sharpening; null of a lenticular display.
    blur_px: float | None


class SheetDeviation(Part):
    """Deviation of the sheet from the design that is fitted, but not used."""

    value: float  #: Best value.
    standard_error: float  #: Standard error of the value.
    #: Deviation in standard deviations that are expected; beyond ±5 the model fails.
    pull: float


class NextPosition(Part):
    """A position to photograph from next."""

    description: str  #: The position in words.
    eye_mm: Vector  #: Position of the camera's pupil, display frame, mm.
    #: Standard errors of the display's parameters with photographs from there added.
    standard_errors: dict[str, float]


class CalibrationDocument(TitledDocument, tag="inim.calibration/4"):
    """Calibration of a display.

    `calibration.json` in the folder of `inim calibrate`: a display's parameters, determined from
    photographs.
    """

    versions: Versions
    display: DisplayRecord
    #: Estimates by parameter of the display: `pitch_mm`, `rotation_deg`, `shift_x_mm`,
    #: `shift_y_mm`, `gap_mm`, `tilt_x_deg`, `tilt_y_deg` and `focal_length_mm`; of a lenticular
    #: display, `pitch_mm`, `rotation_deg`, `shift_x_mm` and `gap_mm`.
    parameters: dict[str, ParameterEstimate]
    not_determined: list[str]  #: Parameters that the photographs do not determine.
    #: Standard error of the views at the worst corner of the panel, in lenses; null of a display
    #: without cylinders.
    view_standard_error: float | None
    shift_is_certain: CertainShift
    camera: CameraEstimate
    correlation: Correlation
    #: `refractive_index` (added), `thickness` (share), `glass_mm` (glass within the gap),
    #: `bow_x_mm`, `bow_y_mm` and `bow_xy_mm` (gap at edges and corners less that in the middle).
    sheet: dict[str, SheetDeviation]
    positions: list[CameraPosition]  #: The camera's positions.
    failures: list[str]  #: Effects that the model does not explain; if any, no value holds.
    next: list[NextPosition]  #: Positions to photograph from next, the best one first.
    warnings: list[str]  #: Sentences on parameters that are not determined, and other warnings.
    files: Files


class PatternsDocument(Document, tag="inim.patterns/1"):
    """Patterns for calibration.

    `patterns.json` of `inim calibrate patterns`: the display and the order of its patterns.
    """

    inim_version: str  #: Version of inim that wrote the document.
    display: str  #: Name of the display.
    panel_rows: int  #: Panel pixels down, as of every picture.
    panel_columns: int  #: Panel pixels across.
    pixel_pitch_mm: float  #: Panel pixel, mm.
    pictures: list[str]  #: File names in the order of display.


class ImageShift(Part):
    """Displacement of the photograph against the simulation."""

    right_px: float  #: To the right, pixels of the photograph.
    down_px: float  #: Down, pixels of the photograph.
    #: Standard error, from the scatter of the blocks; null: too few blocks show enough.
    standard_error_px: float | None
    lens_px: float  #: Lens pitch, pixels of the photograph.
    block_px: int  #: Side of the blocks, pixels of the photograph.
    largest_block_px: float  #: Largest displacement of a block, pixels of the photograph.


class ToneCurve(Part):
    """Response of a channel, black + gain * light ^ gamma."""

    black: float  #: Value of the photograph without light.
    gain: float  #: Factor of the light.
    gamma: float  #: Exponent of the light.


class MatchedStage(Part):
    """The simulation after one more cause of difference is added to it."""

    name: str  #: The cause added last.
    error_share: float  #: Remaining squared error of linear light, as a share of the first stage's.
    #: Scores against the photograph, by metric and unit; null: infinite.
    scores: Mapping[str, float | None]


class PhotoDocument(TitledDocument, tag="inim.photo/2"):
    """Photograph against simulation.

    `photo.json` of `inim photo`: differences between a photograph of a calibrated display and its
    simulation.
    """

    versions: Versions
    photograph: str  #: File of the photograph.
    eia: str  #: File of the EIA on the panel.
    #: Position of the calibration, or folder of patterns that were photographed from the same
    #: place.
    position: str
    display: DisplayRecord
    #: Left, top, right and bottom of the compared part, pixels of the photograph.
    window_px: tuple[int, int, int, int]
    geometry: ImageShift
    #: Sigma of the Gaussian blur that makes the simulation as blurred as the photograph, pixels.
    blur_sigma_px: float
    tone: dict[str, ToneCurve]  #: Response of panel and camera, by `red`, `green` and `blue`.
    stages: list[MatchedStage]  #: The simulation, with one more cause of difference in each stage.
    files: Files


# -- tolerances ---


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
