"""Scores of a submission: of its views to those of the true EIA, and to the scene."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

import numpy as np

from inim.apps.benchmark.definition import DISPLAYS
from inim.apps.benchmark.diagnosis import Judged, alpha_mistakes, content_mistakes
from inim.apps.benchmark.document import ResultDocument, SubmissionDocument, ViewScores
from inim.apps.benchmark.protocol import PROTOCOL
from inim.apps.benchmark.submission import (
    DESCRIPTION,
    file_mistakes,
    picture_of,
    read_submission,
)
from inim.apps.benchmark.suite import MadeCase, Truth, made_cases
from inim.display import Display
from inim.image.color import to_srgb
from inim.image.files.eia_file import read_eia
from inim.image.noisy_image import NoisyEIA
from inim.pipeline.stages.reconstruction import reconstruct_views
from inim.pipeline.stages.stage import Run
from inim.scores.metrics import MAIN, eia_scores, psnr
from inim.scores.regression.scores import ScoreEstimate, half_width, view_scores
from inim.system.document import write_document
from inim.system.errors import FileError
from inim.system.process.observer import Observer
from inim.system.process.threads import threads
from inim.system.worker.output import staging_folder
from inim.system.worker.supervisor import run_in_worker

RESULT = "result.json"
_BLIND = "blind"


class ScoreJob(NamedTuple):
    """A submission to score, in spite of mistakes in its content if it is taken `as_is`.

    The content is not examined if it `is_own`: that of an algorithm of this program.
    """

    folder: Path
    submission: SubmissionDocument
    cases: list[MadeCase]
    as_is: bool
    is_own: bool = False


def plan_scores(suite: Path, folder: Path, *, as_is: bool, is_own: bool = False) -> ScoreJob:
    """Read a submission; raises `FileError` with all mistakes of its files."""
    submission, cases = read_submission(folder), made_cases(suite)
    if mistakes := file_mistakes(folder, submission, cases):
        raise SubmissionError(folder, mistakes)
    return ScoreJob(folder, submission, cases, as_is, is_own)


class SubmissionError(FileError):
    """A submission with mistakes; the message has the first one."""

    def __init__(self, folder: Path, mistakes: Sequence[str]) -> None:
        more = f" (and {len(mistakes) - 1} more)" * (len(mistakes) > 1)
        super().__init__(f"{folder}: {mistakes[0]}{more}")
        self.mistakes = mistakes


def run_job(job: ScoreJob, staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: score a submission; raises `SubmissionError` for mistakes."""
    tracks = job.submission.tracks
    observer.begin([case.case.name for case in job.cases])
    scores: dict[str, dict[str, ViewScores]] = {track: {} for track in tracks}
    judged, warnings = [], []
    unreadable: list[str] = []
    alphas: dict[str, float] = {}
    for case in job.cases:
        name = case.case.name
        observer.stage(name)
        path = picture_of(job.folder, name)
        assert path is not None
        try:
            eia, opaque = read_eia(path, case.case.display)
        except FileError as error:
            unreadable.append(f"{error}{_other_display(path, case.case.display)}")
            continue
        if opaque is not None and not opaque[case.case.display.lensed].all():
            alphas[name] = float(1 - opaque[case.case.display.lensed].mean())
        is_blind = {track == _BLIND for track in tracks}
        truths = {blind: case.truth(blind=blind) for blind in is_blind}
        nearest = truths.get(False) or truths[True]
        judged.append(Judged(name, case.case.display, eia, nearest.eia.image))
        for blind, truth in truths.items():
            result, pairs, shares_noise = score_case(eia, truth)
            if shares_noise:
                warnings.append(f"{name}: is a copy of the truth, and shares its noise")
            for track in tracks:
                if (track == _BLIND) == blind:
                    scores[track][name] = result
                    _write_pairs(staging / "views" / track / f"{name}.png", pairs)
    mistakes = [] if job.is_own else [*alpha_mistakes(alphas), *content_mistakes(judged)]
    for text in (*unreadable, *mistakes):
        observer.line(f"mistake: {text}")
    if unreadable or (mistakes and not job.as_is):
        raise SubmissionError(job.folder, [*unreadable, *mistakes])
    document = ResultDocument(
        protocol=PROTOCOL,
        submission=job.submission,
        truth={
            f"{case.case.name}/{name}": digest
            for case in job.cases
            for name, digest in case.manifest.files.items()
            if name.startswith("truth/")
        },
        scores=scores,
        panel_pixels={c.case.name: int(np.prod(c.case.display.eia_shape)) for c in job.cases},
        warnings=[*warnings, *mistakes],
    )
    for text in warnings:
        observer.line(text)
    for track, of_cases in scores.items():
        mean = fmean(score.headline for score in of_cases.values())
        observer.line(f"{track}: headline {mean:.3f}, the mean of {len(of_cases)} cases")
    write_document(staging / RESULT, document)
    return True


