"""Documents of the benchmark: a case of the suite, a submission, its scores, and the board."""

from typing import Annotated

from inim.scores.document_parts import DisplayRecord, EyePosition, Files, Sha256, TitledDocument
from inim.system.document import Document, Part, doc

Protocol = Annotated[str, doc("Name and version of the benchmark.", examples=["inim-bench-1.0"])]
Hashes = Annotated[
    dict[str, Sha256], doc("SHA-256 of files by path in the folder of the document.")
]


class InputPicture(Part):
    """An RGB-D picture with parallel rays, centred on the array.

    The point of row i, column j and depth z is ``x = (j - (W - 1) / 2) pixel_mm + right z``,
    ``y = ((H - 1) / 2 - i) pixel_mm + up z``, for W columns and H rows.
    """

    color: str  #: PNG, sRGB; alpha is 0 where there is no surface.
    #: EXR with the channel Z: z of the surface in mm, towards the viewer; the array is at 0.
    depth: str
    right: float  #: Slope of its rays to the right, mm per mm towards the viewer.
    up: float  #: Slope of its rays upwards.


class InputDocument(Document, tag="inim.benchmark-input/1"):
    """Inputs of a case of the benchmark.

    `input.json` next to the pictures. Lengths are millimetres in the display frame: x to the right,
    y up, z towards the viewer, origin in the middle of the lens array.
    """

    protocol: Protocol
    case: str  #: Name of the case.
    relic: str  #: Name of the relic.
    source: str  #: Origin of the relic.
    licence: str  #: Licence of the relic.
    display: DisplayRecord
    #: EXR of the panel's rays, for each colour c of R, G, B: channels ``c.x`` and ``c.y`` are the
    #: point of the array's plane that the ray of a panel pixel passes, ``c.right`` and ``c.up`` its
    #: slopes: at depth z it is at ``(x + right z, y + up z)``. NaN: no lens.
    rays: str
    pixel_mm: float  #: Side of a pixel of the pictures.
    #: Pictures: the first for the tracks `rgbd` and `blind`, all for `cameras`.
    pictures: list[InputPicture]
    mesh: str  #: Mitsuba scene for the track `mesh`, with its files.
    #: Rows of the affine map (4 x 4) from the scene to the display frame.
    display_from_scene: list[list[float]]
    viewpoints: list[EyePosition]  #: Viewpoints of the scores.


class Statistic(Part):
    """Mean of a truth's image over some pixels, with its standard error."""

    mean: tuple[float, float, float]  #: Linear red, green and blue.
    error: tuple[float, float, float]  #: Standard errors of the three.
    share: float  #: Share of the pixels.


class StatisticsDocument(Document, tag="inim.benchmark-statistics/1"):
    """Statistics of the published suite.

    Other machines compare their suite with it; see `inim benchmark check`.
    """

    protocol: Protocol
    #: Statistics by case, then as in `case.json`.
    cases: dict[str, dict[str, Statistic]]


class CaseDocument(Document, tag="inim.benchmark-case/1"):
    """Manifest of a case of the benchmark.

    `case.json` in the folder of a case: its seeds, samples, files and statistics.
    """

    protocol: Protocol
    case: str  #: Name of the case.
    seed: int  #: Seed of the renderer's noise.
    blind_seed: int  #: Seed of the deviations in the track `blind`.
    scene: Sha256  #: Digest of the scene and its files.
    samples: dict[str, int]  #: Samples per pixel by setting.
    files: Hashes
    #: Statistics of the truth: of the panel's pixels (`eia`, `blind`), and of the relic in a view.
    statistics: dict[str, Statistic]


class SubmissionDocument(Document, tag="inim.submission/1"):
    """A submission to the benchmark.

    `submission.json` next to one picture for each case, `CASE.png` or `CASE.exr`.
    """

    protocol: Protocol
    name: str  #: Name of the algorithm with its options.
    authors: list[str]  #: Authors of the algorithm.
    licence: str  #: Licence of the pictures.
    tracks: list[str]  #: Tracks in which the pictures compete.
    files: Hashes
    paper: str = ""  #: Title, DOI or address of the paper.
    hardware: str = ""  #: Machine of the run times.
    seconds: dict[str, float] = {}  #: Run time by case, seconds.


class ViewScores(Part):
    """Scores of a case, means over its viewpoints, with half the width of their intervals."""

    headline: float  #: SSIM on the relic to the reference: views of the true EIA, same optics.
    headline_error: float  #: Half the width of its 95 % interval.
    centre: float  #: Headline at the middle viewpoint.
    sides: float  #: Mean headline of the other viewpoints.
    to_truth: float  #: SSIM on the relic to the ground truth.
    psnr_to_truth_db: float  #: PSNR of whole views to the ground truth, dB.
    psnr_db: float | None  #: PSNR of the whole EIA; null: identical.


class ResultDocument(Document, tag="inim.benchmark-result/1"):
    """Scores of a submission to the benchmark.

    `result.json` in the folder of `inim benchmark score`.
    """

    protocol: Protocol
    submission: SubmissionDocument
    #: SHA-256 of the truth's files.
    truth: dict[str, Sha256]
    #: Scores by track and case.
    scores: dict[str, dict[str, ViewScores]]
    panel_pixels: dict[str, int]  #: Panel pixels by case.
    warnings: list[str] = []  #: Remarks of the validator.


class BoardEntry(Part):
    """Means of a submission over the cases of a track."""

    name: str  #: Name of the algorithm.
    cases: int  #: Number of cases.
    headline: float  #: Mean headline.
    headline_error: float  #: Half the width of its 95 % interval, from the truth's noise.
    worst: str  #: Relic with the lowest mean.
    worst_headline: float  #: Its mean headline.
    centre: float  #: Mean headline at the middle viewpoint.
    sides: float  #: Mean headline at the other viewpoints.
    to_truth: float  #: Mean SSIM to the ground truth.
    psnr_db: float | None  #: Mean PSNR of EIAs; null: identical.
    #: Share of what is possible: error of the optimal EIA's views over that of its own, root mean
    #: squares to the ground truth; null: no optimal EIA was scored.
    possible: float | None
    ms_per_megapixel: float | None  #: Median run time per million panel pixels, milliseconds.
    #: Mean difference of the headline to the best entry's, with its 95 % interval over relics,
    #: unknown for a single one; null: the best entry.
    difference: tuple[float, float | None, float | None] | None


class BoardDocument(TitledDocument, tag="inim.benchmark-board/1"):
    """Board of the benchmark.

    `board.json` in the folder of `inim benchmark board`: all scored submissions, best first.
    """

    protocol: Protocol
    citation: str  #: Sentence that cites the protocol.
    tracks: dict[str, list[BoardEntry]]  #: Entries by track, best first.
    results: list[ResultDocument]  #: All results.
    files: Files
