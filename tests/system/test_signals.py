"""SIGINT, SIGTERM and SIGKILL at any moment of a run, to the process alone and to its whole group.

Expected: the run ends with 130 or 143, and one line or none; no process is left; staging folders
are removed, after SIGKILL by the next run; the report's folder holds the report of before or the
new one, whole, or after SIGKILL, none.
"""

import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from inim.system.errors import EXIT_BACKEND, EXIT_INTERNAL, EXIT_PASSED
from tests.system.conftest import (
    SMALLEST,
    assert_one_line,
    assert_whole,
    command,
    files_in,
    run_child,
    write_scene,
)
from tests.unit.test_interrupts import LINE, hear

on_linux = pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="finds it in /proc")

# --- At chosen moments --------------------------------------------------------------------------

#: Sends SIGINT when a module is looked for.
AT_IMPORT = """
import os, signal, sys
wanted = sys.argv.pop(1)
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == wanted:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
from inim.cli.program import run
run()
"""


@pytest.mark.parametrize(
    "module",
    [
        "inim.cli.main",
        "argparse",
        "inim.cli.validate",
        "numpy",
        "numpy.linalg",
        "inim.system.worker.supervisor",
    ],
)
def test_interrupt_while_modules_load_is_one_line(tmp_path, module):
    """Some libraries turn what is raised while they load into errors of their own."""
    scene = write_scene(tmp_path)
    words = [sys.executable, "-c", AT_IMPORT, module, *command(scene, "-o", "out")[2:]]
    words[4] = "validate"
    ended = run_child(words, 60, cwd=tmp_path, preexec_fn=hear)
    assert (ended.code, ended.stderr) == (130, LINE)
    assert list(tmp_path.iterdir()) == [scene]


# --- At random moments --------------------------------------------------------------------------


class Run:
    """A run in a process group of its own."""

    def __init__(self, words: list[str], folder: Path, **variables: str) -> None:
        self.process = subprocess.Popen(
            words, cwd=folder, start_new_session=True, preexec_fn=hear, text=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            env={**os.environ, **variables},
        )  # fmt: skip

    def children(self) -> list[int]:
        pid = self.process.pid
        try:
            return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
        except OSError:
            return []

    def end(self, number: int, whom: str) -> None:
        """Send a signal to all, the parent or the worker, and wait until no process is left."""
        pid, workers = self.process.pid, self.children()
        try:
            if whom == "all":
                os.killpg(pid, number)
            else:
                os.kill(workers[0] if whom == "worker" and workers else pid, number)
        except ProcessLookupError:
            pass
        self.errors = self.process.communicate(timeout=60)[1]
        self.code = self.process.returncode
        # A worker notices by itself that its parent was killed, and matplotlib's `fc-list` ends.
        is_by_itself = ("fc-list", "python") if number == signal.SIGKILL else ("fc-list",)
        patience = time.monotonic() + 60
        while left := members(pid):
            others = [name for name in left if not name.startswith(is_by_itself)]
            assert not others and time.monotonic() < patience, f"outlived the program: {left}"
            time.sleep(0.02)


def members(group: int) -> list[str]:
    """Processes of a group that still run.

    Zombies have ended: `fc-list`, which matplotlib starts in a worker, waits for init to reap it if
    the worker is killed meanwhile.
    """
    running = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            name, _, fields = path.read_text().partition(" (")[2].rpartition(") ")
            state, _, process_group = fields.split()[:3]
            if int(process_group) == group and state != "Z":
                running.append(name)
    return running


@on_linux
@pytest.mark.parametrize(
    ("number", "whom", "code", "says"),
    [
        (signal.SIGKILL, "worker", EXIT_BACKEND, "killed"),
        (signal.SIGSEGV, "worker", EXIT_INTERNAL, "SIGSEGV"),
        (signal.SIGINT, "all", 130, LINE),
        (signal.SIGTERM, "parent", 143, ""),
        (signal.SIGKILL, "parent", -9, ""),
        (signal.SIGHUP, "parent", 129, ""),
    ],
)
def test_end_of_either_process_ends_the_other_and_leaves_nothing(
    tiny_scene, number, whom, code, says
):
    """Ends a run that would take minutes."""
    run = Run(command(tiny_scene, "-o", "out", view_spp="1000000"), tiny_scene.parent)
    while not run.children():
        time.sleep(0.02)
    run.end(number, whom)
    assert run.code == code
    if whom == "worker":
        assert_one_line(run.errors, [says])
    else:
        assert run.errors == says
    left = {p for p in tiny_scene.parent.iterdir() if p != tiny_scene}
    # After SIGKILL of the parent, the next run removes the staging folder.
    killed = (number, whom) == (signal.SIGKILL, "parent")
    assert {p.suffix for p in left} <= ({".partial"} if killed else set())


