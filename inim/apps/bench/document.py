"""Document of a bench: `bench.json`."""

from collections.abc import Sequence

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


class Estimate(Part):
    """A measured value with its 95 % interval."""

    value: float | None  #: Null: infinite, or no pixel shows the relic.
    interval: tuple[float | None, float | None]  #: Its ends; null: unknown or infinite.

    @classmethod
    def of(cls, value: float, interval: Sequence[float], unit: float = 1.0) -> "Estimate":
        """A value and its interval, times a unit."""
        low, high = interval
        return cls(value=unit * value, interval=(unit * low, unit * high))


class TimingRecord(Part):
    """Times of one call."""

    cold_s: float  #: Seconds of the first call, which counts for none.
    median_ms: float  #: Median of the warm runs, ms.
    min_ms: float  #: Fastest warm run, ms.
    spread: float  #: Half of the distance between the quartiles, as a share of the median.
    runs: int  #: Warm runs that were timed.
    slow: bool  #: True if it had fewer runs than the others because it is slow.
    times_ms: list[float]  #: The warm runs, ms, in the order of the rounds.


class BenchAlgorithm(TimingRecord):
    """Time, memory and errors of an algorithm."""

    name: str  #: The algorithm with its options.
    terms: str  #: Rays per panel pixel and their colour: `4 rays, smooth`.
    is_equal: bool  #: True if its terms are those of most algorithms.
    prepare_s: float  #: Seconds to prepare it, once per display and size of picture.
    time_ms: Estimate  #: Trimmed geometric mean of the warm runs, ms.
    kernel_times: Estimate  #: The same of its ratios to the reference kernel, round by round.
    #: Peak memory of a process that prepares it and generates one EIA, without that of its imports
    #: and kernels; null: unknown, except on Linux.
    memory_bytes: int | None
    hole_fraction: float | None  #: Share of the lensed pixels that show nothing; null: unknown.
    #: Scores of the EIA against the ground truth, with the noise of both; null: infinite.
    eia: dict[str, float | None]
    #: Errors by the keys of `errors`, the mean over the viewpoints. `wrong_source` is missing if
    #: it does not report its sources, or if no oracle has the exact ones.
    errors: dict[str, Estimate]
    #: Errors by which no other algorithm is significantly better in time or error and not
    #: significantly worse in the other.
    fronts: list[str]


class BenchError(Part):
    """Description of an error: wrong sources, or a score without noise."""

    key: str  #: Its key among the errors of algorithms.
    label: str  #: Its name, with its unit; wrong sources are shown in %.
    better: str  #: The better direction: `higher` or `lower`.
    digits: int  #: Digits that are shown after the decimal point.


class BenchScene(SceneFileRecord):
    """A scene at one size, with the times and errors of the algorithms."""

    name: str  #: The scene with its size.
    size: str  #: Settings of its size; may be empty.
    display: DisplayRecord
    viewpoints: list[str]  #: Names of the eye positions.
    picture: PictureShape  #: The picture that the algorithms read.
    samples: dict[str, int]  #: Samples per pixel that the errors needed, by setting.
    checked_pixels: int  #: Panel pixels whose exact sources are known.
    yardstick: TimingRecord  #: The reference kernel: one gather of 4 bytes per panel pixel.
    algorithms: list[BenchAlgorithm]  #: The algorithms that were timed, in order.
    others: float | None  #: Share of the processors that other programs used; null: unknown.
    warnings: list[str]  #: Reasons to doubt the times or the comparison.


class BenchDocument(TitledDocument, tag="inim.bench/3"):
    """Bench: run time against error.

    `bench.json` in the folder of `inim bench SCENE ...`. `bench.csv` has one line for each scene,
    size and algorithm.
    """

    versions: Versions
    backend: BackendRecord
    threads: int  #: Number of threads of every timed call.
    threading_layer: str  #: Threading layer of numba; `default`: none was chosen.
    runs: int  #: Timed rounds.
    warmups: int  #: Untimed rounds before them.
    cores: int | None  #: Cores of the machine; null: unknown.
    errors: list[BenchError]  #: The errors, in the order of the tables.
    scenes: list[BenchScene]  #: Results by scene and size.
    files: Files
