"""The bench of a scene: times of the algorithms against errors of their sources and views.

`inim.pipeline.validate` evaluates the algorithms: scores are without noise and have intervals.
"""

from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from tempfile import TemporaryDirectory

import numpy as np

from inim.apps.bench.document import (
    BenchAlgorithm,
    BenchError,
    BenchScene,
    Estimate,
    TimingRecord,
)
from inim.apps.bench.front import WRONG_SOURCE, Entry, fronts
from inim.apps.bench.memory import peak_memory
from inim.display import Display
from inim.generators import SourceGenerator
from inim.generators.oracle import ExactHits, exact_hits, lensed_pixels, why_no_oracle
from inim.image.color import srgb_from_linear, srgb_to_uint8
from inim.image.rgbd import RGBD
from inim.pipeline.evaluation import Evaluation
from inim.pipeline.job import setup
from inim.pipeline.output import Images
from inim.pipeline.plan import Plan
from inim.pipeline.stages.method import prepare_timed_methods
from inim.pipeline.timing import (
    REFERENCE_KERNEL,
    OtherPrograms,
    Rounds,
    TimedMethod,
    Timing,
    mean_ratio,
    thread_count,
    time_methods,
)
from inim.pipeline.validate import evaluate
from inim.report.labels import unequal_terms, usual_terms
from inim.scores import metrics
from inim.scores.document_parts import DisplayRecord, PictureShape
from inim.scores.regression.scores import INTERVAL_LEVEL, ScoreEstimate
from inim.scores.regression.verdict import binomial_interval
from inim.system.errors import SceneError
from inim.system.process.observer import Observer
from inim.system.process.user_paths import user_text


def bench_errors() -> list[BenchError]:
    """Describe all errors in the order of the tables: of sources, then of views on the relic."""
    return [
        BenchError(key=WRONG_SOURCE, label="wrong source %", better="lower", digits=2),
        *(
            BenchError(
                key=metric.on_relic_to_reference_key,
                label=f"{metric.label} {metric.unit}".rstrip(),
                better=metric.better,
                digits=metric.digits,
            )
            for metric in metrics.all_metrics()
            if metric.has_relic_score
        ),
    ]


#: Above this share of the processors, other programs disturb the times, which are taken again.
DISTURBED = 0.1
_MOST_ATTEMPTS = 3


def _time_undisturbed(
    methods: Sequence[TimedMethod], rgbd: RGBD, display: Display, rounds: Rounds, observer: Observer
) -> tuple[dict[str, Timing], float | None]:
    """Times of the least disturbed attempt, and the share of the processors used by others."""
    attempts: list[tuple[dict[str, Timing], float | None]] = []
    for _ in range(_MOST_ATTEMPTS):
        with OtherPrograms() as others:
            times = time_methods(methods, rgbd, display, rounds)
        attempts.append((times, others.share))
        if others.share is None or others.share <= DISTURBED:
            break
        observer.line(
            f"other programs used {others.share:.0%} of the processors; "
            f"attempt {len(attempts)} of {_MOST_ATTEMPTS}"
        )
    return min(attempts, key=lambda attempt: attempt[1] or 0.0)


class _DisplayReadyEIAs(Images):
    """Keeps the scored EIAs as panels show them, (rows, columns, 3) uint8; writes no images."""

    def __init__(self, observer: Observer) -> None:
        super().__init__(Path(), {}, observer, data_only=True)
        self.by_name: dict[str, np.ndarray] = {}

    def save(self, name: str, linear: np.ndarray) -> None:
        """Keep the EIA of a method."""
        kind, _, method = name.partition("/")
        if kind == "eia":
            self.by_name[method] = srgb_to_uint8(srgb_from_linear(linear))


