"""Search: the best display with each lens sheet, by the closed forms of the inspection.

The gap is free: it sets the central depth plane. The depth range is free, too: it lies where
details are finest. Elemental images aim at the viewer, with a pitch P (V + g) / V, so that the
viewing zones of all lenses coincide.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from inim.choose.sheets import LensSheet
from inim.display import DISPLAYS, Display
from inim.display.pixels import MM_PER_INCH
from inim.documents.inspect import Suitability
from inim.errors import DisplayError, UsageError
from inim.inspection.findings import usable_model
from inim.inspection.geometry import COVER_GLASS
from inim.inspection.spots import spots
from inim.inspection.suitability import (
    EYES_APART_MM,
    detail_mm,
    spot_pixels,
    suitability,
    zone_border_mm,
)
from inim.lens import lens_model as find_lens_model

_PANEL = re.compile(r"(\d{2,5})\s*[x×]\s*(\d{2,5})\s*,\s*(\d+(?:\.\d+)?)\s*(in|cm|um|µm)")
_MM_PER_UNIT = {"in": MM_PER_INCH, "cm": 10.0, "um": 1e-3, "µm": 1e-3}
# Central depth planes to try, in multiples of the depth, and centres of the depth range.
_PLANES = tuple(np.geomspace(0.4, 8, 8))
_CENTRES = np.linspace(-1, 1, 41)
# Slant of cylinders: 1 in 6, which mixes the colours of stripes evenly.
_SLANT_DEG = math.degrees(math.atan(1 / 6))
_LENGTH_DIGITS = 4
_DEPTH_DECIMALS = 2


@dataclass(frozen=True)
class Need:
    """A panel and its use: viewing distance, depth of the picture, and movement of the head.

    * `pixel_mm`: panel pixel.
    * `move_mm`: movement of the head to either side.
    """

    columns: int
    rows: int
    pixel_mm: float
    distance_mm: float
    depth_mm: float
    move_mm: float


@dataclass(frozen=True)
class Candidate:
    """A display with a sheet, its figures, and its score if it was validated."""

    sheet: LensSheet
    display: Display
    suitability: Suitability
    score: float | None = None


def parse_panel(text: str) -> tuple[int, int, float]:
    """Columns, rows and pixel in mm of a panel: `2400x1080, 6.7 in`, or a preset's name.

    The length is the diagonal (in, cm), or the pixel (um).

    Raises `UsageError`: other text.
    """
    if text in DISPLAYS:
        display = DISPLAYS[text]
        rows, columns = display.eia_shape
        return columns, rows, display.pixel_pitch_mm
    match = _PANEL.fullmatch(text.strip())
    if match is None or not float(match[3]):
        raise UsageError(
            f"--panel {text}: write columns, rows and diagonal, such as '2400x1080, 6.7 in', or "
            "the pixel, '2400x1080, 63.6 um'"
        )
    columns, rows, length = int(match[1]), int(match[2]), float(match[3]) * _MM_PER_UNIT[match[4]]
    pixel = length if match[4] in ("um", "µm") else length / math.hypot(columns, rows)
    return columns, rows, float(f"{pixel:.{_LENGTH_DIGITS}g}")


def search(need: Need, sheets: Sequence[LensSheet]) -> list[Candidate]:
    """The best display with each sheet that meets the need, finest detail first."""
    candidates = [best for sheet in sheets if (best := _best(need, sheet)) is not None]
    return sorted(candidates, key=lambda c: c.suitability.detail_mm)


def front(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The candidates that no other one beats in detail, sharp depth, viewing zone and tolerance of
    the gap at once. Panel and array alone determine the other tolerances.
    """

    def figures(candidate: Candidate) -> np.ndarray:
        s = candidate.suitability
        return np.array([-s.detail_mm, s.sharp_depth_mm, s.zone_width_mm, s.accuracy["gap_mm"]])

    table = [figures(c) for c in candidates]
    return [
        c
        for c, own in zip(candidates, table, strict=True)
        if not any((other >= own).all() and (other > own).any() for other in table)
    ]


def _best(need: Need, sheet: LensSheet) -> Candidate | None:
    """The display with the finest detail; None if the sheet does not meet the need."""
    designs: list[tuple[float, Display]] = []
    model, blurred = "", None
    for gap in _gaps_mm(sheet, need):
        try:
            display = design(need, sheet, gap)
        except DisplayError:
            continue
        half_x, half_y = display.flip_limit_mm(need.distance_mm)
        if half_x < EYES_APART_MM / 2 + need.move_mm:
            continue
        if blurred is None:  # a lens's spot hardly depends on the gap
            model = find_lens_model(usable_model(None, display)[0]).name
            blurred = spot_pixels(spots(display, model, display.central_depth_mm), model)
        border = zone_border_mm(display, need.distance_mm, blurred)
        if half_x - border < EYES_APART_MM / 2 + need.move_mm or half_y < border:
            continue
        low, detail = _best_range(display, need.depth_mm, blurred)
        high = round(low + need.depth_mm, _DEPTH_DECIMALS)
        designs.append((detail, display.replace(depth_min_mm=low, depth_max_mm=high)))
    if not designs:
        return None
    display = min(designs, key=lambda ranked: ranked[0])[1]
    return Candidate(sheet, display, suitability(display, need.distance_mm, model))


def _gaps_mm(sheet: LensSheet, need: Need) -> list[float]:
    """Gaps to try, f D / (D - f), outside the panel's cover glass."""
    f = sheet.focal_length_mm
    planes = (sign * p * need.depth_mm for p in _PLANES for sign in (1, -1))
    gaps = {f, *(float(f"{f * d / (d - f):.{_LENGTH_DIGITS}g}") for d in planes if d > f or d < 0)}
    least = sum(thickness / index for thickness, index in COVER_GLASS)
    return sorted(gap for gap in gaps if gap >= least)


def design(need: Need, sheet: LensSheet, gap_mm: float) -> Display:
    """The display with a sheet at a gap, its depth range centred on the array.

    Raises `DisplayError`: it cannot be built.
    """
    image = round(sheet.pitch_mm * (1 + gap_mm / need.distance_mm), 6)
    down, across = (int(n * need.pixel_mm / image) for n in (need.rows, need.columns))
    is_lenticular = sheet.lattice == "lenticular"
    return Display(
        pitch_mm=sheet.pitch_mm,
        focal_length_mm=sheet.focal_length_mm,
        gap_mm=gap_mm,
        pixel_pitch_mm=need.pixel_mm,
        lens_columns=max(1, across),
        lens_rows=1 if is_lenticular else max(1, down),
        panel_columns=need.columns,
        panel_rows=need.rows,
        depth_min_mm=-need.depth_mm / 2,
        depth_max_mm=need.depth_mm / 2,
        elemental_pitch_mm=image,
        lattice=sheet.lattice,
        rotation_deg=_SLANT_DEG if is_lenticular else 0.0,
        subpixels="rgb-stripe" if is_lenticular else "none",
        name=sheet.name,
    )


def _best_range(display: Display, depth_mm: float, blurred: float) -> tuple[float, float]:
    """Far end of the best depth range, and the width of its finest detail at the worst depth."""
    plane = display.central_depth_mm
    about = 0.0 if math.isinf(plane) else plane / 2
    low = about + _CENTRES * max(abs(about), depth_mm / 2) - depth_mm / 2
    worst = detail_mm(display, np.stack([low, low + depth_mm]), blurred).max(axis=0)
    best = int(worst.argmin())
    return round(float(low[best]), _DEPTH_DECIMALS), float(worst[best])
