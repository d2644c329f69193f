"""Documents about algorithms: `bench.json`, `stress.json`, and the results of a sweep."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from inim.documents.document import Document, Part, doc
from inim.documents.parts import (
    BackendRecord,
    Created,
    DisplayRecord,
    Files,
    InimVersion,
    PictureShape,
    SceneFileRecord,
    TitledDocument,
    Versions,
)

Scores = dict[str, float | None]


class TimingRecord(Part):
    """Times of one call."""

    cold_s: float  #: Seconds of the first call, with all compiling and loading.
    median_ms: float  #: Median of the warm runs, ms.
    min_ms: float  #: Fastest warm run, ms.
    spread: float  #: Half of the distance between the quartiles, as a share of the median.
    runs: int  #: Warm runs that were timed.
    slow: bool  #: True if it had fewer runs than the others because it is slow.


class BenchAlgorithm(TimingRecord):
    """Times and errors of an algorithm."""

    name: str  #: The algorithm with its options.
    prepare_s: float  #: Seconds to prepare it, once per display and size of picture.
    mpx_per_s: float  #: Panel pixels, 10^6 per second, by the median.
    ratio: float  #: Median time in yardsticks: as a multiple of the reference kernel's median.
    ratio_min: float  #: Fastest run as a multiple of the reference kernel's fastest.
    #: Share of the lensed panel pixels that show a different picture pixel than the exact source, 0
    #: to 1; null: the algorithm does not report its sources.
    wrong_source: float | None
    hole_fraction: float  #: Share of the lensed panel pixels that show nothing, 0 to 1.
    #: Share of the panel pixels whose rays meet different objects, 0 to 1; null: one ray per pixel.
    averaged_share: float | None
    #: Scores by the keys of `scene.scores`: eia_METRIC_UNIT of the EIA against the ground truth,
    #: view_METRIC_to_reference_UNIT of a view against the reference's, mean over the viewpoints;
    #: null: infinite.
    scores: Scores
    #: Errors (`wrong_source` and keys of scores) by which no other algorithm is as fast and as
    #: good.
    fronts: list[str]
    pareto: bool  #: True if it is on any of these fronts.


class BenchScore(Part):
    """Description of a score."""

    key: str  #: Its key among the scores of algorithms and noise floor.
    label: str  #: Its name, with its unit.
    title: str  #: The heading of its plot.
    better: str  #: The better direction: `higher` or `lower`.
    best: float | None  #: The best possible value; null: infinite.
    digits: int  #: Digits that are shown after the decimal point.
    plotted: bool  #: True if it has its own plot.


class CapturedLayers(Part):
    """Result of the capture of layers."""

    #: Share of the picture that the solids of each number cover, 0 to 1, nearest first.
    covered_shares: list[float]
    #: Share of the surfaces behind the front that no ray reaches, and that were left out, 0 to 1.
    hidden_share: float


class BenchScene(SceneFileRecord):
    """A scene on which algorithms were timed, with their times and errors."""

    display: DisplayRecord
    viewpoints: list[str]  #: Names of the eye positions.
    picture: PictureShape  #: The picture that the algorithms read.
    yardstick: TimingRecord  #: The reference kernel: one gather of 4 bytes per panel pixel.
    algorithms: list[BenchAlgorithm]  #: The algorithms that were timed, in order.
    #: Scores of the ground truth against itself, one half of its samples against the other.
    noise_floor: Scores
    scores: list[BenchScore]  #: The scores, in the order of the tables.
    captured_layers: CapturedLayers | None  #: The captured layers; null: no algorithm reads layers.


class BenchRounds(Part):
    """Number of rounds."""

    runs: int  #: Timed rounds.
    warmups: int  #: Untimed rounds before them.


class Load(Part):
    """Load of the machine."""

    #: Load average of the last minute before anything was loaded; null: unknown.
    start: float | None
    cores: int | None  #: Cores of the machine; null: unknown.
    #: Load average of the last minute at the end, with the bench's own work; null: unknown.
    end: float | None
    #: Share of the processors that other programs used during the rounds; null: unknown.
    others: float | None = None


class BenchDocument(TitledDocument, tag="inim.bench/2"):
    """Bench: run time against error.

    `bench.json` in the folder of `inim bench SCENE`, and of a study that is written with the same
    functions: time against error of every algorithm.
    """

    versions: Versions
    backend: BackendRecord
    threads: int  #: Number of threads of every timed call.
    threading_layer: str  #: Threading layer of numba; `default`: none was chosen.
    rounds: BenchRounds
    warnings: list[str]  #: Reasons to doubt the times.
    load: Load
    notes: list[str]  #: Omitted algorithms, with the reason.
    scene: BenchScene | None  #: Results on a scene; null in a study without a scene.
    study: dict[str, Any] = {}  #: Results of a study, under its own names.
    files: Files


# -- stress runs ---


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


class StressRecord(TitledDocument):
    """Fields of every stress run, of algorithms or of the study of accuracy."""

    versions: Versions
    mode: Literal["full", "quick"]  #: `quick`: fewer and smaller cases were run.
    backend: BackendRecord
    relations: list[RelationResult]  #: Relations between results, for each relation and algorithm.
    jitter: list[Jitter]  #: Effects of small depth errors, for each kind and algorithm.
    picture: JitteredPicture
    checks: list[Claim]  #: The claims of the verdict.
    passed: bool  #: True if every check passed.
    seconds: float  #: Seconds of the whole run.
    files: Files


class StressDocument(StressRecord, tag="inim.stress/3"):
    """Stress run of algorithms.

    `stress.json` in the folder of `inim stress`: algorithms against exact first hits, against
    relations that must hold, and with small errors of the depth.
    """

    algorithms: list[str]  #: The algorithms with their options.
    #: Comparisons with the exact first hits, for each algorithm and case.
    first_hits: list[FirstHitsResult]


# -- sweeps ---


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
