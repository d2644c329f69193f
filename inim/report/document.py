"""`report.json`: validation of a scene."""

import math
from typing import Annotated

from inim.display.misalignment import misaligned
from inim.display.settings import Settings
from inim.scores.document_parts import (
    EIA_SCORES,
    VIEW_SCORES,
    EiaScore,
    EiaScores,
    PictureShape,
    Precision,
    Regression,
    RunReport,
    Scores,
    Sha256,
    check_names,
    check_scores,
    scores,
)
from inim.scores.metrics import HEADLINE, best_algorithm, passing_limit
from inim.system.document import Part, doc
from inim.system.errors import InimError

_Row = tuple[float, float, float, float]

#: Names and descriptions of the scores of an algorithm's view that every run has.
ALGORITHM_VIEW_SCORES = VIEW_SCORES | {
    "ssim_to_reference": "SSIM against the reference view: the loss of the algorithm.",
    "psnr_to_reference_db": "PSNR against the reference view, dB; null: infinite.",
    "flip_to_reference": "FLIP against the reference view.",
    "ssim_on_relic_to_reference": (
        "SSIM against the reference view on the relic alone: the headline; null: no pixel shows "
        "the relic."
    ),
    "psnr_on_relic_to_reference_db": (
        "PSNR against the reference view on the relic alone, dB; null: infinite, or no pixel shows "
        "the relic."
    ),
    "flip_on_relic_to_reference": (
        "FLIP against the reference view on the relic alone; null: no pixel shows the relic."
    ),
}
# Times that every run has.
_TIMES = {
    "start": "Seconds until the stages began.",
    "mitsuba_render": "Seconds inside the renderer, all stages together.",
    "total": "Seconds of the whole run.",
}
_ALGORITHM_EIA_SCORES = EIA_SCORES | {
    "hole_fraction": "Share of the lensed panel pixels that show nothing, 0 to 1; null: unknown."
}


class Preview(Part):
    """A preview takes few samples: its scores are rough."""

    full_command: str  #: Command line for the full report.


class Translucency(Part):
    """Translucency of a relic of 3D Gaussian splats, by the rays of the RGB-D picture."""

    count: int  #: Number of splats.
    #: Share of the RGB-D picture's pixels whose ray loses at least a hundredth of its light, 0 to
    #: 1: the shares below are of these pixels.
    touched_fraction: float
    #: Mean share of the lost light, 0 to 1; null: splats touch no pixel.
    mean_coverage: float | None
    #: Shares of the pixels that lose 0 to 10 %, 10 to 20 %, ... of the light: 10 numbers.
    coverage_histogram: list[float]
    #: Share of the pixels that never lose half of the light: they have no depth.
    without_depth_fraction: float
    never_opaque_fraction: float  #: Share of the pixels that never lose nine tenths of the light.
    #: Median depth from the first tenth of the light lost to the last, mm; null: no pixel loses
    #: nine tenths.
    depth_spread_mm: float | None
    depth_spread_p95_mm: float | None  #: The same, of the pixel at 95 %, mm.
    #: Share of the pixels in which the renderer counts a splat twice.
    counted_twice_fraction: float


class SceneFit(Part):
    """Fit of the scene into the display."""

    scale_xy: float  #: Display millimetres per world unit, across and down.
    scale_z: float  #: Display millimetres per world unit, in depth.
    #: Matrix from world to display coordinates, rows of a 4 x 4.
    display_from_world: tuple[_Row, _Row, _Row, _Row]
    depth_mm: float | None = None  #: Depth of the relic on the display, mm; null: not recorded.

    @property
    def depth_share(self) -> float:
        """Depth of the relic on the display, as a share of its own depth at the same width."""
        return self.scale_z / self.scale_xy


class SceneRecord(Part):
    """The scene."""

    path: str  #: Path of the scene's XML, as given.
    sha256: Sha256  #: SHA-256 over the XML and all files it names.
    #: Settings and scene parameters of the command line (`-D`), by name.
    definitions: dict[str, str]
    allow_folders: list[str]  #: Further folders from which the scene may load files.
    shapes: int  #: Number of shapes of the relic.
    #: Names of the shapes that are no lights and do not belong to the relic.
    left_out: list[str] = []
    #: Lines on the files of its shapes, as they were read.
    imports: list[str] = []
    #: Sentences on shapes that are not shown as one might expect.
    warnings: list[str] = []
    splats: Translucency | None = None
    fit: SceneFit


