"""Parts and a base class that several documents share."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from datetime import datetime, timezone
from typing import Annotated, Any, Literal

from msgspec import Meta, field

from inim.display import Display
from inim.system.cache import versions
from inim.system.document import Document, Part, doc
from inim.system.version import __version__

Created = Annotated[
    str,
    doc(
        "Time of creation: UTC, ISO 8601.",
        format="date-time",
        examples=["2026-11-22T05:01:10+00:00"],
    ),
]
InimVersion = Annotated[str, doc("Version of inim.")]
Versions = Annotated[
    dict[str, str], doc("Versions of Python and of packages by name; `unknown`: not installed.")
]
Command = Annotated[str, doc("The command line that repeats it.")]
Files = Annotated[list[str], doc("All its files, relative to its folder.")]
Sha256 = Annotated[
    str, doc("A SHA-256 in hexadecimal digits.", pattern="^[0-9a-f]{64}$", examples=["0" * 64])
]
LensModel = Annotated[str, doc("Lens model of the views.")]
Warnings = Annotated[list[str], doc("Warnings about the results, one text each.")]


class BackendRecord(Part):
    """The renderer's backend."""

    variant: str  #: Variant of Mitsuba.
    libllvm: str | None  #: Version of the LLVM library; null: the CUDA backend.
    device: str  #: Name of the processor or graphics card.

    @classmethod
    def of(cls, backend: Any) -> BackendRecord:
        """Record an `inim.system.backend.Backend`."""
        return cls(variant=backend.variant, libllvm=backend.libllvm_version, device=backend.device)


def utc_now() -> str:
    """Return the time of creation for a document."""
    return datetime.now(timezone.utc).isoformat(timespec="seconds")


def origin(command: str, packages: Iterable[str] | None = None) -> dict[str, Any]:
    """Fields of a document on its origin: time, version of inim, command, versions of packages."""
    fields = {"created": utc_now(), "inim_version": __version__, "command": command}
    return fields if packages is None else fields | {"versions": versions(packages)}


class DepthRange(Part):
    """Depths that a display can show."""

    #: Central depth plane D = f g / (g - f), z in mm; null: infinite, a focused display.
    central_depth_mm: float | None
    #: Size of a panel pixel's image in that plane, P_I = |D| P_D / g, mm; null: infinite.
    scene_pixel_mm: float | None
    #: Displayable depth by the formula, 2 |D| P_I / P, mm; null: infinite.
    depth_span_mm: float | None
    depth_min_mm: float  #: Far end of the depth range for pictures, z in mm.
    depth_max_mm: float  #: Near end of the depth range for pictures, z in mm.
    #: True if the range by the formula reached into the lens array and was cut.
    depth_range_is_cut: bool


class DerivedDisplay(DepthRange):
    """Lengths and angles that follow from a display's parameters."""

    width_mm: float  #: Width of the lens array, mm.
    height_mm: float  #: Height of the lens array, mm.
    eia_rows: int  #: Panel pixels down, the rows of an elemental image array (EIA).
    eia_columns: int  #: Panel pixels across, the columns of an EIA.
    pixels_per_lens: float  #: Panel pixels per elemental image along one axis; rarely an integer.
    viewing_half_angle_deg: float  #: Half of the angle within which no view repeats, degrees.
    #: Distance from which an eye on the axis sees no flipped view, mm; null: no distance.
    nearest_viewing_distance_mm: float | None


class DisplayRecord(Part):
    """The display as designed."""

    parameters: Display  #: Its parameters.
    derived: DerivedDisplay

    @classmethod
    def of(cls, display: Display) -> DisplayRecord:
        """Record a display."""
        return cls(parameters=display, derived=DerivedDisplay(**display.derived_quantities()))


class PictureShape(Part):
    """Size of a picture."""

    rows: int  #: Pixels down.
    columns: int  #: Pixels across.
    pixel_mm: float  #: Size of a pixel, mm.


class EyePosition(Part):
    """An eye position."""

    name: str  #: Its name.
    #: Position x, y, z of the eye in the display frame, mm: x to the right, y up, z towards the
    #: viewer from the lens array.
    position_mm: tuple[float, float, float]


Viewpoints = Annotated[list[EyePosition], doc("Eye positions, in order.")]


# -- checks ---------------------------------------------------------------------------------------


