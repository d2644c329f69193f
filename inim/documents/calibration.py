"""Documents of `inim calibrate`, `inim calibrate patterns` and `inim photo`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from inim.documents.document import Document, Part, doc
from inim.documents.parts import DisplayRecord, Files, TitledDocument, Versions

Vector = tuple[float, float, float]


class ParameterEstimate(Part):
    """A parameter of the display, as determined by the photographs."""

    value: Annotated[float, doc("Best value, also where it is not determined.")]
    standard_error: Annotated[float, doc("Standard error of the value.")]
    low: Annotated[float, doc("Lower end of the 95 % interval.")]
    high: Annotated[float, doc("Upper end of the 95 % interval.")]
    largest_standard_error: Annotated[
        float, doc("Largest standard error of a parameter that counts as determined.")
    ]
    is_determined: Annotated[
        bool,
        doc(
            "True if the photographs determine the parameter; the display file has the design's "
            "value otherwise."
        ),
    ]
    nominal: Annotated[float, doc("The design's value.")]


class CertainShift(Part):
    """Axes along which both edges of the array are seen; elsewhere the shift is modulo a pitch."""

    x: Annotated[bool, doc("The left and the right edge are seen.")]
    y: Annotated[bool, doc("The upper and the lower edge are seen.")]


class CameraEstimate(Part):
    """The camera's intrinsics."""

    is_given: Annotated[bool, doc("True if the intrinsics were given; fitted otherwise.")]
    width_px: Annotated[int, doc("Width of the photographs, pixels.")]
    height_px: Annotated[int, doc("Height of the photographs, pixels.")]
    focal_px: Annotated[float, doc("Focal length, pixels of the photographs.")]
    centre_x_px: Annotated[
        float, doc("Principal point, to the right, pixels; a pixel's centre is at a half.")
    ]
    centre_y_px: Annotated[float, doc("Principal point, downwards, pixels.")]
    k1: Annotated[float, doc("Radial distortion of the second order, OpenCV's k1.")]
    k2: Annotated[float, doc("Radial distortion of the fourth order, OpenCV's k2.")]
    standard_errors: Annotated[
        dict[str, float | None],
        doc("Standard errors of `focal_px` to `k2`, by name; null of given ones."),
    ]


class Correlation(Part):
    """Correlations of the estimates."""

    names: Annotated[
        list[str], doc("Parameters of the display, then of the camera where it was fitted.")
    ]
    matrix: Annotated[
        list[list[float | None]],
        doc("A row for each name, in their order, with a number for each name; null: not known."),
    ]


class CameraPosition(Part):
    """A position of the camera."""

    name: Annotated[str, doc("Name of the folder of its photographs.")]
    eye_mm: Annotated[Vector, doc("Position of the camera's pupil, display frame, mm.")]
    eye_standard_error_mm: Annotated[Vector, doc("Standard error of the position, mm.")]
    turn: Annotated[
        tuple[Vector, Vector, Vector],
        doc("Rotation from the display's frame to the camera's (x right, y down, z away), rows."),
    ]
    turn_standard_error_deg: Annotated[
        Vector, doc("Standard error of the rotation about the camera's axes, degrees.")
    ]
    off_straight_deg: Annotated[
        float, doc("Angle between the display's axis and the line to the pupil, degrees.")
    ]
    lenses: Annotated[int, doc("Number of detected lenses.")]
    whole_lenses: Annotated[int, doc("Lenses whose whole outline is in the photographs.")]
    panel_residual_um: Annotated[
        float,
        doc(
            "Typical distance on the panel between the end of a ray and that of the fit, along an "
            "axis, µm."
        ),
    ]
    outline_residual_px: Annotated[
        float,
        doc(
            "Typical distance between a lens's centre in the photographs and that of the fit, "
            "along an axis, pixels."
        ),
    ]


class NextPosition(Part):
    """A position to photograph from next."""

    description: Annotated[str, doc("The position in words.")]
    eye_mm: Annotated[Vector, doc("Position of the camera's pupil, display frame, mm.")]
    standard_errors: Annotated[
        dict[str, float],
        doc("Standard errors of the display's parameters with photographs from there added."),
    ]


