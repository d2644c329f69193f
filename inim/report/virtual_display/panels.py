"""Which EIAs are put into a page, and how: whole and exact while there is room."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from inim.files.image import encoded

__all__ = ["EmbeddedPanel", "Panel", "embed_panels"]

# Tried in turn until the two panels that matter most fit. An EIA cannot be scaled down: its
# pixels are directions.
_FORMS = (("PNG", 0), ("JPEG", 95), ("JPEG", 85))


@dataclass(frozen=True)
class Panel:
    """An EIA to show.

    Attributes
    ----------
    name : str
    codes : (rows, columns, 3) uint8
        sRGB, row 0 on top.
    """

    name: str
    codes: np.ndarray


@dataclass(frozen=True)
class EmbeddedPanel:
    """A panel as a data URI; `is_exact` where no pixel differs from the EIA's."""

    name: str
    source: str
    is_exact: bool


def embed_panels(panels: Sequence[Panel], most_bytes: int) -> tuple[list[EmbeddedPanel], list[str]]:
    """As many panels as fit, and the names of those left out.

    Parameters
    ----------
    panels : sequence of Panel
        The most important first. The first two go in before anything else, compressed with loss
        if they have to be.
    most_bytes : int
        For all data URIs together.
    """
    for form, quality in _FORMS:
        first = [_embed(panel, form, quality) for panel in panels[:2]]
        if sum(len(one.source) for one in first) <= most_bytes:
            return _fill_up(panels, first, form, quality, most_bytes)
    return [], [panel.name for panel in panels]


def _fill_up(
    panels: Sequence[Panel],
    embedded: list[EmbeddedPanel],
    form: str,
    quality: int,
    most_bytes: int,
) -> tuple[list[EmbeddedPanel], list[str]]:
    left_out = []
    room = most_bytes - sum(len(one.source) for one in embedded)
    for panel in panels[2:]:
        one = _embed(panel, form, quality)
        if len(one.source) <= room:
            embedded.append(one)
            room -= len(one.source)
        else:
            left_out.append(panel.name)
    return embedded, left_out


def _embed(panel: Panel, form: str, quality: int) -> EmbeddedPanel:
    exact = form == "PNG"
    options = {"compress_level": 9} if exact else {"quality": quality, "subsampling": 0}
    coded = base64.b64encode(encoded(panel.codes, form, **options)).decode("ascii")
    return EmbeddedPanel(panel.name, f"data:image/{form.lower()};base64,{coded}", exact)
