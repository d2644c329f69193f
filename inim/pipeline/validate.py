"""Validation: from a scene to a scored report of every contender, viewpoint by viewpoint."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from inim.accuracy_limits import accuracy_warnings
from inim.cache.store import Store, open_store, use_store
from inim.clock import Clock
from inim.observer import Listener
from inim.pipeline.adaptive_sampling import FIRST_SHARE, known_within, next_share, with_share
from inim.pipeline.baseline import check_conditions, judge
from inim.pipeline.generator_times import generator_times
from inim.pipeline.ledger import Ledger
from inim.pipeline.memo import Memo
from inim.pipeline.method import Contender, Entry, Make
from inim.pipeline.plan import Plan
from inim.pipeline.reconstruct import observed_pixels, reconstruct_views
from inim.pipeline.report_data import eia_scores, report_data
from inim.pipeline.request import Request, default_out
from inim.pipeline.run_statistics import (
    Contest,
    Findings,
    Half,
    against,
    ceiling_scores,
    eia_statistics,
    evidence_of,
    fingerprints,
    truth_findings,
)
from inim.pipeline.score import ViewScores
from inim.pipeline.truth import BLACK, CLIPPED_SHARE, GroundTruth, render_truth, share_outside
from inim.regression import HalfBuffer, ScoreEstimate, score_interval, yardsticks
from inim.report import Report
from inim.settings import Settings

__all__ = ["run", "validate"]


def validate(
    scene: str | Path,
    out: str | Path | None = None,
    *,
    definitions: Mapping[str, Any] | None = None,
    display: str | None = None,
    algorithms: str | None = None,
    viewpoints: str | None = None,
    lens_model: str | None = None,
    misalign: str | None = None,
    eias: Mapping[str, str | Path] | None = None,
    backend: str = "auto",
    baseline: str | Path | None = None,
    time: bool = False,
    lazy: bool = False,
    no_skip: bool = False,
) -> Report:
    """Validate a scene in a worker process, as `python -m inim.validate` does.

    Parameters
    ----------
    scene : path
        Mitsuba XML with `inim.*` settings.
    out : path, optional
        Folder for the report; `<scene>-report` in the current folder otherwise.
    definitions : mapping, optional
        Settings and scene parameters to override, like ``{"inim.pitch_mm": 0.5}``.
    display, algorithms, viewpoints, lens_model, misalign : str, optional
        Shorthands for the settings of those names.
    eias : mapping, optional
        Finished EIAs to score beside the algorithms: ``{"mine": "mine.png"}``.
    backend : {"auto", "llvm", "cuda"}
    baseline : path, optional
        Folder of a baseline that `inim baseline accept` made, to compare with.
    time : bool
        Time the generators in yardsticks, too, and compare times where the baseline has them.
    lazy : bool
        Make and render only the panel pixels that the viewpoints observe: the same views and
        scores of views, and none of the EIA as a whole.
    no_skip : bool
        Do everything, also what changes no result, and use no store (`inim cache`).

    Returns
    -------
    Report
        With `passed` False where a check failed; that is a result, not an error.

    Raises
    ------
    InimError
        Of the kind that fits, with the line the command would print.
    """
    from inim.worker.supervisor import run_in_worker

    scene = Path(scene)
    request = Request(
        scene=scene,
        out=default_out(scene) if out is None else Path(out),
        definitions=tuple(f"{k}={v}" for k, v in (definitions or {}).items()),
        display=display,
        algorithms=algorithms,
        viewpoints=viewpoints,
        lens_model=lens_model,
        misalign=misalign,
        eias=tuple(f"{name}={path}" for name, path in (eias or {}).items()),
        backend=backend,
        baseline=None if baseline is None else Path(baseline),
        time=time,
        lazy=lazy,
        no_skip=no_skip,
    )
    run_in_worker(request)
    return Report.load(request.out)


def run(plan: Plan, staging: Path, listener: Listener | None = None) -> Report:
    """Carry out a plan in this process and write its report into `staging`.

    Parameters
    ----------
    plan : Plan
    staging : Path
        An empty folder; see `inim.worker.output`.
    listener : Listener, optional

    Returns
    -------
    Report
    """
    store = None if plan.request.no_skip else open_store()
    with use_store(store):
        return _run(plan, staging, listener or Listener(), store)


def _run(plan: Plan, staging: Path, listener: Listener, store: Store | None) -> Report:
    started = perf_counter()
    listener.stage("start")
    memo = Memo(store, str(plan.request.scene.resolve()))
    job = Ledger(plan, staging, listener, Clock(), memo)
    check_conditions(plan, job.backend.variant)
    job.timings["start"] = perf_counter() - started
    job.warnings += _outside_limits(plan)
    job, truth, ceiling, contests = _measure_until_known(job)
    algorithms = {name: contest.scores for name, contest in contests.items()}
    times = generator_times(job, truth) if plan.request.time else {}
    for name, ratios in times.items():
        algorithms[name]["yardsticks"] = yardsticks(ratios)
    with job.stage("score"):
        findings = [truth_findings(job, truth, ceiling), *(c.findings for c in contests.values())]
        regression = judge(job, evidence_of(job.plan, job.backend, findings, algorithms, times))
    data = report_data(job, truth, ceiling, algorithms)
    data |= {"regression": regression} if regression else {}
    data["timings"] |= {
        "mitsuba_render": job.clock.seconds,
        "total": perf_counter() - started,
    }
    _print_scores(listener, data)
    report = Report(staging, data)
    report.write()
    return report


class _Measured(NamedTuple):
    """What a round of samples has found.

    Attributes
    ----------
    job : Ledger
        Whose plan has the round's samples.
    truth : GroundTruth
    ceiling : dict of str to ViewScores
        By viewpoint.
    contests : dict of str to Contest
        By contender.
    """

    job: Ledger
    truth: GroundTruth
    ceiling: dict[str, ViewScores]
    contests: dict[str, Contest]

    def similarities(self) -> dict[str, ScoreEstimate]:
        """Every SSIM, by what it is of."""
        found = {f"ceiling/{name}": view.estimates["ssim"] for name, view in self.ceiling.items()}
        for contest in self.contests.values():
            for view, scores in contest.findings.scores.items():
                found |= {f"{view} {n}": one for n, one in scores.items() if n.startswith("ssim")}
        return found


def _measure_until_known(job: Ledger) -> _Measured:
    """Measure with as many samples as the scores need; see `inim.pipeline.adaptive_sampling`."""
    asked = job.plan.settings
    error = asked.score_error if job.skip else 0.0
    if not error:
        return _measure(job)
    share = FIRST_SHARE
    before = _measure(job.for_round(with_share(asked, share), viewpoints=1)).similarities()
    while True:
        share = next_share(share, before, error)
        settings = with_share(asked, share)
        measured = _measure(job.for_round(settings))
        scores = measured.similarities()
        known = known_within(scores, before)
        if known <= error or settings == asked:
            _tell_samples(measured.job, asked, known)
            return measured
        before = scores


def _tell_samples(job: Ledger, asked: Settings, known: float) -> None:
    """What the run's samples came to."""
    taken, error = job.plan.settings, asked.score_error
    if not known <= error:
        told = f"known to within {known:.2g}" if known < math.inf else "hardly known"
        job.warnings.append(
            f"with all samples, SSIM is {told}, {error:g} was asked for; raise inim.eia_spp and "
            "inim.view_spp, or inim.score_error"
        )
    done = f"{taken.eia_spp} a pixel of the EIA, {taken.view_spp} of a view"
    rest = (asked.eia_spp - taken.eia_spp, asked.view_spp - taken.view_spp)
    why = f"every SSIM is known to within {known:.2g}; {error:g} was asked for"
    if any(rest):
        job.memo.tell("samples", done, f"{rest[0]} and {rest[1]} more", why)
    else:
        job.memo.tell("samples", done, "none", f"fewer do not tell SSIM to within {error:g}")


