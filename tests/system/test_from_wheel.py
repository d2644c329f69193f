"""The wheel, in an environment and a folder of its own."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.from_wheel import ROOT


@pytest.mark.slow
def test_a_stranger_s_programs_run():
    ended = subprocess.run(
        [sys.executable, "-m", "tests.from_wheel", "--borrow-packages"],
        cwd=ROOT, capture_output=True, text=True, timeout=900, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stdout + ended.stderr
