"""The EIA to export: a file, or one of a report."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from inim.display import Display
from inim.display.misalignment import misaligned
from inim.image.files.eia_file import turned_for
from inim.render.scene_files.file import choose_display
from inim.report import TRUTH, Report
from inim.scores.metrics import HEADLINE_WORDS
from inim.system.errors import UsageError


@dataclass(frozen=True)
class ChosenEIA:
    """EIA to export, with the design of its display and the misaligned display.

    `distance_mm` is the distance of the eyes, and `description` is the name of the EIA with the
    reason of its choice.
    """

    path: Path
    display: Display
    misaligned: Display
    lens_model: str
    distance_mm: float | None
    description: str
    report: Report | None = None
    is_truth: bool = False

    @property
    def design_display(self) -> Display:
        """Display for which the EIA was generated: algorithms use the design."""
        return self.misaligned if self.is_truth else self.display


def choose(
    source: Path,
    algorithm: str | None,
    display: Display | str | Path | None,
    definitions: Mapping[str, Any] | None,
) -> ChosenEIA:
    """Choose the EIA of a file, or of an algorithm of a report; see `inim.export`."""
    if source.is_dir():
        refuse_display(source, display, definitions)
        return _choose_from_report(source, algorithm)
    return _choose_eia(source, algorithm, display, definitions)


def _choose_eia(
    path: Path,
    algorithm: str | None,
    display: Display | str | Path | None,
    definitions: Mapping[str, Any] | None,
) -> ChosenEIA:
    if algorithm:
        raise UsageError("--algorithms: needs a report's folder; an EIA has no algorithms")
    design, settings = choose_display(display, definitions, "inim export")
    design = turned_for(path, design)
    real, distance = misaligned(design, settings.misalign), settings.viewing_distance_mm
    return ChosenEIA(path, design, real, settings.lens_model, distance, path.name)


def refuse_display(report: Path, display: object, definitions: object) -> None:
    """Raise `UsageError` for a display that is given in addition to a report."""
    if display or definitions:
        raise UsageError(
            f"{report}: is a report, which has its own display; --display and -D are for an EIA"
        )


def _choose_from_report(folder: Path, algorithm: str | None) -> ChosenEIA:
    """Chosen algorithm or the ground truth; by default the best by the headline score."""
    report = Report.load(folder)
    name, why = (algorithm, "") if algorithm else _best(report)
    path, design = report.eia_path(name, "--algorithms"), report.display
    return ChosenEIA(
        path,
        design,
        misaligned(design, report.data.misalign),
        report.data.lens_model,
        report.data.settings.viewing_distance_mm,
        name + why,
        report,
        name == TRUTH,
    )


def _best(report: Report) -> tuple[str, str]:
    """Best algorithm, with a phrase for the reason."""
    names, best = list(report.data.algorithms), report.data.best_algorithm
    if len(names) == 1:
        return names[0], ", the report's only algorithm"
    if best is None:
        raise UsageError(
            f"{report.folder}: has no scores to choose by; name one with --algorithms: "
            f"{', '.join([*names, 'truth'])}"
        )
    return best, f", the best of {len(names)} by {HEADLINE_WORDS}"
