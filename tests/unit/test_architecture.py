"""The way from `inim.validate` to one view's SSIM is as short as docs/architecture.md says."""

import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

import inim
from inim.scores.metrics.ssim import metric
from inim.system.process import threads as parallel
from tests.conftest import scene_text, sphere

DOCUMENT = Path(__file__).parents[2] / "docs" / "architecture.md"
MOST = 20


def modules_of(frame: FrameType | None) -> Iterator[str]:
    """The modules of the package on a stack."""
    while frame is not None:
        name = frame.f_globals.get("__name__", "")
        if name.partition(".")[0] == "inim":
            yield name
        frame = frame.f_back


def recording(accesses: set[str], function: Any) -> Any:
    """A function that also notes which modules led to it, and its own."""

    def called(*words: Any, **named: Any) -> Any:
        stack = {*modules_of(inspect.currentframe())}
        if "inim.pipeline.validate" in stack:  # the report draws a map of SSIM, too
            accesses.update(stack, {function.__module__})
        return function(*words, **named)

    return called


@pytest.fixture
def path(renderer: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Modules passed through on the way to a view and to its SSIM, worker and all."""
    from inim.render import view_matrix
    from tests.system.conftest import without_page, worker_here

    visited: set[str] = set()
    # All in one thread and one process: the stack is the whole way.
    monkeypatch.setattr(parallel, "cpu_count", lambda: 1)
    view_matrices = recording(visited, view_matrix.view_matrices)
    monkeypatch.setattr(view_matrix, "view_matrices", view_matrices)
    monkeypatch.setitem(vars(metric), "function", recording(visited, metric.function))
    scene = tmp_path / "tiny.xml"
    scene.write_text(scene_text(sphere((0, 0, 1), 1.2)), encoding="utf-8")
    small = {"lens_columns": 8, "lens_rows": 6, "capture_spp": 2, "eia_spp": 2, "view_spp": 2}
    with worker_here(), without_page():
        inim.validate(
            scene,
            tmp_path / "out",
            definitions={f"inim.{key}": value for key, value in small.items()},
            algorithms="template",
            viewpoints="centre",
            no_skip=True,
        )
    return visited


def test_a_view_s_ssim_is_twenty_modules_away_or_less_and_they_are_listed(path):
    part = DOCUMENT.read_text("utf-8").split("<!-- path -->")[1]
    listed = re.findall(r"`(inim[\w.]*)`", part)
    assert len(listed) == len(set(listed)) <= MOST
    assert path <= set(listed), "a stack has modules that the document leaves out"
    assert {"inim.pipeline.validate", "inim.scores.metrics.ssim", "inim.render.view_matrix"} <= path
