"""Document of a stress run: `stress.json`."""

from typing import Literal

from inim.scores.document_parts import (
    BackendRecord,
    Files,
    TitledDocument,
    Versions,
)
from inim.system.document import Part


class FirstHitsResult(Part):
    """Comparison of an algorithm with the exact first hits of a case."""

    algorithm: str  #: The algorithm with its options.
    family: str  #: Family of the case.
    case: str  #: Name of the case.
    exact: bool  #: True if the algorithm shows first hits by definition: no pixel may be wrong.
    pixels: int  #: Panel pixels that were compared, drawn at random.
    wrong: int  #: Those of them that show another source than the exact one.
    warnings: list[str]  #: Warnings of a validation of such a display.
    message: str  #: Message of the refusal or crash; empty otherwise.
    #: End of the run; `no sources`: the algorithm does not report the sources of colours.
    outcome: Literal["ran", "refused", "crashed", "no sources"]
    seconds: float | None = None  #: Seconds of the run, if it ran.
    passed: bool  #: True if no pixel is wrong that must not be, or a warning announces it.


class RelationResult(Part):
    """Result of one relation for one algorithm."""

    relation: str  #: Name of the relation: what has to stay the same.
    algorithm: str  #: The algorithm with its options.
    explained: str  #: Reason why the relation need not hold for the algorithm; empty: it must hold.
    compared: int  #: Panel pixels that were compared.
    broken: int  #: Those of them that break the relation.
    uncertain: int  #: Broken pixels that rounding may decide.
    message: str  #: Message of the refusal or crash; empty otherwise.
    #: Largest difference of landing points, ulps; of lens models only.
    worst_ulp: float | None = None
    passed: bool  #: True if the relation holds but for rounding, or need not hold.


class Jitter(Part):
    """Effect of one kind of depth error on one algorithm."""

    #: The error: depth moved by an ulp of float32, rounded to a number of bits, or moved by one
    #: step of them.
    jitter: str
    algorithm: str  #: The algorithm with its options.
    changed: float  #: Share of the lensed panel pixels that change, 0 to 1.
    ssim_loss: float  #: 1 less the SSIM of the EIA against that without the error.


class JitteredPicture(Part):
    """The picture whose depth was moved."""

    name: str  #: Its name, or the path of its scene.
    rows: int  #: Pixels down.
    columns: int  #: Pixels across.


class Claim(Part):
    """A claim that was tested in many cases."""

    name: str  #: The claim.
    cases: int  #: Tested cases.
    broken: int  #: Cases that break the claim.
    passed: bool  #: True if there are cases and none breaks the claim.


class StressDocument(TitledDocument, tag="inim.stress/3"):
    """Stress run of algorithms.

    `stress.json` in the folder of `inim stress`: algorithms against exact first hits, against
    relations that must hold, and with small errors of the depth.
    """

    versions: Versions
    mode: Literal["full", "quick"]  #: `quick`: fewer and smaller cases were run.
    backend: BackendRecord
    algorithms: list[str]  #: The algorithms with their options.
    #: Comparisons with the exact first hits, for each algorithm and case.
    first_hits: list[FirstHitsResult]
    relations: list[RelationResult]  #: Relations between results, for each relation and algorithm.
    jitter: list[Jitter]  #: Effects of small depth errors, for each kind and algorithm.
    picture: JitteredPicture
    checks: list[Claim]  #: The claims of the verdict.
    passed: bool  #: True if every check passed.
    seconds: float  #: Seconds of the whole run.
    files: Files
