"""Choice of a lens sheet: the output of `inim choose --json`."""

from __future__ import annotations

from inim.display import Display
from inim.documents.document import Document, Part
from inim.documents.inspect import Suitability
from inim.documents.parts import InimVersion


class CandidateRecord(Part):
    """The best display with a lens sheet."""

    sheet: str  #: Name of the lens sheet.
    source: str | None  #: Source of its lengths; null: a sheet of any size, or of a user's table.
    display: Display
    suitability: Suitability
    #: Mean SSIM on the relic, against the scene, of the views of two eyes in a quick validation;
    #: null: not validated.
    score: float | None


class ChooseDocument(Document, tag="inim.choose/1"):
    """Choice of a lens sheet for a panel.

    `inim choose --panel PANEL --json`: displays that no other one beats in detail, sharp
    depth, viewing zone and tolerance of the gap at once; the first one is recommended.
    """

    inim_version: InimVersion
    panel_columns: int  #: Panel pixels across.
    panel_rows: int  #: Panel pixels down.
    pixel_pitch_mm: float  #: Panel pixel, mm.
    distance_mm: float  #: Viewing distance, mm.
    depth_mm: float  #: Depth of the picture, mm.
    move_mm: float  #: Movement of the head to either side, mm.
    scene: str | None  #: Scene of the relic of the validations; null: none.
    candidates: list[CandidateRecord]  #: Displays, the recommended one first.
    reason: str  #: Reason for the recommendation.
