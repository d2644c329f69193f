"""`compare.json`: comparison of two reports; `baseline.json`: statistics of a run."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from inim.documents.document import Document, Part, doc
from inim.documents.parts import Checks, Circumstances, Conditions, Files, Regression, Sha256


class Side(Part):
    """One of the two reports."""

    folder: Annotated[str, doc("Its folder, as given.")]
    circumstances: Circumstances


class CompareDocument(Document, tag="inim.compare/2"):
    """Comparison of two reports.

    `compare.json` in the folder of `inim compare OUT_A OUT_B`: the verdicts of a regression check
    between two reports.
    """

    title: Annotated[str, doc("Name of the scene.")]
    created: Annotated[str, doc("Time of creation of the later report: UTC, ISO 8601.")]
    before: Annotated[Side, doc("The report before, which serves as the baseline.")]
    after: Annotated[Side, doc("The report after.")]
    conditions: Conditions
    regression: Regression
    verdict: Checks
    files: Files = []


_Size = tuple[Annotated[int, Meta(ge=1)], Annotated[int, Meta(ge=1)]]


class PictureSize(Part):
    """Sizes of a picture whose statistics are in the `.npz`."""

    tile: Annotated[_Size, doc("Rows and columns of a tile, in pixels.")]
    shape: Annotated[_Size, doc("Rows and columns of the picture, in pixels.")]


class EstimateRecord(Part):
    """A score and its precision; null: unknown or not finite."""

    plain: Annotated[float | None, doc("The score of the noisy pictures.")]
    error: Annotated[float | None, doc("Its standard error.")]
    freedom: Annotated[float | None, doc("Degrees of freedom of the standard error.")]
    bias: Annotated[float | None, doc("Change of the score if the noise's variance doubled.")]


class FingerprintRecord(Part):
    """Digests of a generator's EIA of the reference input."""

    exact: Annotated[bool, doc("True if any difference fails.")]
    input_sha256: Annotated[Sha256, doc("SHA-256 of the reference input.")]
    eia_sha256: Annotated[Sha256, doc("SHA-256 of the EIA's values.")]


class BaselineDocument(Document, tag="inim.baseline/2"):
    """Statistics of a run.

    `baseline.json` in the folder of a baseline, and `regression/candidate.json` in that of a
    report: later runs are compared with it. The arrays are next to it, in the `.npz` of the same
    name.
    """

    reason: Annotated[str, doc("Reason for the baseline; empty in a candidate.")]
    accepted: Annotated[str, doc("Time of acceptance, UTC, ISO 8601; empty in a candidate.")]
    conditions: Conditions
    circumstances: Circumstances
    pictures: Annotated[
        dict[str, PictureSize],
        doc(
            "Rendered pictures and EIAs whose statistics the `.npz` has, by name: `truth/eia`, "
            "`truth/VIEWPOINT`, `eia/ALGORITHM`."
        ),
    ]
    scores: Annotated[
        dict[str, dict[str, EstimateRecord]],
        doc(
            "Scores with their noise, by scored object (`reference/VIEWPOINT`, "
            "`ALGORITHM/VIEWPOINT`) and name."
        ),
    ]
    fingerprints: Annotated[
        dict[str, FingerprintRecord],
        doc("By generator, under its name with options: its EIA of the reference input."),
    ]
    times: Annotated[
        dict[str, list[float]],
        doc(
            "With `--time`, by generator: natural logarithms of its time over the reference "
            "kernel's, one per round."
        ),
    ]
    reported: Annotated[
        dict[str, dict[str, float | None]],
        doc(
            "Every reported score, for its drift, by scored object (an algorithm's EIA, or one of "
            "its views as `ALGORITHM/VIEWPOINT`) and name, `eia NAME` for an EIA; null: none, or "
            "not finite."
        ),
    ]
    arrays_sha256: Annotated[Sha256, doc("SHA-256 of the `.npz`.")]

    def __post_init__(self) -> None:
        for name in self.pictures:  # pictures of changes are written under it
            if ".." in name.split("/") or name.startswith("/") or not name.isprintable():
                raise ValueError(f"picture {name[:40]!a} lies outside the report")
