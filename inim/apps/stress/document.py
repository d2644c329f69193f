"""Document of a stress run: `stress.json`."""

from typing import Literal

from inim.scores.document_parts import (
    BackendRecord,
    Files,
    TitledDocument,
    Versions,
)
from inim.system.document import Part


class GrowthPoint(Part):
    """Largest deviation at one value of a parameter."""

    position: float  #: Value of the parameter, `axis` of the relation.
    worst: float | None  #: Largest deviation in the relation's unit; null: infinite.
    warned: bool  #: True if a validation of such a display warns: the limit does not apply.


class RelationResult(Part):
    """Result of one relation, for the chain itself or for one algorithm or lens model."""

    relation: str  #: Name of the relation.
    topic: str  #: Part of the chain.
    subject: str  #: Algorithm or lens model with its options; empty for the chain itself.
    claim: str  #: The claim in words.
    limit: float  #: Largest deviation with which the relation holds.
    unit: str  #: Unit of deviations.
    source: str  #: Where the limit comes from.
    #: Reason why the relation need not hold for the subject; empty: it must hold.
    explained: str
    cases: int  #: Number of cases.
    compared: int  #: Numbers, rays or pixels that were compared.
    broken: int  #: Those of them that differ, also where rounding decides.
    largest_share: float  #: Largest share of a case that differs, with or without a warning.
    worst: float | None  #: Largest deviation without a warning; null: infinite, or no case.
    worst_case: str  #: Case of the largest deviation.
    #: Distance of the farthest wrong source from the correct one, in picture pixels.
    farthest: float
    axis: str  #: Parameter of `growth`; empty without one.
    growth: list[GrowthPoint]  #: Deviations along the parameter.
    message: str  #: Message of the refusal or crash; empty otherwise.
    seconds: float  #: Time of all cases.
    #: True if all deviations are within the limit, or need not be.
    passed: bool

    @property
    def share(self) -> float:
        """Share of what was compared that differs."""
        return self.broken / self.compared if self.compared else 0.0


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


class StressDocument(TitledDocument, tag="inim.stress/4"):
    """Stress run of the whole chain.

    `stress.json` in the folder of `inim stress`: relations of displays, rays, algorithms, lens
    models, colours, views and scores, with their tolerances; and the effect of small depth errors.
    """

    versions: Versions
    mode: Literal["full", "quick"]  #: `quick`: fewer and smaller cases were run.
    backend: BackendRecord
    algorithms: list[str]  #: The algorithms with their options.
    lens_models: list[str]  #: The lens models.
    relations: list[RelationResult]  #: Results, for each relation and subject.
    jitter: list[Jitter]  #: Effects of small depth errors, for each kind and algorithm.
    picture: JitteredPicture | None  #: The picture of `jitter`; null without one.
    passed: bool  #: True if every relation passed.
    seconds: float  #: Seconds of the whole run.
    files: Files