@dataclass
class Bench:
    """Runs into one folder, ended at random moments; seeds tell their reports apart."""

    folder: Path
    rng: random.Random
    seed: int = 0
    seconds: float = 0.0

    def __post_init__(self) -> None:
        self.scene = write_scene(self.folder)
        self.out = self.folder / "out"
        self.places = {
            "INIM_CACHE": str(self.folder / "cache"),
            "XDG_CACHE_HOME": str(self.folder / "home"),
            "TMPDIR": str(self.folder / "tmp"),
        }
        (self.folder / "tmp").mkdir()
        self.run_to_the_end()

    def start(self) -> Run:
        self.seed += 1
        words = command(self.scene, "-o", "out", seed=str(self.seed), **SMALLEST)
        return Run(words, self.folder, **self.places)

    def run_to_the_end(self) -> None:
        started = time.perf_counter()
        run = self.start()
        errors = run.process.communicate(timeout=120)[1]
        self.seconds = time.perf_counter() - started
        assert (run.process.returncode, errors) == (EXIT_PASSED, "")
        assert self.seed_of_report() == self.seed
        self.assert_nothing_left()

    def seed_of_report(self) -> int | None:
        """Seed of the run whose whole report is in the folder; None without a report."""
        if not (self.out / "report.json").exists():
            return None
        data = assert_whole(self.out)
        files = json.loads((self.out / ".report-files.json").read_text())
        assert files_in(self.out) == set(data["files"]) == {*files}
        return int(data["settings"]["seed"])

    def assert_nothing_left(self) -> None:
        names = {p.name for p in self.folder.iterdir()}
        assert names <= {"out", "cache", "home", "tmp", self.scene.name}
        assert not list((self.folder / "tmp").glob("*.partial"))

    def moment(self) -> float:
        """Some while Python starts, some near the end, when files move."""
        late, whole = self.rng.uniform(0.8, 1.05), self.rng.uniform(0, 1.05)
        return self.rng.choice((late * self.seconds, whole * self.seconds, 0.3 * whole))

    def end_at_random(self, number: signal.Signals, whom: str) -> str:
        """End a run, with or without a report to replace and results kept; what came of it."""
        if self.rng.random() < 0.4:
            shutil.rmtree(self.out, ignore_errors=True)  # else there is a report to replace
        if self.rng.random() < 0.5:
            for name in ("cache", "home"):  # what is found there need not be tried and rendered
                shutil.rmtree(self.folder / name, ignore_errors=True)
        return self.end_one(number, whom, self.moment())

    def end_one(self, number: signal.Signals, whom: str, after_s: float) -> str:
        """End a run; what came of it, in a word."""
        before, run = self.seed_of_report(), self.start()
        time.sleep(after_s)
        run.end(number, whom)
        after = self.seed_of_report()
        if number == signal.SIGKILL:
            assert after in (before, self.seed, None)
            return "none" if after is None else "old" if after == before else "new"
        assert after in (before, self.seed), "the report of before is gone"
        self.assert_nothing_left()
        if run.code == EXIT_PASSED:
            assert (after, run.errors) == (self.seed, "")
            return "passed"
        if run.code == 128 + number:
            assert run.errors == (LINE if number == signal.SIGINT else "")
            return "ended"
        # Until the program's first line Python itself answers.
        assert run.code in (-number, 1), run.errors
        assert "/inim/cli.py" not in run.errors
        return "Python's start"


CHOICES = [
    (number, whom)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
    for whom in ("all", "parent")
] + [(signal.SIGKILL, "worker")]


@on_linux
@pytest.mark.slow
@pytest.mark.parametrize(("number", "whom"), CHOICES)
def test_runs_ended_at_random_moments_leave_nothing_behind(tmp_path, number, whom):
    bench = Bench(tmp_path, random.Random(f"{number} {whom}"))
    ends = []
    for count in range(20):
        ends.append(bench.end_at_random(number, whom))
        if count % 4 == 0 or number == signal.SIGKILL:
            bench.run_to_the_end()
    print({end: ends.count(end) for end in ends})
    assert len({*ends}) > 1, "the moments were not random"
