"""The wheel, in an environment and a folder of its own."""

import sys

import pytest

from tests.from_wheel import ROOT
from tests.system.conftest import run_child


@pytest.mark.slow
def test_a_stranger_s_programs_run():
    words = [sys.executable, "-m", "tests.from_wheel", "--borrow-packages"]
    ended = run_child(words, 900, cwd=ROOT)
    assert ended.code == 0, ended.stdout + ended.stderr
