"""Sweeps on a real cluster: a scheduler and four worker processes with their nannies.

Expected: the table that a pool makes; a worker killed in mid-task and a killed driver lose what
they had in work at most, and nothing is computed or listed twice. Workers share no folder for
results with the driver.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from inim.apps.sweep.table import TABLE
from inim.system.errors import EXIT_PASSED
from tests.system.conftest import nothing_left
from tests.system.sweeps import (
    WITHIN_S,
    results,
    start,
    sweep,
    table,
    until,
    workers_of,
    write_study,
)

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.slow

_DASK = [sys.executable, "-m", "dask"]


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    """The address of a scheduler with four workers; all end with the tests."""
    folder = tmp_path_factory.mktemp("cluster")
    state = folder / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder}
    commands = (
        [*_DASK, "scheduler", "--port", "0", "--host", "127.0.0.1", "--dashboard-address", ":0"],
        [*_DASK, "worker", "--nworkers", "4", "--nthreads", "1", "--memory-limit", "0"],
    )
    processes = [
        subprocess.Popen([*words, "--scheduler-file", str(state)], **quiet)  # type: ignore[call-overload]
        for words in commands
    ]
    try:
        until(state.exists, "the scheduler starts")
        with distributed.Client(scheduler_file=str(state), set_as_default=False) as client:
            client.wait_for_workers(4, timeout=60)
            address = client.scheduler.address
        yield address
    finally:
        for process in reversed(processes):
            process.send_signal(signal.SIGINT)
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def parent_of(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


def test_a_killed_worker_has_its_task_given_to_another(scheduler, tmp_path):
    study = write_study(tmp_path, scenes=4)
    out, words = tmp_path / "out", (study.name, "-o", "out", "--scheduler", scheduler)
    driver = start(*words, folder=tmp_path)
    # The dask worker itself, with the task it has in work.
    validating = until(lambda: workers_of(out), "a worker starts")[0]
    os.kill(parent_of(validating), signal.SIGKILL)
    printed, errors = driver.communicate(timeout=WITHIN_S)
    assert driver.returncode == EXIT_PASSED, errors
    assert "4 of 4 validations run, 8 rows" in printed
    assert len(results(tmp_path)) == 4
    assert nothing_left(tmp_path)


def test_a_killed_driver_loses_nothing_and_doubles_nothing(scheduler, tmp_path):
    study = write_study(tmp_path, scenes=4, displays=2)
    out, words = tmp_path / "out", (study.name, "-o", "out", "--scheduler", scheduler)
    driver = start(*words, folder=tmp_path)
    until(lambda: len(results(tmp_path)) >= 2, "some results")
    driver.send_signal(signal.SIGKILL)
    driver.communicate()
    until(lambda: not workers_of(out), "the workers come to rest")
    before = results(tmp_path)
    assert 2 <= len(before) < 8
    assert not (out / TABLE).exists()
    ended = sweep(*words, folder=tmp_path)
    assert ended.code == EXIT_PASSED, ended.stderr
    assert f"{len(before)} of 8 results exist" in ended.stdout
    after = results(tmp_path)
    assert len(after) == 8
    assert {path: after[path] for path in before} == before  # nothing was done again
    pool = sweep(study.name, "-o", "pool", folder=tmp_path)
    assert pool.code == EXIT_PASSED, pool.stderr
    assert table(out) == table(tmp_path / "pool")
    assert nothing_left(tmp_path)
