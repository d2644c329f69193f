"""The verdict never fails open: what goes wrong inside a run is planted, and each is caught.

Expected: a failed check and exit code 1, or an error that says what happened; never a pass.
"""

import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inim.image.noisy_image import NoisyEIA, NoisyImage
from inim.pipeline import validate as validating
from inim.pipeline.job import run as run_plan
from inim.pipeline.plan import make_plan
from inim.pipeline.request import Request
from inim.pipeline.stages import generation as generating
from inim.pipeline.stages.generation import GeneratedEIA
from inim.pipeline.stages.scoring import missing_viewpoints
from inim.report import Report
from inim.report.sections.overview import verdict_sentence
from inim.report.summary import render_junit
from inim.scores.document_parts import check
from inim.system.errors import EXIT_INTERNAL, EXIT_USAGE, InimError, UsageError
from inim.system.process.observer import Observer
from inim.system.worker.serve import Job, answer
from inim.system.worker.supervisor import outcome_of
from tests.conftest import scene_text, square
from tests.system.conftest import TINY, write_scene

pytestmark = pytest.mark.usefixtures("no_page")
VIEWS = ("right", "down")
# The sound run scores 0.74 and 0.75 from there.
LIMIT = 0.6
MORE = {"inim.eia_spp": "16", "inim.view_spp": "16", "inim.reconstruction_spp": "16"}


@pytest.fixture
def plan(tmp_path):
    """Two viewpoints and a limit that the sound run meets; the scene has no symmetry."""
    shapes = square((-2, 1, 4), 1.2, "0.9,0.1,0.1"), square((2, -1, -4), 1.5, "0.1,0.9,0.1")
    scene = write_scene(tmp_path, text=scene_text(*shapes))
    settings = (
        TINY | MORE | {"inim.min_ssim_to_reference": str(LIMIT), "inim.algorithms": "template"}
    )
    return make_plan(Request(scene, tmp_path / "out", definitions=settings, viewpoints=VIEWS))


@pytest.fixture
def run(renderer, plan, tmp_path):
    def once() -> Report:
        folder = tmp_path / "staging"
        folder.mkdir()
        return run_plan(plan, folder)

    return once


def failed(report: Report) -> set[str]:
    assert report.passed is False
    return {check.name for check in report.data.verdict.checks if not check.passed}


def with_views(
    monkeypatch: pytest.MonkeyPatch, change: Callable[[dict[str, Any]], dict[str, Any]]
) -> None:
    """Let something happen to a method's views, not to the reference."""
    real = validating.reconstruct_views

    def changed(name: str, *words: Any, **named: Any) -> dict[str, Any]:
        views = real(name, *words, **named)
        return views if name == "reference" else change(views)

    monkeypatch.setattr(validating, "reconstruct_views", changed)


def test_sound_run_passes(run):
    assert run().passed is True


def test_missing_views_are_a_failed_check():
    for views, count in ((["down", "right"], None), (["down"], 1), ([], 2)):
        checks = missing_viewpoints("mine", ["right", "down"], views)
        assert [row.value for row in checks] == ([] if count is None else [count])
        assert not any(row.passed for row in checks)
    assert [row.passed for row in missing_viewpoints("mine", [], [])] == [False]


def test_swapped_views_fail_their_limit(run, monkeypatch):
    with_views(monkeypatch, lambda views: {"down": views["right"], "right": views["down"]})
    expected = {
        f"template/{view}: SSIM on the relic, to the reference" for view in ("down", "right")
    }
    assert expected <= failed(run())


def test_view_that_is_not_a_number_is_never_scored(run, monkeypatch):
    def spoiled(views: dict[str, Any]) -> dict[str, Any]:
        views["down"].image[3, 4] = np.nan
        return views

    with_views(monkeypatch, spoiled)
    with pytest.raises(UsageError, match="not finite"):
        run()


