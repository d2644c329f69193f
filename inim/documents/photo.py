"""Comparison of a photograph with its simulation: `photo.json`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from inim.documents.document import Part, doc
from inim.documents.parts import DisplayRecord, Files, Versions
from inim.documents.record import Record


class Shift(Part):
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
        doc("Squared error of linear light that is left, as a share of the first stage's."),
    ]
    scores: Annotated[
        Mapping[str, float | None],
        doc("Scores against the photograph, by metric and unit; null: infinite."),
    ]


class PhotoDocument(Record, tag="inim.photo/2"):
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
    geometry: Shift
    blur_sigma_px: Annotated[
        float,
        doc(
            "Sigma of the Gaussian that makes the simulation as unsharp as the photograph, pixels."
        ),
    ]
    tone: Annotated[
        dict[str, ToneCurve], doc("Response of panel and camera, by `red`, `green` and `blue`.")
    ]
    stages: Annotated[
        list[MatchedStage], doc("The simulation, with one more cause of difference in each stage.")
    ]
    files: Files
