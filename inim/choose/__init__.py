"""Choice of a lens sheet for a panel: sheets, the designs of displays with them, and their order.

`sheets` reads tables of lens sheets, `search` finds the best display of each sheet by the closed
forms of `inim.inspection`, and this module validates the best ones with a relic.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from inim.choose.search import Candidate, Need, front, search
from inim.choose.sheets import LensSheet
from inim.display.viewpoint import Viewpoint
from inim.documents.choose import CandidateRecord, ChooseDocument
from inim.errors import DisplayError
from inim.inspection.suitability import EYES_APART_MM
from inim.pipeline.launch import validate
from inim.version import __version__

#: Candidates that a relic is shown on.
VALIDATED = 3
#: Side of a view's pixels in a validation: at most a minute of arc at half a metre.
VIEW_PIXEL_MM = 0.15


def choose(
    need: Need,
    sheets: Sequence[LensSheet],
    scene: Path | None = None,
    *,
    validated: int = VALIDATED,
    on_validation: Callable[[str], object] = lambda _: None,
) -> tuple[ChooseDocument, tuple[Candidate, ...]]:
    """Design a display with each sheet; the candidates on the Pareto front, best first.

    Sheets with a source follow, even if their displays are beaten: these exist.

    * `scene`: Mitsuba scene or mesh of a relic, to validate the first `validated` candidates with.

    Raises `DisplayError`: no sheet gives a display that meets the need.
    """
    designs = search(need, sheets)
    candidates = front(designs)
    candidates += [c for c in designs if c.sheet.source and c not in candidates]
    if not candidates:
        raise DisplayError(
            f"no lens sheet gives two eyes at {need.distance_mm:g} mm a picture {need.depth_mm:g} "
            f"mm deep and ±{need.move_mm:g} mm for the head; lower --move, or name other sheets"
        )
    if scene is not None:
        best = []
        for candidate in candidates[:validated]:
            on_validation(candidate.display.name)
            best.append(replace(candidate, score=score(candidate, need, scene)))
        best.sort(key=lambda c: -(c.score or 0.0))
        candidates = [*best, *candidates[validated:]]
    document = ChooseDocument(
        inim_version=__version__,
        panel_columns=need.columns,
        panel_rows=need.rows,
        pixel_pitch_mm=need.pixel_mm,
        distance_mm=need.distance_mm,
        depth_mm=need.depth_mm,
        move_mm=need.move_mm,
        scene=None if scene is None else str(scene),
        candidates=[
            CandidateRecord(
                sheet=c.sheet.name,
                source=c.sheet.source or None,
                display=c.display,
                suitability=c.suitability,
                score=c.score,
            )
            for c in candidates
        ],
        reason=_reason(candidates, scene is not None),
    )
    return document, tuple(candidates)


def score(candidate: Candidate, need: Need, scene: Path) -> float:
    """Mean SSIM on the relic, against the scene, of the views of two eyes: a quick validation."""
    display = candidate.display
    half = EYES_APART_MM / 2
    eyes = [
        Viewpoint(name, side * half, 0.0, need.distance_mm)
        for name, side in (("left-eye", -1), ("right-eye", 1))
    ]
    with tempfile.TemporaryDirectory(prefix="inim-choose-", ignore_cleanup_errors=True) as folder:
        report = validate(
            scene,
            Path(folder, "report"),
            display=display,
            preview=True,
            viewpoints=eyes,
            definitions={"inim.view_pixels_per_lens": -int(-display.pitch_mm // VIEW_PIXEL_MM)},
        )
    (algorithm,) = report.data.algorithms.values()
    return sum(float(view["ssim_on_relic"] or 0.0) for view in algorithm.views.values()) / len(eyes)


def _reason(candidates: Sequence[Candidate], is_validated: bool) -> str:
    best = candidates[0]
    figures = best.suitability
    first = "highest score of the validated displays" if is_validated else "finest detail"
    return (
        f"{first}, {figures.detail_mm:.2g} mm over {figures.depth_mm:.3g} mm of depth; the head "
        f"may move by ±{figures.head_movement_mm or 0:.0f} mm"
    )