class PictureRecord(Part):
    """An RGB-D picture without a scene."""

    path: str  #: Path of the file, as given.
    sha256: Sha256  #: SHA-256 over colours, depths and coverage of all layers.
    definitions: dict[str, str]  #: Settings of the command line (`-D`), by name.
    layers: int  #: Number of layers; 1: the front surface alone.


class CapturedPicture(PictureShape):
    """The RGB-D picture, the input of the algorithms."""

    covered_fraction: float  #: Share of the pixels that show something, 0 to 1.
    depth_min_mm: float | None  #: Farthest depth, z in mm; null: the picture shows nothing.
    depth_max_mm: float | None  #: Nearest depth, z in mm; null: the picture shows nothing.


class NoiseFloor(Part):
    """The ground truth against itself, one half of its samples against the other.

    Smaller differences are noise.
    """

    eia: EiaScores  #: Scores of the ground-truth EIA.
    views: dict[str, Scores]  #: Scores of the ground-truth views, by viewpoint.


class MetricSettings(Part):
    """Settings of a metric."""

    border_px: int  #: Ignored pixels along each side of a picture.
    #: For SSIM the arguments of scikit-image's structural_similarity, for FLIP the pixels per
    #: degree.
    arguments: dict[str, float | str | bool]


class Scoring(Part):
    """All that decides scores, to compute them again from the EXR pictures."""

    headline: str  #: Name of the score that ranks algorithms.
    #: Margin of the relic's region, in pixels along each axis, around its pixels in the
    #: ground-truth view: `truth/relic`.
    relic_margin_px: int
    metrics: dict[str, MetricSettings]  #: Settings of each metric, by its name.


class ReferenceViews(Part):
    """Views of the ground-truth EIA through the same lenses.

    A warning lists algorithms that score higher by more than noise.
    """

    views: dict[str, Scores]  #: Scores against the scene, by viewpoint.
    precision: Precision


class AlgorithmResult(Part):
    """Results of an algorithm or a finished EIA."""

    eia: Annotated[
        dict[str, EiaScore],
        scores(
            "Scores of the EIA against the ground truth, before any optics; null with `--lazy`.",
            _ALGORITHM_EIA_SCORES,
        ),
    ]
    #: Scores of its views, by viewpoint.
    views: dict[
        str,
        Annotated[
            dict[
                str,
                Annotated[
                    float | None,
                    doc(
                        "The same of another package's metric: NAME_UNIT against the scene, "
                        "NAME_to_reference_UNIT against the reference view, NAME_on_relic_UNIT "
                        "and NAME_on_relic_to_reference_UNIT on the relic; null: infinite."
                    ),
                ],
            ],
            scores("Scores of a view without noise.", ALGORITHM_VIEW_SCORES),
        ],
    ]
    precision: Precision
    #: Seconds to generate the EIA, once, prepared and compiled; null: an EIA file.
    seconds: float | None
    #: With `--time`: a generator's time as a multiple of the reference kernel's, median.
    yardsticks: float | None = None
    #: Of a picture without a scene: share of up to 2,000 panel pixels, drawn at random, that show
    #: another pixel of the picture than the exact one, 0 to 1; null: unknown.
    wrong_source: float | None = None
    #: Share of the panel pixels with light in the ground-truth EIA that this EIA leaves black, 0 to
    #: 1; null: not computed, as with `--lazy`.
    unlit_fraction: float | None = None
    terms: str = ""  #: Rays per panel pixel and their colour, in words; empty: no generator.


class ScoreDifference(Part):
    """Difference of the headline scores of two algorithms in a view."""

    algorithm: str  #: Name of the best algorithm.
    other: str  #: Name of the other algorithm.
    viewpoint: str  #: Name of the viewpoint.
    value: float | None  #: Score of the algorithm minus that of the other.
    #: 95 % interval. Noise that both share cancels; null: unknown.
    interval: tuple[float | None, float | None]


class SkippedStep(Part):
    """A step of the run, in words."""

    step: str  #: The step.
    performed: str  #: The performed part.
    skipped: str  #: The skipped part.
    why: str  #: Reason why skipping is safe.