Relation = Literal[">=", "<=", "within"]
Kind = Literal["picture", "score", "light", "pixels", "noise"]
Direction = Literal["better", "worse", ""]


class Check(Part):
    """A value against a limit."""

    name: str  #: Name of the checked value.
    value: float | None  #: Measured value; null: not finite, which fails.
    relation: Relation  #: Relation of value and limit; `within` is between -limit and limit.
    limit: float  #: Limit of the value.
    passed: bool  #: True if the check passed.
    detail: str  #: Explanation; may be empty.
    #: Confidence interval of the value, if its noise is known; null: an end that is unknown or
    #: infinite.
    interval: tuple[float | None, float | None] | None = None
    #: p-value of no change, two-sided, before the correction for many tests.
    p_value: float | None = None
    unit: str | None = None  #: Unit of the value in a comparison with a baseline; may be empty.
    kind: Kind | None = None  #: Object of a comparison with a baseline.
    criterion: bool = False  #: True if the user set the limit: a check of quality.
    #: Reason why a failure does not fail the run: an improvement, or changed inputs; may be empty.
    excuse: str = ""
    #: Direction of a changed score or light; empty: unchanged, or without a better side.
    direction: Direction = ""

    def __post_init__(self) -> None:
        if self.passed and (self.value is None or math.isnan(self.value)):
            raise ValueError("passed, but the value is not a number")

    @property
    def fails_run(self) -> bool:
        """True if the check failed and has no excuse."""
        return not (self.passed or self.excuse)

    @property
    def is_of_quality(self) -> bool:
        """True for a check against a limit that the user set, or against a baseline."""
        return self.criterion or self.kind is not None


def check(
    name: str,
    value: float | None,
    relation: Relation,
    limit: float,
    detail: str = "",
    interval: tuple[float, float] | None = None,
    criterion: bool = False,
) -> Check:
    """Compare a value with a limit; a value that is missing or not finite fails."""
    passed = value is not None and math.isfinite(value)
    if value is not None and passed:
        passed = bool(value >= limit if relation == ">=" else value <= limit)
    return Check(
        name=name,
        value=value,
        relation=relation,
        limit=limit,
        passed=passed,
        detail=detail,
        interval=interval,
        criterion=criterion,
    )


class Checks(Part):
    """The verdict: all checks."""

    #: True if every check passed or is excused, and no doubt concerns a check of quality.
    passed: bool
    checks: list[Check]  #: The checks, in order.
    doubts: list[str] = []  #: Reasons why the scores allow no conclusion.

    @property
    def word(self) -> Literal["passed", "ran clean", "failed", "not conclusive", "no verdict"]:
        """The verdict in a word or two.

        "ran clean" if all checks passed, but none concerns quality; "not conclusive" with doubts;
        "no verdict" without checks.
        """
        if self.doubts and not self.failures:
            return "not conclusive"
        if not self.passed:
            return "failed"
        if not self.checks:
            return "no verdict"
        return "passed" if any(check.is_of_quality for check in self.checks) else "ran clean"

    @classmethod
    def of(cls, checks: Sequence[Check], doubts: Sequence[str] = ()) -> Checks:
        """The verdict of checks; with doubts, checks of quality do not pass."""
        is_decided = not (doubts and any(check.is_of_quality for check in checks))
        passed = is_decided and not any(check.fails_run for check in checks)
        return cls(passed=passed, checks=[*checks], doubts=[*doubts])

    @property
    def failures(self) -> list[Check]:
        """Checks that failed without an excuse."""
        return [check for check in self.checks if check.fails_run]

    @property
    def passed_count(self) -> int:
        """Number of checks that passed."""
        return sum(check.passed for check in self.checks)

    def __post_init__(self) -> None:
        if self.passed and self.failures:
            raise ValueError("passed, but one of the checks failed")


# -- scores ---------------------------------------------------------------------------------------

_SSIM = "Structural similarity (SSIM), -1 to 1, 1 for equal pictures"
_PSNR = "Peak signal-to-noise ratio (PSNR), dB, higher is better; null: infinite, of equal pictures"
_FLIP = "Mean FLIP, 0 to 1, 0 for equal pictures"
_NO_RELIC = "; null: no pixel shows the relic."
#: Names and descriptions of the scores of a view that every run has.
VIEW_SCORES = {
    "ssim": f"{_SSIM}.",
    "psnr_db": f"{_PSNR}.",
    "flip": f"{_FLIP}.",
    "ssim_on_relic": f"SSIM on the relic alone{_NO_RELIC}",
    "psnr_on_relic_db": "PSNR on the relic alone, dB; null: infinite, or no pixel shows the relic.",
    "flip_on_relic": f"FLIP on the relic alone{_NO_RELIC}",
}
#: The same of an EIA.
EIA_SCORES = {key: VIEW_SCORES[key] for key in ("ssim", "psnr_db")}


