"""Processes forked after kernels ran: pools of them work and end."""

from inim.system.process.python_process import child_environment, python_code
from tests.system.conftest import run_child

FORK = """
import multiprocessing
import sys
import numpy as np
import inim

depth = np.zeros((24, 24), np.float32)
rgbd = inim.RGBD(np.ones((24, 24, 3), np.float32), depth, depth == 0, 0.5)
display = inim.DISPLAYS["nominal"].replace(lens_rows=4, lens_columns=4)

def job(algorithm):
    return inim.generate(rgbd, display, algorithm).shape

print(job("template"))
with multiprocessing.get_context("fork").Pool(1) as pool:
    for algorithm in ("template", "gu2020"):
        print(pool.apply(job, (algorithm,)))
"""


def test_forked_jobs_end():
    ended = run_child(python_code(FORK), env=child_environment())
    assert ended.code == 0, ended.stderr
    assert ended.stdout.splitlines() == ["(68, 68, 3)"] * 3
