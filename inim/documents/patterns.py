"""Patterns for a calibration: `patterns.json`."""

from __future__ import annotations

from typing import Annotated

from inim.documents.document import Document, doc


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