class CalibrationDocument(TitledDocument, tag="inim.calibration/2"):
    """Calibration of a display.

    `calibration.json` in the folder of `inim calibrate`: a display's parameters, determined from
    photographs.
    """

    versions: Versions
    display: DisplayRecord
    parameters: Annotated[
        dict[str, ParameterEstimate],
        doc(
            "Estimates by parameter of the display: `pitch_mm`, `rotation_deg`, `shift_x_mm`, "
            "`shift_y_mm`, `gap_mm`, `tilt_x_deg`, `tilt_y_deg` and `focal_length_mm`."
        ),
    ]
    not_determined: Annotated[list[str], doc("Parameters that the photographs do not determine.")]
    shift_is_certain: CertainShift
    camera: CameraEstimate
    correlation: Correlation
    positions: Annotated[list[CameraPosition], doc("The camera's positions.")]
    next: Annotated[
        list[NextPosition], doc("Positions to photograph from next, the best one first.")
    ]
    warnings: Annotated[
        list[str], doc("Sentences on parameters that are not determined, and other warnings.")
    ]
    files: Files


class PatternsDocument(Document, tag="inim.patterns/1"):
    """Patterns for calibration.

    `patterns.json` of `inim calibrate patterns`: the display and the order of its patterns.
    """

    inim_version: Annotated[str, doc("Version of inim that wrote the document.")]
    display: Annotated[str, doc("Name of the display.")]
    panel_rows: Annotated[int, doc("Panel pixels down, as of every picture.")]
    panel_columns: Annotated[int, doc("Panel pixels across.")]
    pixel_pitch_mm: Annotated[float, doc("Panel pixel, mm.")]
    pictures: Annotated[list[str], doc("File names in the order of display.")]


class ImageShift(Part):
    """Displacement of the photograph against the simulation."""

    right_px: Annotated[float, doc("To the right, pixels of the photograph.")]
    down_px: Annotated[float, doc("Down, pixels of the photograph.")]
    standard_error_px: Annotated[
        float | None,
        doc("Standard error, from the scatter of the blocks; null: too few blocks show enough."),
    ]
    lens_px: Annotated[float, doc("Lens pitch, pixels of the photograph.")]
    block_px: Annotated[int, doc("Side of the blocks, pixels of the photograph.")]
    largest_block_px: Annotated[
        float, doc("Largest displacement of a block, pixels of the photograph.")
    ]


class ToneCurve(Part):
    """Response of a channel, black + gain * light ^ gamma."""

    black: Annotated[float, doc("Value of the photograph without light.")]
    gain: Annotated[float, doc("Factor of the light.")]
    gamma: Annotated[float, doc("Exponent of the light.")]


class MatchedStage(Part):
    """The simulation after one more cause of difference is added to it."""

    name: Annotated[str, doc("The cause added last.")]
    error_share: Annotated[
        float,
        doc("Remaining squared error of linear light, as a share of the first stage's."),
    ]
    scores: Annotated[
        Mapping[str, float | None],
        doc("Scores against the photograph, by metric and unit; null: infinite."),
    ]


class PhotoDocument(TitledDocument, tag="inim.photo/2"):
    """Photograph against simulation.

    `photo.json` of `inim photo`: differences between a photograph of a calibrated display and its
    simulation.
    """

    versions: Versions
    photograph: Annotated[str, doc("File of the photograph.")]
    eia: Annotated[str, doc("File of the EIA on the panel.")]
    position: Annotated[
        str,
        doc(
            "Position of the calibration, or folder of patterns that were photographed from the "
            "same place."
        ),
    ]
    display: DisplayRecord
    window_px: Annotated[
        tuple[int, int, int, int],
        doc("Left, top, right and bottom of the compared part, pixels of the photograph."),
    ]
    geometry: ImageShift
    blur_sigma_px: Annotated[
        float,
        doc(
            "Sigma of the Gaussian blur that makes the simulation as blurred as the photograph, "
            "pixels."
        ),
    ]
    tone: Annotated[
        dict[str, ToneCurve], doc("Response of panel and camera, by `red`, `green` and `blue`.")
    ]
    stages: Annotated[
        list[MatchedStage], doc("The simulation, with one more cause of difference in each stage.")
    ]
    files: Files
