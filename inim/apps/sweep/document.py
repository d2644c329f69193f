"""Documents of a sweep: a unit's result, and the metadata of the table."""

from __future__ import annotations

from typing import Annotated, Any

from inim.scores.document_parts import (
    BackendRecord,
    Created,
    InimVersion,
    TitledDocument,
    Versions,
)
from inim.system.document import Document, Part, doc

Scores = dict[str, float | None]


class UnitView(Part):
    """Scores of one viewpoint."""

    viewpoint: str  #: Name of the eye position.
    x_mm: float  #: Position of the eye to the right, mm.
    y_mm: float  #: Position of the eye upwards, mm.
    z_mm: float  #: Distance of the eye from the lens array, mm.
    #: Scores by column of the sweep's table: of the view against the scene and the reference view,
    #: of the reference, and of the noise floor; null: infinite, or no pixel shows the relic.
    scores: Scores


class UnitDocument(Document, tag="inim.unit/2"):
    """Result of one algorithm in a sweep.

    `units/HASH/ALGORITHM.json` in the folder of `inim sweep`: the result of one validation of a
    study for one algorithm, and everything that decides it.
    """

    unit: Annotated[
        str,
        doc(
            "Hash of the key, the name of the folder.",
            pattern="^[0-9a-f]{16}$",
            examples=["0" * 16],
        ),
    ]
    algorithm: str  #: The algorithm with its options.
    #: Further inputs of this algorithm's result: `min_ssim_to_reference`, its criterion (null:
    #: none); the code of another package's algorithm as `entry_point`, `version` and `sha256`,
    #: where they exist.
    making: dict[str, str | float | None]
    #: Everything else that the scores depend on (scene, settings, display, viewpoints, backend,
    #: versions, code): equal keys are equal results.
    key: dict[str, Any]
    created: Created
    inim_version: InimVersion
    versions: Versions
    backend: BackendRecord
    #: Scores of the EIA and of its noise floor, and `hole_fraction`, by column of the sweep's
    #: table; null: infinite, or not known.
    scores: Scores
    #: Seconds to generate the EIA, once, without warm-up; null: not measured.
    seconds: float | None
    #: With `time = true`: time of the generator as a multiple of the reference kernel's, median;
    #: null: not timed.
    yardsticks: float | None
    unit_seconds: float  #: Seconds of the whole validation.
    render_seconds: float  #: Seconds of the validation inside the renderer.
    passed: bool  #: True if the validation's checks on ground truth and algorithm passed.
    failed_checks: str | None  #: Failed checks in words; null: none.
    views: list[UnitView]  #: Scores of each viewpoint.

    def __post_init__(self) -> None:
        if not self.views:
            raise ValueError("views: there is none")


class SweepTable(TitledDocument, tag="inim.sweep/1"):
    """Table of a sweep.

    Metadata of `sweep.parquet` in the folder of `inim sweep`, under these names after `inim:`.
    """