class ReportDocument(RunReport, tag="inim.report/2"):
    """Report of a validation.

    `report.json` in the folder of `inim validate`: the results of a validation as data.

    Of a picture without a scene, the place of the ground-truth views is taken by the picture,
    warped to the viewpoint; that of the ground-truth EIA by the EIA of its exact first hits; and
    that of the relic by the area that the warped picture covers.
    """

    preview: Preview | None = None
    scene: SceneRecord | None = None  #: Absent for a picture without a scene.
    picture: PictureRecord | None = None  #: Only of a picture without a scene.
    #: Every effective `inim.*` setting, by its name without `inim.`; null: not given. With
    #: `score_error`, the sample counts are those that were used.
    settings: Settings
    misalign: str  #: Misalignment of the array that generators do not correct; empty: none.
    rgbd: CapturedPicture
    noise_floor: NoiseFloor | None = None  #: Absent for a picture without a scene.
    scoring: Scoring
    reference: ReferenceViews
    #: Results, by name: an algorithm with its options, or the name of a finished EIA (`--eia`).
    algorithms: dict[str, AlgorithmResult]
    #: Differences between the best algorithm and each other, by viewpoint.
    differences: list[ScoreDifference] = []
    timings: Annotated[
        dict[str, float],
        doc(
            "Seconds by stage.",
            properties={
                name: {"type": "number", "description": text} for name, text in _TIMES.items()
            },
            required=[*_TIMES],
        ),
    ]
    skipped: list[SkippedStep]  #: Performed and skipped parts of each step.
    regression: Regression | None = None  #: Only with `--baseline`.

    def __post_init__(self) -> None:
        check_names([*self.viewpoint_names, *self.algorithms])
        try:
            misaligned(self.display.parameters, self.misalign)
        except InimError as error:
            raise ValueError(f"misalign: {error}") from None
        for name in _TIMES:
            if name not in self.timings:
                raise ValueError(f"timings: {name} is missing")
        if (self.scene is None) is (self.picture is None):
            raise ValueError("scene: give either scene or picture")
        of_truth = {"reference": self.reference.views}
        if self.noise_floor is not None:
            check_scores("noise_floor.eia", self.noise_floor.eia, EIA_SCORES)
            of_truth["noise_floor"] = self.noise_floor.views
        for name in self.viewpoint_names:
            for place, views in of_truth.items():
                if name not in views:
                    raise ValueError(f"{place}: has no scores of {name[:40]!a}")
                check_scores(f"{place}.{name[:40]!a}", views[name], VIEW_SCORES)
        for name, result in self.algorithms.items():
            check_scores(f"algorithms.{name}.eia", result.eia, _ALGORITHM_EIA_SCORES)
            for view, scores_by_view in result.views.items():
                check_scores(
                    f"algorithms.{name}.{view[:40]!a}", scores_by_view, ALGORITHM_VIEW_SCORES
                )
        for place, views in {
            **{f"algorithms.{name}": result.views for name, result in self.algorithms.items()},
            "reference": self.reference.views,
        }.items():
            for view in views:
                if view not in self.viewpoint_names:
                    raise ValueError(f"{place}: has scores of {view[:40]!a}, which is no viewpoint")

    def headlines(self, algorithm: str) -> list[float]:
        """Headline scores of an algorithm's views, those that are finite numbers."""
        views = self.algorithms[algorithm].views
        values = [views[name][HEADLINE] for name in self.viewpoint_names if name in views]
        return [v for v in values if v is not None and math.isfinite(v)]

    @property
    def best_algorithm(self) -> str | None:
        """The algorithm with the best mean headline score; None without any score."""
        return best_algorithm({name: self.headlines(name) for name in self.algorithms})

    def mean(self, algorithm: str, key: str) -> float | None:
        """Mean of a score over all viewpoints; None if a view has none."""
        views = self.algorithms[algorithm].views
        values = [views[name].get(key) for name in self.viewpoint_names if name in views]
        numbers = [value for value in values if value is not None and not math.isnan(value)]
        if not numbers or len(numbers) < len(self.viewpoints):
            return None
        return sum(numbers) / len(numbers)

    def mean_difference(self, other: str) -> tuple[float, float, float] | None:
        """Mean difference of the best algorithm to another over all viewpoints, and its interval.

        The viewpoints can share noise, so the interval's ends are means, too. None if one is
        unknown.
        """
        rows = [(d.value, *d.interval) for d in self.differences if d.other == other]
        finite = [[v for v in row if v is not None and math.isfinite(v)] for row in rows]
        if not rows or any(len(row) < 3 for row in finite):
            return None
        value, low, high = (sum(values) / len(rows) for values in zip(*finite, strict=True))
        return value, low, high

    def passing_limits(self) -> dict[str, float]:
        """Least headline scores that this run would just pass, by algorithm with all of them."""
        limits = {}
        for name, result in self.algorithms.items():
            scores = self.headlines(name)
            if scores and len(scores) == len(self.viewpoints):
                widths = [
                    p[HEADLINE].half_width for p in result.precision.values() if HEADLINE in p
                ]
                limits[name] = passing_limit(scores, max((w or 0.0 for w in widths), default=0.0))
        return limits
