"""The wrapper around a stage: what finds a result again, and what the report then says."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inim.pipeline.stages import stage as module
from inim.pipeline.stages.stage import Code, Run, stage
from inim.system.cache import ResultCache, Store
from inim.system.process.observer import Observer

CODE = Code(("system/version.py",))


@dataclass(frozen=True)
class Picture:
    """Dataclasses, arrays and numbers come back as they were kept."""

    name: str
    pixels: np.ndarray
    parts: tuple[Any, ...] = ()


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return Run(ResultCache(Store(tmp_path, 2**20), "topic"))


def counted(**declared: Any) -> tuple[Any, list[int]]:
    """A stage, and a list that grows by each call of its function."""
    calls: list[int] = []

    def function(picture: Picture, factor: int, engine: Any = None) -> Picture:
        calls.append(factor)
        return Picture("made", picture.pixels * factor, (factor, (None, "text"), {"a": 0.5}))

    function.__module__ = module.__name__
    return stage("product of {factor}", code=CODE, result_types=(Picture,), **declared)(
        function
    ), calls


def test_equal_arguments_find_the_result_and_a_label_does_not_matter(run):
    product, calls = counted()
    first = product(Picture("one", np.arange(3.0)), 2, run=run)
    again = product(Picture("other", np.arange(3.0)), 2, run=run)
    assert calls == [2]
    assert np.array_equal(first.pixels, again.pixels) and first.parts == again.parts
    product(Picture("one", np.arange(4.0)), 2, run=run)
    product(Picture("one", np.arange(3.0)), 3, run=run)
    assert calls == [2, 2, 3]


def test_without_a_store_every_call_is_made(run):
    product, calls = counted()
    for _ in range(2):
        product(Picture("one", np.arange(3.0)), 2, run=Run())
    assert calls == [2, 2]


def test_derived_arguments_do_not_change_the_key(run):
    product, calls = counted(derived=("engine",))
    picture = Picture("one", np.arange(3.0))
    assert not product.is_cached(picture, 2, run=run)
    product(picture, 2, engine=object(), run=run)
    assert product.is_cached(picture, 2, run=run)
    product(picture, 2, engine=object(), run=run)
    assert calls == [2]


def test_edited_code_and_that_of_all_stages_make_another_result(run, monkeypatch):
    product, calls = counted()
    product(Picture("one", np.arange(3.0)), 2, run=run)
    places: list[tuple[str, ...]] = []
    monkeypatch.setattr(module, "code_digest", lambda *inputs: places.append(inputs) or "edited")
    product(Picture("one", np.arange(3.0)), 2, run=run)
    assert calls == [2, 2]
    assert places == [("system/version.py", "pipeline/stages", "system/backend/kernels.py")]


def test_the_report_lists_computed_and_reused_results_with_the_reason(run):
    product, _ = counted(describe=("made", "nothing", "it is new"))
    later = Run(run.cache)
    for current in (run, run, later):  # a run's own result stays a computed one
        product(Picture("one", np.arange(3.0)), 2, run=current)
    (computed,), (reused,) = run.skipped.rows, later.skipped.rows
    assert (computed["step"], computed["performed"]) == ("product of 2", "made (not made before)")
    assert (reused["performed"], reused["skipped"]) == ("read from the cache", "all of it")


def test_words_may_be_made_of_the_samples_traced(run):
    observer = Observer()

    def function(factor: int) -> int:
        observer.record_rendering(0.1, 5 * factor)
        return factor

    function.__module__ = module.__name__
    traced = stage(
        "samples", code=CODE, timer="render", describe=lambda n, factor: (f"{n}", "-", f"{factor}")
    )(function)
    run_with_observer = Run(run.cache, observer)
    assert traced(3, run=run_with_observer) == 3
    assert run_with_observer.skipped.rows[0]["performed"] == "15 (not made before)"
    assert set(observer.timings) == {"render"}