def _measure(job: Ledger) -> _Measured:
    """Render the truth, let everybody compete, score."""
    if job.plan.request.lazy:
        job.observed = _observed(job)
    ready = _prepare(job)
    job.listener.begin(_planned_rays(job.plan))
    truth = render_truth(job)
    contests = {
        contender.name: _compete(job, truth, contender, make)
        for contender, make in zip(job.plan.contenders, ready, strict=True)
    }
    with job.stage("score"):
        ceiling = ceiling_scores(job, truth)
    with job.stage("write pictures"):
        job.pictures.settle()
    return _Measured(job, truth, ceiling, contests)


def _outside_limits(plan: Plan) -> list[str]:
    """What of the display lies outside the limits that the stress run measured."""
    return accuracy_warnings(
        plan.display,
        plan.settings.lens_model,
        viewpoints=plan.viewpoints,
        pixel_mm=plan.capture_pixel_mm,
    )


def _observed(job: Ledger) -> np.ndarray | None:
    """The panel pixels to make, (rows, columns) bool; None: all."""
    observed = observed_pixels(job)
    if observed is None:
        why = "the full lens model scatters rays between lenses: any pixel may be observed"
        job.memo.tell("panel pixels", "all", "none", why)
        return None
    done = f"{np.count_nonzero(observed)} of {observed.size} ({observed.mean():.1%})"
    why = "no sample of any asked-for view comes from the others"
    job.memo.tell("panel pixels", done, "the others, and scores of whole EIAs", why)
    return observed


