"""Document of a bench: `bench.json`."""

from typing import Any

from inim.scores.document_parts import (
    BackendRecord,
    DisplayRecord,
    Files,
    PictureShape,
    SceneFileRecord,
    TitledDocument,
    Versions,
)
from inim.system.document import Part

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

    def result(self, key: str) -> float | None:
        """Its score by the key, or its `wrong_source`; None if not measured or infinite."""
        return self.wrong_source if key == "wrong_source" else self.scores.get(key)


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