def _other_display(path: Path, display: Display) -> str:
    """Words on the display of the benchmark whose size a picture has; empty for none."""
    from PIL import Image

    with suppress(OSError), Image.open(path) as picture:
        size = picture.size[::-1]
        for name, other in DISPLAYS.items():
            if other.eia_shape == size != display.eia_shape:
                return f"; it has the size of the display {name}"
    return ""


def _write_pairs(path: Path, pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
    """Write pairs of views, linear RGB: references above, those of the entry below."""
    from PIL import Image

    rows = [np.concatenate(views, axis=1) for views in zip(*pairs, strict=True)]
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(to_srgb(np.concatenate(rows))).save(path)


_Pairs = list[tuple[np.ndarray, np.ndarray]]


def score_case(eia: np.ndarray, truth: Truth) -> tuple[ViewScores, _Pairs, bool]:
    """Scores of an EIA, linear RGB; reference views and its own; whether it copies the truth.

    The views are the first, at a corner of the viewing zone, and the middle one.
    """
    is_equal = np.array_equal(eia, truth.eia.image)
    is_copy = is_equal or np.array_equal(to_srgb(eia), to_srgb(truth.eia.image))
    noisy = truth.eia if is_equal else NoisyEIA((eia, None))
    run = Run()
    references = reconstruct_views("reference", truth.eia, truth.views, run=run)
    views = reconstruct_views("entry", noisy, truth.views, run=run)

    def score(name: str) -> tuple[ScoreEstimate, ScoreEstimate, ScoreEstimate]:
        image, region = truth.scene[name]
        to_reference = view_scores(references[name], views[name], region, [MAIN.key])
        to_scene = view_scores(image, views[name], region, [MAIN.key, psnr.metric.key])
        return (
            to_reference[MAIN.on_relic_key],
            to_scene[MAIN.on_relic_key],
            to_scene[psnr.metric.key],
        )

    with threads(2) as submit:
        futures = {name: submit(score, name) for name in views}
        results = {name: future.result() for name, future in futures.items()}
    headlines = {name: scores[0] for name, scores in results.items()}
    names = [eye.name for eye in truth.views.viewpoints]
    middle = names[len(names) // 2]
    result = ViewScores(
        headline=fmean(score.value for score in headlines.values()),
        headline_error=fmean(half_width(score) for score in headlines.values()),
        centre=headlines[middle].value,
        sides=fmean(headlines[name].value for name in names if name != middle),
        to_truth=fmean(scores[1].value for scores in results.values()),
        psnr_to_truth_db=fmean(scores[2].value for scores in results.values()),
        psnr_db=eia_scores(truth.eia.image, eia)["psnr_db"],
    )
    pairs = [(references[name].image, views[name].image) for name in (names[0], middle)]
    return result, pairs, is_copy


def score_submission(
    suite: Path,
    folder: Path,
    out: Path,
    *,
    as_is: bool,
    is_own: bool = False,
    quiet: bool,
    debug: bool,
) -> None:
    """Validate and score a submission in a worker process.

    The result is `result.json` in the folder `out`, with pictures of views. Raises `FileError` for
    mistakes in the submission.
    """
    run_in_worker(
        f"{__name__}:run_job",
        lambda: plan_scores(suite, folder, as_is=as_is, is_own=is_own),
        staging_folder(out, (RESULT, "views/")),
        about=str(folder / DESCRIPTION),
        quiet=quiet,
        debug=debug,
    )
