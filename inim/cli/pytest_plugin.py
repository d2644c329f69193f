"""Pytest fixture that validates a scene against its baseline.

::

    def test_my_generator_shows_what_it_did(inim_validate):
        inim_validate("scenes/jade.xml", algorithms="mine", viewpoints="centre")

Baselines are stored in `inim_baselines/` next to the test's file, one folder for each test, or in
the folder ``inim_baselines`` of the ini file. A missing baseline fails the test. ``pytest --inim-
update --inim-reason "why"`` accepts the tests' results as new baselines.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from inim.report import Report

# Imported by every run of pytest where inim is installed: nothing heavy at the top.


def pytest_addoption(parser: pytest.Parser) -> None:
    """See pytest."""
    group = parser.getgroup("inim", "integral-imaging displays")
    group.addoption(
        "--inim-update",
        action="store_true",
        help="accept the results of the tests as their baselines",
    )
    group.addoption(
        "--inim-reason", metavar="TEXT", help="reason for --inim-update, stored in the baselines"
    )
    parser.addini("inim_baselines", "folder of the baselines, from the ini file's folder")


def pytest_configure(config: pytest.Config) -> None:
    """Refuse an update without a reason before any test runs."""
    if config.getoption("--inim-update") and not (config.getoption("--inim-reason") or "").strip():
        raise pytest.UsageError('--inim-update: give the reason with --inim-reason "..."')


@pytest.fixture
def inim_validate(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[..., Report]:
    """Validate a scene and compare it with this test's baseline.

    The function takes a scene, the arguments of `inim.validate`, and `name` for the baseline if a
    test has several. A scene's path is relative to the test's folder, or absolute. It returns the
    report, whose folder is inside the test's `tmp_path`. It fails the test, with a line for each
    failed check, or if the baseline is missing.
    """
    config = request.config

    def validated(scene: str | Path, *, name: str | None = None, **options: Any) -> Report:
        from inim.pipeline.baseline import accept
        from inim.pipeline.launch import validate
        from inim.system.errors import BaselineError

        label = re.sub(r"[^\w.+-]+", "-", name or request.node.name).strip("-.") or "test"
        baseline = _folder(config, request.path) / label
        out = tmp_path / label
        place = request.path.parent / scene
        if config.getoption("--inim-update"):
            report = validate(place, out, **options)
            _fail_unless_passed(report)
            accept(out, config.getoption("--inim-reason"), baseline)
            return report
        try:
            report = validate(place, out, baseline=baseline, **options)
        except BaselineError as error:
            words = 'run pytest --inim-update --inim-reason "why" to accept one'
            pytest.fail(f"{error}\n{words}", pytrace=False)
        _fail_unless_passed(report)
        return report

    return validated


def _folder(config: pytest.Config, test: Path) -> Path:
    folder = config.getini("inim_baselines")
    if folder:
        root = config.inipath.parent if config.inipath else config.rootpath
        return Path(root / folder)
    return test.parent / "inim_baselines"


def _fail_unless_passed(report: Report) -> None:
    if report.passed:
        return
    from inim.report.comparison_text import comparison_lines
    from inim.report.labels import check_sentence

    failed = [check for check in report.data.verdict.failures if check.kind is None]
    lines = [f"{check.name}: {check_sentence(check)}" for check in failed]
    lines += comparison_lines(report.data)
    pytest.fail("\n".join([*lines, f"report: {report.html_path}"]), pytrace=False)
