"""Bench, run time against error: `bench.json`."""

from __future__ import annotations

from typing import Annotated, Any

from inim.documents.document import Part, doc
from inim.documents.parts import (
    BackendRecord,
    DisplayRecord,
    Files,
    PictureShape,
    SceneFileRecord,
    TitledDocument,
    Versions,
)

Scores = dict[str, float | None]


class TimingRecord(Part):
    """Times of one call."""

    cold_s: Annotated[float, doc("Seconds of the first call, with all compiling and loading.")]
    median_ms: Annotated[float, doc("Median of the warm runs, ms.")]
    min_ms: Annotated[float, doc("Fastest warm run, ms.")]
    spread: Annotated[
        float, doc("Half of the distance between the quartiles, as a share of the median.")
    ]
    runs: Annotated[int, doc("Warm runs that were timed.")]
    slow: Annotated[bool, doc("True if it had fewer runs than the others because it is slow.")]


class BenchAlgorithm(TimingRecord):
    """Times and errors of an algorithm."""

    name: Annotated[str, doc("The algorithm with its options.")]
    prepare_s: Annotated[float, doc("Seconds to prepare it, once per display and size of picture.")]
    mpx_per_s: Annotated[float, doc("Panel pixels, 10^6 per second, by the median.")]
    ratio: Annotated[
        float, doc("Median time in yardsticks: as a multiple of the reference kernel's median.")
    ]
    ratio_min: Annotated[float, doc("Fastest run as a multiple of the reference kernel's fastest.")]
    wrong_source: Annotated[
        float | None,
        doc(
            "Share of the lensed panel pixels that show a different picture pixel than the exact "
            "source, 0 to 1; null: the algorithm does not report its sources."
        ),
    ]
    hole_fraction: Annotated[
        float, doc("Share of the lensed panel pixels that show nothing, 0 to 1.")
    ]
    averaged_share: Annotated[
        float | None,
        doc(
            "Share of the panel pixels whose rays meet different objects, 0 to 1; null: one ray "
            "per pixel."
        ),
    ]
    scores: Annotated[
        Scores,
        doc(
            "Scores by the keys of `scene.scores`: eia_METRIC_UNIT of the EIA against the ground "
            "truth, view_METRIC_to_reference_UNIT of a view against the reference's, mean over the "
            "viewpoints; null: infinite."
        ),
    ]
    fronts: Annotated[
        list[str],
        doc(
            "Errors (`wrong_source` and keys of scores) by which no other algorithm is as fast and "
            "as good."
        ),
    ]
    pareto: Annotated[bool, doc("True if it is on any of these fronts.")]


class BenchScore(Part):
    """Description of a score."""

    key: Annotated[str, doc("Its key among the scores of algorithms and noise floor.")]
    label: Annotated[str, doc("Its name, with its unit.")]
    title: Annotated[str, doc("The heading of its plot.")]
    better: Annotated[str, doc("The better direction: `higher` or `lower`.")]
    best: Annotated[float | None, doc("The best possible value; null: infinite.")]
    digits: Annotated[int, doc("Digits that are shown after the decimal point.")]
    plotted: Annotated[bool, doc("True if it has its own plot.")]


class CapturedLayers(Part):
    """Result of the capture of layers."""

    covered_shares: Annotated[
        list[float],
        doc("Share of the picture that the solids of each number cover, 0 to 1, nearest first."),
    ]
    hidden_share: Annotated[
        float,
        doc(
            "Share of the surfaces behind the front that no ray reaches, and that were left out, "
            "0 to 1."
        ),
    ]


class BenchScene(SceneFileRecord):
    """A scene on which algorithms were timed, with their times and errors."""

    display: DisplayRecord
    viewpoints: Annotated[list[str], doc("Names of the eye positions.")]
    picture: Annotated[PictureShape, doc("The picture that the algorithms read.")]
    yardstick: Annotated[
        TimingRecord, doc("The reference kernel: one gather of 4 bytes per panel pixel.")
    ]
    algorithms: Annotated[list[BenchAlgorithm], doc("The algorithms that were timed, in order.")]
    noise_floor: Annotated[
        Scores,
        doc(
            "Scores of the ground truth against itself, one half of its samples against the other."
        ),
    ]
    scores: Annotated[list[BenchScore], doc("The scores, in the order of the tables.")]
    captured_layers: Annotated[
        CapturedLayers | None, doc("The captured layers; null: no algorithm reads layers.")
    ]


class BenchRounds(Part):
    """Number of rounds."""

    runs: Annotated[int, doc("Timed rounds.")]
    warmups: Annotated[int, doc("Untimed rounds before them.")]


class Load(Part):
    """Load of the machine."""

    start: Annotated[
        float | None,
        doc("Load average of the last minute before anything was loaded; null: unknown."),
    ]
    cores: Annotated[int | None, doc("Cores of the machine; null: unknown.")]
    end: Annotated[
        float | None,
        doc(
            "Load average of the last minute at the end, with the bench's own work; null: unknown."
        ),
    ]
    others: Annotated[
        float | None,
        doc("Share of the processors that other programs used during the rounds; null: unknown."),
    ] = None


class BenchDocument(TitledDocument, tag="inim.bench/2"):
    """Bench: run time against error.

    `bench.json` in the folder of `inim bench SCENE`, and of a study that is written with the same
    functions: time against error of every algorithm.
    """

    versions: Versions
    backend: BackendRecord
    threads: Annotated[int, doc("Number of threads of every timed call.")]
    threading_layer: Annotated[str, doc("Threading layer of numba; `default`: none was chosen.")]
    rounds: BenchRounds
    warnings: Annotated[list[str], doc("Reasons to doubt the times.")]
    load: Load
    notes: Annotated[list[str], doc("Omitted algorithms, with the reason.")]
    scene: Annotated[BenchScene | None, doc("Results on a scene; null in a study without a scene.")]
    study: Annotated[dict[str, Any], doc("Results of a study, under its own names.")] = {}
    files: Files