def scores(text: str, named: dict[str, str]) -> Meta:
    """Description of a mapping of scores by name, and of those that it always has."""
    number = {"type": ["number", "null"]}
    return doc(
        text,
        properties={name: number | {"description": about} for name, about in named.items()},
        required=list(named),
    )


Scores = Annotated[
    dict[
        str,
        Annotated[
            float | None,
            doc(
                "The same of another package's metric, under its name and unit, with `_on_relic` "
                "on the relic; null: infinite."
            ),
        ],
    ],
    scores(
        "Scores of one picture against another by every metric, whole and on the relic.",
        VIEW_SCORES,
    ),
]
EiaScore = Annotated[
    float | None,
    doc("The same of another package's metric, under its name and unit; null: infinite."),
]
EiaScores = Annotated[
    dict[str, EiaScore],
    scores(
        "Scores of an EIA against the ground truth by the metrics that apply to a panel; null with "
        "`--lazy`.",
        EIA_SCORES,
    ),
]


class ScorePrecision(Part):
    """Precision of a score."""

    plain: float | None  #: The score of the noisy pictures; null: as for the score.
    #: 95 % interval of the score without noise; null: an unknown or infinite end.
    interval: tuple[float | None, float | None]

    @property
    def half_width(self) -> float | None:
        """Half of the interval's width."""
        low, high = self.interval
        if low is None or high is None or not (math.isfinite(low) and math.isfinite(high)):
            return None
        return (high - low) / 2


Precision = Annotated[
    dict[str, dict[str, ScorePrecision]],
    doc("Precision of the scores: by viewpoint, then by the score's name."),
]


def check_scores(place: str, values: dict[str, float | None], named: dict[str, str]) -> None:
    """Raise ValueError if a score is missing that every run has."""
    missing = [name for name in named if name not in values]
    if missing:
        raise ValueError(f"{place}: {missing[0]} is missing")


# -- comparisons ----------------------------------------------------------------------------------


Preview = Annotated[
    str,
    Meta(pattern="^[A-Za-z0-9+/=]*$", max_length=20_000),
    doc("Small PNG in base64; empty: none."),
]


class FileRecord(Part):
    """A file of a scene."""

    name: str  #: Its name without folders.
    facts: str = ""  #: Size of a picture; number of vertices and bounding box of a mesh.
    preview: Preview = ""


class Change(Part):
    """An input or a circumstance that differs."""

    name: str  #: Its name.
    baseline: str | int | float | bool | None  #: Its value in the baseline; null: none.
    candidate: str | int | float | bool | None  #: Its value now; null: none.
    previews: tuple[Preview, Preview] = ("", "")  #: Of a picture's file: before and now.


#: Verdicts of a comparison; docs/theory/regression.md defines them.
Verdict = Literal[
    "passed",
    "improved",
    "worse",
    "inputs changed, scores within intervals",
    "inputs changed, scores changed",
    "not comparable",
]


class Regression(Part):
    """Results of a comparison with a baseline, except its checks."""

    baseline: str  #: Folder of the baseline, or of the report before.
    reason: str  #: Reason for the baseline; empty for a report.
    accepted: str  #: Time of its acceptance, UTC, ISO 8601; empty for a report.
    verdict: Verdict  #: The verdict of the comparison.
    inputs: list[Change]  #: Changed inputs: scene, files, display, settings, algorithms.
    circumstances: list[Change]  #: Other differences: code, versions, samples, seed, machine.
    not_compared: list[str]  #: Pictures and scores of the baseline without a counterpart.
    pictures: list[str]  #: Names of the changed pictures in `regression/`.


