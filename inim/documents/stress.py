"""Stress run of algorithms: `stress.json`."""

from __future__ import annotations

from typing import Annotated, Literal

from inim.documents.document import Part, doc
from inim.documents.parts import BackendRecord, Files, TitledDocument, Versions

_ALGORITHM = "The algorithm with its options."
_MESSAGE = "Message of the refusal or crash; empty otherwise."


class FirstHitsResult(Part):
    """Comparison of an algorithm with the exact first hits of a case."""

    algorithm: Annotated[str, doc(_ALGORITHM)]
    family: Annotated[str, doc("Family of the case.")]
    case: Annotated[str, doc("Name of the case.")]
    exact: Annotated[
        bool,
        doc("True if the algorithm shows first hits by definition: no pixel may be wrong."),
    ]
    pixels: Annotated[int, doc("Panel pixels that were compared, drawn at random.")]
    wrong: Annotated[int, doc("Those of them that show another source than the exact one.")]
    warnings: Annotated[list[str], doc("Warnings of a validation of such a display.")]
    message: Annotated[str, doc(_MESSAGE)]
    outcome: Annotated[
        Literal["ran", "refused", "crashed", "no sources"],
        doc("End of the run; `no sources`: the algorithm does not report the sources of colours."),
    ]
    seconds: Annotated[float | None, doc("Seconds of the run, if it ran.")] = None
    passed: Annotated[
        bool, doc("True if no pixel is wrong that must not be, or a warning announces it.")
    ]


class RelationResult(Part):
    """Result of one relation for one algorithm."""

    relation: Annotated[str, doc("Name of the relation: what has to stay the same.")]
    algorithm: Annotated[str, doc(_ALGORITHM)]
    explained: Annotated[
        str, doc("Reason why the relation need not hold for the algorithm; empty: it must hold.")
    ]
    compared: Annotated[int, doc("Panel pixels that were compared.")]
    broken: Annotated[int, doc("Those of them that break the relation.")]
    uncertain: Annotated[int, doc("Broken pixels that rounding may decide.")]
    message: Annotated[str, doc(_MESSAGE)]
    worst_ulp: Annotated[
        float | None, doc("Largest difference of landing points, ulps; of lens models only.")
    ] = None
    passed: Annotated[bool, doc("True if the relation holds but for rounding, or need not hold.")]


class Jitter(Part):
    """Effect of one kind of depth error on one algorithm."""

    jitter: Annotated[
        str,
        doc(
            "The error: depth moved by an ulp of float32, rounded to a number of bits, or moved by "
            "one step of them."
        ),
    ]
    algorithm: Annotated[str, doc(_ALGORITHM)]
    changed: Annotated[float, doc("Share of the lensed panel pixels that change, 0 to 1.")]
    ssim_loss: Annotated[float, doc("1 less the SSIM of the EIA against that without the error.")]


class JitteredPicture(Part):
    """The picture whose depth was moved."""

    name: Annotated[str, doc("Its name, or the path of its scene.")]
    rows: Annotated[int, doc("Pixels down.")]
    columns: Annotated[int, doc("Pixels across.")]


class Claim(Part):
    """A claim that was tested in many cases."""

    name: Annotated[str, doc("The claim.")]
    cases: Annotated[int, doc("Tested cases.")]
    broken: Annotated[int, doc("Cases that break the claim.")]
    passed: Annotated[bool, doc("True if there are cases and none breaks the claim.")]


class StressRecord(TitledDocument):
    """Fields of every stress run, of algorithms or of the study of accuracy."""

    versions: Versions
    mode: Annotated[Literal["full", "quick"], doc("`quick`: fewer and smaller cases were run.")]
    backend: BackendRecord
    relations: Annotated[
        list[RelationResult], doc("Relations between results, for each relation and algorithm.")
    ]
    jitter: Annotated[
        list[Jitter], doc("Effects of small depth errors, for each kind and algorithm.")
    ]
    picture: JitteredPicture
    checks: Annotated[list[Claim], doc("The claims of the verdict.")]
    passed: Annotated[bool, doc("True if every check passed.")]
    seconds: Annotated[float, doc("Seconds of the whole run.")]
    files: Files


class StressDocument(StressRecord, tag="inim.stress/3"):
    """Stress run of algorithms.

    `stress.json` in the folder of `inim stress`: algorithms against exact first hits, against
    relations that must hold, and with small errors of the depth.
    """

    algorithms: Annotated[list[str], doc("The algorithms with their options.")]
    first_hits: Annotated[
        list[FirstHitsResult],
        doc("Comparisons with the exact first hits, for each algorithm and case."),
    ]