def _planned_rays(plan: Plan) -> int:
    s, d = plan.settings, plan.display
    capture = np.prod(plan.capture_shape) * 2 * max(1, s.capture_spp // 2)
    eia = np.prod(d.eia_shape) * 2 * max(1, s.eia_spp // 2)
    view = d.lens_rows * d.lens_columns * s.view_pixels_per_lens**2
    looks = 3 * (len(plan.contenders) + 1)
    per_view = 2 * max(1, s.view_spp // 2) + looks * max(1, s.reconstruction_spp // 2)
    made = sum(contender.rays(plan) for contender in plan.contenders)
    return int(capture + eia + made + view * per_view * len(plan.viewpoints))


def _prepare(job: Ledger) -> list[Make]:
    """Get every contender ready; those that cannot compete are found out before rendering."""
    ready = []
    for contender in job.plan.contenders:
        with job.stage(f"{contender.doing} {contender.name}"):
            ready.append(contender.prepare(job))
    return ready


def _compete(job: Ledger, truth: GroundTruth, contender: Contender, make: Make) -> Contest:
    """One contender's scores; its pictures are written, its checks made."""
    name = contender.name
    with job.stage(f"{contender.doing} {name}"):
        entry = make(job, truth)
    eia = job.finite(f"eia/{name}", entry.eia)[0]
    with job.stage("write pictures"):
        job.pictures.save(f"eia/{name}", eia)
    noise = None if entry.noise is None else np.nan_to_num(entry.noise)
    seen = reconstruct_views(job, eia, noise, name)
    job.complete(name, seen)
    halves: tuple[Half, Half] = (eia, eia)
    if noise is not None:
        halves = HalfBuffer(eia, noise, 1), HalfBuffer(eia, noise, -1)
    with job.stage("score"), job.beside() as begin:
        # The longest first.
        statistics = begin(eia_statistics, job, name, halves)
        whole = begin(eia_scores, job, truth.eia, eia)
        begun = {view: begin(against, job, truth, view, picture) for view, picture in seen.items()}
        # In this thread: a generator of another package may count on its own.
        prints = fingerprints(job, name, entry.fixed)
        views = {view: one.result() for view, one in begun.items()}
        result: dict[str, Any] = {
            "eia": whole.result() | {"hole_fraction": entry.hole_fraction},
            "views": {view: found.values() for view, found in views.items()},
            "seconds": entry.seconds,
        }
        scores = {f"{name}/{view}": found.estimates() for view, found in views.items()}
        findings = Findings(statistics.result(), scores, prints)
    _check(job, truth, name, entry, eia)
    for view, scores in result["views"].items() if name in job.plan.ssim_limits else ():
        value, limit = scores["ssim_to_ceiling"], job.plan.ssim_limits[name]
        known = score_interval(findings.scores[f"{name}/{view}"]["ssim_to_ceiling"])
        job.check(f"{name}/{view}: SSIM to ceiling", value, ">=", limit, interval=known)
    return Contest(result, findings)


def _check(job: Ledger, truth: GroundTruth, name: str, entry: Entry, eia: np.ndarray) -> None:
    """An EIA that shows nothing is a failure to report; one too bright is worth a warning."""
    if entry.hole_fraction is None:
        job.check(f"{name}: brightest value", float(eia.max()), ">=", BLACK, "not black")
    else:
        shown = 1 - entry.hole_fraction
        job.check(f"{name}: share of pixels shown", shown, ">=", 1e-6, "not all holes")
    # What the scene's own light clips has its warning already.
    outside = share_outside(eia)
    if outside - truth.clipped > CLIPPED_SHARE:
        job.warnings.append(
            f"eia/{name}: {outside:.1%} of the pixels are below black or brighter than the panel's "
            "white, which no panel shows; clip them, or check that they are linear"
        )


def _print_scores(listener: Listener, data: Mapping[str, Any]) -> None:
    width = max(len(name) for name in data["algorithms"])
    for name, result in data["algorithms"].items():
        for view, score in result["views"].items():
            ceiling = data["ceiling"]["views"][view]
            listener.line(
                f"{name:{width}}  {view:8}  SSIM {score['ssim']:.4f} (ceiling "
                f"{ceiling['ssim']:.4f})  to ceiling {score['ssim_to_ceiling']:.4f}  "
                f"PSNR {score['psnr_db']:.2f} dB  FLIP {score['flip']:.4f}"
            )