class RunInputs(Part):
    """Declared inputs of a run; a difference between two runs is named in their comparison."""

    #: By name: canonical text of each element of the scene, with the SHA-256 of a file in place of
    #: its path.
    elements: dict[str, str]
    files: dict[str, FileRecord]  #: Files of the scene by their SHA-256.
    display: Display  #: Parameters of the display; absent: the default.
    derived: DerivedDisplay = field(name="display as derived")
    #: Misalignment not corrected by generators, as `rotation_deg=0.5, gap_mm=0.1`; empty: none.
    misalign: str = field(name="array as mounted")
    #: Share of the array that the relic may fill, 0 to 1.
    fit_share: float = field(name="share of the array filled")
    lens_model: LensModel = field(name="lens model")
    #: By name: position x, y, z in the display frame, diameter of the pupil, and distance of the
    #: eye's focus (null: the central depth plane), mm.
    viewpoints: dict[str, tuple[float, float, float, float, float | None]]
    #: Pixels per lens of the views, along one axis.
    view_pixels_per_lens: int = field(name="view pixels per lens")
    #: Pixels of the RGB-D picture per lens pitch.
    capture_pixels_per_pitch: int | float = field(name="RGB-D pixels per pitch")
    algorithms: list[str]  #: Names of the algorithms, in alphabetical order.
    #: Only with perceptual metrics: luminance of the panel's white.
    luminance_cd_m2: float | None = field(name="luminance of white, cd/m^2", default=None)
    #: Only of a turned relic: its turn, counter-clockwise seen from above, degrees.
    turn_deg: float | None = field(name="turn, degrees", default=None)
    #: Only of chosen shapes: their names, as in `inim.relic`.
    relic: str | None = field(name="shapes of the relic", default=None)
    #: Only with `--lazy`.
    panel_pixels: Literal["observed ones only"] | None = field(name="panel pixels", default=None)
    variant: str | None = None  #: Variant of the renderer.


class Circumstances(Part):
    """Circumstances of a run, which may differ between two that are compared."""

    title: str  #: Name of the scene.
    created: Created
    inim: InimVersion
    code: str  #: Digest of inim's source.
    #: By name: version and digest of other packages' algorithms and metrics, and of plugins.
    packages: dict[str, str]
    python: str  #: Version of Python.
    drjit: str  #: Version of Dr.Jit.
    mitsuba: str  #: Version of Mitsuba.
    numba: str  #: Version of numba.
    numpy: str  #: Version of NumPy.
    #: Version of scikit-image, which computes SSIM; null: computed without it.
    scikit_image: str | None = field(name="scikit-image", default=None)
    #: Version of the LLVM library; null: the CUDA backend.
    libllvm: str | None = field(name="libLLVM")
    device: str  #: Name of the processor or graphics card that rendered.
    processor: str  #: Model of the processor.
    threads: int  #: Threads of the processor.
    capture_spp: int  #: Samples per pixel of the RGB-D picture.
    eia_spp: int  #: Samples per pixel of the ground-truth EIA, both halves.
    view_spp: int  #: Samples per pixel of a ground-truth view, both halves.
    reconstruction_spp: int  #: Samples per pixel of a reconstructed view.
    seed: int  #: Random seed of the ground truth.


def check_names(names: Iterable[str]) -> None:
    """Raise ValueError for a name of an algorithm or viewpoint that leads out of the folder.

    They name files.
    """
    for name in names:
        if not name or name.startswith(".") or any(c in "/\\" or not c.isprintable() for c in name):
            raise ValueError(f"{name[:40]!a} names no file of the report")


class TitledDocument(Document):
    """A document with a title and the command that repeats it."""

    title: str  #: Title of its page.
    created: Created
    inim_version: InimVersion
    command: Command
    #: Digests of the code that decides the results, by file or folder of the project; absent: not
    #: recorded.
    code: dict[str, str] = {}


class RunReport(TitledDocument):
    """Fields of every `report.json`, of a scene or of a picture without one."""

    versions: Versions
    display: DisplayRecord
    backend: BackendRecord
    lens_model: LensModel
    viewpoints: Viewpoints
    warnings: Warnings
    verdict: Checks
    files: Files = []

    @property
    def viewpoint_names(self) -> list[str]:
        """Names of the viewpoints, in order."""
        return [eye.name for eye in self.viewpoints]

    @property
    def main_viewpoint(self) -> str | None:
        """The centre, or the first viewpoint; None without any."""
        names = self.viewpoint_names
        return "centre" if "centre" in names else next(iter(names), None)


class SceneFileRecord(Part):
    """A scene's file."""

    path: str  #: Path of the scene's XML, as given.
    sha256: Sha256  #: SHA-256 over the XML and all files it names.
