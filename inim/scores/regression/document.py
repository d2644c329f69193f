"""`compare.json`: comparison of two reports; `baseline.json`: statistics of a run."""

from typing import Annotated

from msgspec import Meta

from inim.scores.document_parts import Checks, Circumstances, Files, Regression, RunInputs, Sha256
from inim.system.document import Document, Part


class Side(Part):
    """One of the two reports."""

    folder: str  #: Its folder, as given.
    circumstances: Circumstances


class CompareDocument(Document, tag="inim.compare/3"):
    """Comparison of two reports.

    `compare.json` in the folder of `inim compare OUT_A OUT_B`: the verdicts of a regression check
    between two reports.
    """

    title: str  #: Name of the scene.
    created: str  #: Time of creation of the later report: UTC, ISO 8601.
    before: Side  #: The report before, which serves as the baseline.
    after: Side  #: The report after.
    regression: Regression
    verdict: Checks
    files: Files = []


_Size = tuple[Annotated[int, Meta(ge=1)], Annotated[int, Meta(ge=1)]]


class PictureSize(Part):
    """Sizes of a picture whose statistics are in the `.npz`."""

    tile: _Size  #: Rows and columns of a tile, in pixels.
    shape: _Size  #: Rows and columns of the picture, in pixels.


class EstimateRecord(Part):
    """A score and its precision; null: unknown or not finite."""

    plain: float | None  #: The score of the noisy pictures; null with an error of 0: infinite.
    error: float | None  #: Its standard error.
    freedom: float | None  #: Degrees of freedom of the standard error.
    bias: float | None  #: Change of the score if the noise's variance doubled.


class FingerprintRecord(Part):
    """Digests of a generator's EIA of the reference input."""

    exact: bool  #: True if any difference fails.
    input_sha256: Sha256  #: SHA-256 of the reference input.
    eia_sha256: Sha256  #: SHA-256 of the EIA's values.


class BaselineDocument(Document, tag="inim.baseline/4"):
    """Statistics of a run.

    `baseline.json` in the folder of a baseline, and `regression/candidate.json` in that of a
    report: later runs are compared with it. The arrays are next to it, in the `.npz` of the same
    name.
    """

    reason: str  #: Reason for the baseline; empty in a candidate.
    accepted: str  #: Time of acceptance, UTC, ISO 8601; empty in a candidate.
    inputs: RunInputs
    circumstances: Circumstances
    #: Rendered pictures and EIAs whose statistics the `.npz` has, by name: `truth/eia`,
    #: `truth/VIEWPOINT`, `eia/ALGORITHM`.
    pictures: dict[str, PictureSize]
    #: Scores with their noise, by scored object (`reference/VIEWPOINT`, `ALGORITHM/VIEWPOINT`) and
    #: name.
    scores: dict[str, dict[str, EstimateRecord]]
    #: By generator, under its name with options: its EIA of the reference input.
    fingerprints: dict[str, FingerprintRecord]
    arrays_sha256: Sha256  #: SHA-256 of the `.npz`.

    def __post_init__(self) -> None:
        for name in self.pictures:  # pictures of changes are written under it
            if ".." in name.split("/") or name.startswith("/") or not name.isprintable():
                raise ValueError(f"picture {name[:40]!a} lies outside the report")