def bench_scene(plan: Plan, size: str, rounds: Rounds, observer: Observer) -> BenchScene:
    """Evaluate the algorithms of a plan as a validation does, and time them on the same picture.

    `size` are the settings of its size, for the record.
    """
    names, display = [method.name for method in plan.methods], plan.display
    eias = _DisplayReadyEIAs(observer)
    with TemporaryDirectory() as folder:
        run, renderer, _ = setup(plan, Path(folder), observer, data_only=True)
        with eias.thread, run.ahead:
            evaluation = evaluate(plan, renderer, eias, run)
    if not evaluation.capture.rgbd.covered.any():
        raise SceneError(
            f"{plan.request.scene}: the depth camera's picture is empty; check the scene's shapes"
        )
    observer.begin(["memory", "time", "exact sources", "write"])
    methods, rgbd = prepare_timed_methods(names, evaluation.capture)
    observer.stage("memory")
    threads = thread_count(rounds.threads)
    memory = {m.name: peak_memory(m.name, m.rgbd, display, threads) for m in methods}
    observer.stage("time")
    times, others = _time_undisturbed(methods, rgbd, display, rounds, observer)
    observer.stage("exact sources")
    no_oracle = why_no_oracle(rgbd, display)
    exact = None if no_oracle else exact_hits(rgbd, display)
    is_sampled = exact is not None and len(exact.pixels) < len(lensed_pixels(display))
    entries = {
        m.name: Entry(
            times[m.name], _wrong(m, exact, rgbd), _scores(evaluation, m.name), is_sampled
        )
        for m in methods
    }
    terms = {name: result.scores.terms for name, result in evaluation.results.items()}
    warnings = warn_of_others(others)
    warnings += [f"wrong sources are not counted: {no_oracle}"] if no_oracle else []
    warnings += [f"{c.name}: a check failed" for c in evaluation.checks if c.fails_run]
    warnings += evaluation.warnings
    warnings += unequal_terms(terms)
    for method in methods:
        warnings += warn_of_cold_start(method.name, times[method.name])
        warnings += warn_of_other_work(method, eias.by_name[method.name])
    on_fronts, kernel = fronts(entries), times[REFERENCE_KERNEL]
    algorithms = []
    for method in methods:
        timing, eia = times[method.name], dict(evaluation.results[method.name].scores.eia)
        algorithms.append(
            BenchAlgorithm(
                name=method.name,
                terms=terms[method.name],
                is_equal=terms[method.name] == usual_terms(terms),
                prepare_s=method.prepare_s,
                **timing.as_data(),
                time_ms=Estimate.of(*mean_ratio(timing), 1e3),
                kernel_times=Estimate.of(*mean_ratio(timing, kernel)),
                memory_bytes=memory[method.name],
                hole_fraction=eia.pop("hole_fraction"),
                eia=eia,
                errors=_estimates(entries[method.name]),
                fronts=on_fronts[method.name],
            )
        )
    rows, columns = rgbd.shape
    name = plan.request.scene.stem
    return BenchScene(
        path=user_text(plan.request.scene),
        sha256=plan.file.sha256,
        name=f"{name}, {size}" if size else name,
        size=size,
        display=DisplayRecord.of(display),
        viewpoints=[viewpoint.name for viewpoint in plan.viewpoints],
        picture=PictureShape(rows=rows, columns=columns, pixel_mm=rgbd.pixel_mm),
        samples=evaluation.plan.samples,
        checked_pixels=0 if exact is None else len(exact.pixels),
        yardstick=TimingRecord(**times[REFERENCE_KERNEL].as_data()),
        algorithms=algorithms,
        others=others,
        warnings=warnings,
    )


def warn_of_others(share: float | None) -> list[str]:
    """Warn if other programs used a share of the processors during the timed rounds."""
    if share is not None and share <= DISTURBED:
        return []
    used = "an unknown share" if share is None else f"{share:.0%}"
    return [
        f"other programs used {used} of the processors during the measurement; the times are not "
        "comparable with others, and their ratios are less reliable; close them and repeat"
    ]


def _wrong(method: TimedMethod, exact: ExactHits | None, front: RGBD) -> np.ndarray | None:
    """Checked panel pixels whose source is not the exact first hit on the front surface."""
    generator = method.generator
    if exact is None or not isinstance(generator, SourceGenerator) or method.rgbd is not front:
        return None
    wrong: np.ndarray = generator.sources(front)[tuple(exact.pixels.T)] != exact.sources
    return wrong


def _scores(evaluation: Evaluation, name: str) -> dict[str, dict[str, ScoreEstimate]]:
    """Scores of a method by viewpoint."""
    return {
        key.removeprefix(f"{name}/"): scores
        for key, scores in evaluation.results[name].statistics.scores.items()
    }


def _estimates(entry: Entry) -> dict[str, Estimate]:
    """Errors of an algorithm by key; the interval of a mean has the mean ends."""
    estimates = {}
    for key in entry.keys:
        if key == WRONG_SOURCE and entry.wrong is not None:
            count, pixels = int(np.count_nonzero(entry.wrong)), entry.wrong.size
            share = count / pixels
            ends = binomial_interval(count, pixels, INTERVAL_LEVEL)
            estimates[key] = Estimate.of(share, ends if entry.is_sampled else (share, share))
            continue
        of_views = [(s[key].value, *s[key].interval) for s in entry.scores.values()]
        value, low, high = (fmean(values) for values in zip(*of_views, strict=True))
        estimates[key] = Estimate.of(value, (low, high))
    return estimates


# A first run that takes so many times as long as any other is a cold start.
_COLD = 2.0


def warn_of_cold_start(name: str, timing: Timing) -> list[str]:
    """Warn if the first counted run is a cold start."""
    first, *others = timing.times_s
    if not others or first <= _COLD * max(others):
        return []
    return [
        f"{name}: its first counted run took {first / max(others):.1f} times as long as any other, "
        "as a cold start does, which counts for no algorithm; raise --warmups"
    ]


# Levels of 255 by which the timed EIA may differ from the scored one in a channel: the input, the
# sum and its result are rounded. A larger share of the pixels is other work.
_MOST_LEVELS = 4
_MOST_OTHER = 0.001


def warn_of_other_work(method: TimedMethod, scored: np.ndarray) -> list[str]:
    """Warn if the timed EIA is not the scored one, (rows, columns, 3) uint8."""
    timed = np.where(method.out[..., 3:] > 0, method.out[..., :3], 0)
    differs = np.abs(timed.astype(np.int16) - scored).max(axis=-1) > _MOST_LEVELS
    if differs.mean() <= _MOST_OTHER:
        return []
    return [
        f"{method.name}: its timed EIA differs from the scored one in {differs.mean():.1%} of the "
        "pixels; its time is that of other work"
    ]