@pytest.mark.parametrize("factor", [255.0, 1 / 255])
def test_eia_in_another_range_fails_its_limit(run, monkeypatch, factor):
    real = generating.run_generator

    def scaled(*words: Any) -> Any:
        result = real(*words)
        return result._replace(eia=np.float32(factor) * result.eia, sources=None)

    monkeypatch.setattr(generating, "run_generator", scaled)
    assert any("SSIM on the relic" in name for name in failed(run()))


def test_radiance_that_is_not_finite_is_counted_and_fails_a_check(run, monkeypatch):
    """Three spoiled pixels in each half of the truth: counted, taken as black, and no pass."""
    from inim.render import ground_truth

    real = ground_truth.pickup

    def spoiled(*words: Any, **options: Any) -> Any:
        truth = real(*words, **options)
        truth.first[2, 3:6] = np.nan
        truth.second[9, 9:12] = np.inf
        return truth

    monkeypatch.setattr(ground_truth, "pickup", spoiled)
    report = run()
    assert "truth/eia: pixels not finite" in failed(report)
    checks = {check.name: check for check in report.data.verdict.checks}
    assert checks["truth/eia: pixels not finite"].value == 6
    assert checks["truth/eia: pixels not finite"].detail == "taken as black"


@pytest.mark.parametrize("value", [None, float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("relation", [">=", "<="])
def test_value_that_is_no_number_passes_no_check(value, relation):
    assert check("any", value, relation, 0.5).passed is False


# --- The renderer -------------------------------------------------------------------------------


def test_integrator_that_raises_is_an_error_and_no_pass(run, monkeypatch):
    from inim.render import trace

    def broken(*_: Any, **__: Any) -> Any:
        raise RuntimeError("jit_llvm_compile(): the kernel does not compile")

    monkeypatch.setattr(trace.dr, "eval", broken)
    with pytest.raises(RuntimeError, match="does not compile"):
        run()


@pytest.mark.parametrize(
    ("error", "code", "says"),
    [
        (RuntimeError("kernel does not\ncompile"), EXIT_INTERNAL, "kernel does not compile"),
        (UsageError("algorithm 'x' failed"), EXIT_USAGE, "algorithm 'x' failed"),
        (MemoryError(), 3, "GiB in use of"),
        (ZeroDivisionError("division"), EXIT_INTERNAL, "internal error: ZeroDivisionError"),
    ],
)
def test_any_exception_of_a_worker_becomes_one_line_and_a_code(error, code, says):
    def work(request: object, staging: Path, observer: Observer) -> bool:
        raise error

    channel = io.StringIO()
    answer(Job(None, Path()), channel, work)
    with pytest.raises(InimError, match=says) as raised:
        outcome_of(json.loads(channel.getvalue().splitlines()[-1]))
    assert raised.value.exit_code == code
    assert "\n" not in str(raised.value)


def test_criteria_do_not_pass_on_a_noisy_ground_truth(monkeypatch, run):
    real, random = validating.render_view, np.random.default_rng(1)

    def noisy(*words: Any, **named: Any) -> tuple[NoisyImage, np.ndarray]:
        view, relic = real(*words, **named)
        halves = (half + random.normal(0, 0.3, half.shape).clip(0) for half in view.halves())
        return NoisyImage.from_halves(*(half.astype(np.float32) for half in halves)), relic

    monkeypatch.setattr(validating, "render_view", noisy)
    report = run()
    assert (report.passed, report.data.verdict.word) == (False, "not conclusive")
    assert "the noise floor of the view" in report.data.warnings[0]
    assert "the noise floor of the view" in render_junit(report.data)
    assert not verdict_sentence(report.data)


def test_criteria_do_not_pass_if_the_capture_misses_what_the_display_shows(monkeypatch, run):
    real = validating.generate_eia

    def half_empty(method: Any, *words: Any, **named: Any) -> GeneratedEIA:
        output = real(method, *words, **named)
        image = output.eia.image.copy()
        image[: len(image) // 2] = 0
        return replace(output, eia=NoisyEIA((image, None)))

    monkeypatch.setattr(validating, "generate_eia", half_empty)
    report = run()
    assert report.passed is False
    assert "the capture misses surfaces" in report.data.verdict.doubts[0]
