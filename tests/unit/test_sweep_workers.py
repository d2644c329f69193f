"""The engine on this machine: how many tasks at once, by cores and memory; its progress."""

import signal
import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest

from inim.apps.sweep import unit as sweep_unit
from inim.apps.sweep import workers as sweep_workers
from inim.apps.sweep.unit import SweepTask, attempt
from inim.apps.sweep.workers import Outcome, Progress, choose_slots, run_tasks
from inim.pipeline.request import Request
from inim.system.errors import FileError, UsageError, WorkerError

GIB = 2**30


def make(unit: str, memory_bytes: int = GIB, out: Path = Path("out"), keep=False) -> SweepTask:
    request = Request(Path("/s.xml"), out, algorithms=("template",))
    return SweepTask(unit, f"label {unit}", request, {"scene": "x"}, keep, 2, memory_bytes)


def run(tasks: list[SweepTask], workers: int = 1) -> dict[str, Outcome]:
    """Outcomes of tasks on this machine, by unit."""
    outcomes: dict[str, Outcome] = {}
    run_tasks(tasks, None, workers, lambda t, o: outcomes.__setitem__(t.hash, o), lambda _: None)
    return outcomes


@pytest.mark.parametrize(
    ("workers", "threads", "cores", "chosen"),
    [
        (None, None, 2, (2, 1)),
        (None, None, 1, (1, 1)),
        (1, None, 8, (1, 8)),
        (3, None, 8, (3, 2)),
        (None, 4, 8, (2, 4)),
        (None, 16, 8, (1, 16)),
        (5, 1, 2, (5, 1)),
    ],
)
def test_defaults_follow_from_the_cores(workers, threads, cores, chosen):
    assert choose_slots(workers, threads, cores) == chosen


class Crowd:
    """Stands in for the work: counts who is at work at once, and what memory they hold.

    Work does not end before `least` were at work at once.
    """

    def __init__(self, least):
        self.least, self.enough = least, threading.Event()
        self.lock, self.now, self.most, self.bytes, self.most_bytes = threading.Lock(), 0, 0, 0, 0
        self.done: list[str] = []

    def __call__(self, task, on_start):
        with self.lock:
            self.now, self.bytes = self.now + 1, self.bytes + task.memory_bytes
            self.most, self.most_bytes = max(self.most, self.now), max(self.most_bytes, self.bytes)
            if self.now >= self.least:
                self.enough.set()
        assert self.enough.wait(60)
        time.sleep(0.05)  # others may begin, wrongly
        with self.lock:
            self.now, self.bytes = self.now - 1, self.bytes - task.memory_bytes
            self.done.append(task.hash)
        return f"report of {task.hash}"


def crowd_of(monkeypatch, tasks, workers, limit, least):
    crowd = Crowd(least)
    monkeypatch.setattr(sweep_workers, "attempt", crowd)
    monkeypatch.setattr(sweep_workers.machine, "memory_limit_bytes", lambda: limit)
    outcomes = run(tasks, workers)
    assert sorted(crowd.done) == sorted(t.hash for t in tasks)
    assert all(o.report == f"report of {name}" and not o.error for name, o in outcomes.items())
    return crowd


def test_as_many_at_once_as_there_are_workers(monkeypatch):
    assert crowd_of(monkeypatch, [make(str(i)) for i in range(6)], 3, 0, least=3).most == 3


def test_never_more_at_once_than_memory_holds(monkeypatch):
    sizes = [1, 5, 2, 4, 3]
    tasks = [make(str(size), size * GIB) for size in sizes]
    crowd = crowd_of(monkeypatch, tasks, 4, 6 * GIB, least=2)
    assert crowd.most_bytes <= 6 * GIB


def test_a_unit_too_large_for_a_share_runs_alone(monkeypatch):
    crowd = crowd_of(monkeypatch, [make(str(i), 9 * GIB) for i in range(3)], 4, 6 * GIB, least=1)
    assert crowd.most == 1


def test_a_failing_unit_does_not_stop_the_others(monkeypatch):
    def fails(task, on_start):
        if task.hash == "1":
            raise WorkerError("it broke")
        return "a report"

    monkeypatch.setattr(sweep_workers, "attempt", fails)
    outcomes = run([make(str(i)) for i in range(3)])
    assert {name: (o.report, o.error) for name, o in outcomes.items()} == {
        "0": ("a report", ""), "1": ("", "it broke"), "2": ("a report", ""),
    }  # fmt: skip


def test_progress_lists_each_task_and_its_error(capsys):
    with closing(Progress(2)) as progress:
        progress.report_end("label 0", 1.5, "")
        progress.report_end("label 1", 2.5, "it broke")
    first, second = capsys.readouterr().out.splitlines()
    assert first == "[1/2]     1.5 s  label 0"
    assert second == "[2/2]     2.5 s  label 1  FAILED: it broke"


def listening() -> list[tuple[str, int]]:
    """Addresses in hexadecimal digits, and ports, at which this process listens."""
    names = [path.resolve().name for path in Path("/proc/self/fd").iterdir()]
    sockets = {name.removeprefix("socket:[").rstrip("]") for name in names}
    rows = [
        line.split()
        for table in ("tcp", "tcp6")
        for line in Path("/proc/net", table).read_text().splitlines()[1:]
    ]
    places = [row[1].split(":") for row in rows if row[3] == "0A" and row[9] in sockets]
    return [(address, int(port, 16)) for address, port in places]


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="reads Linux's list of sockets")
def test_a_sweep_listens_on_this_machine_only_and_serves_no_page(monkeypatch):
    before, places = listening(), []

    def visit(task, on_start):
        for address, port in sorted({*listening()} - {*before}):
            places.append(address)
            for page in ("", "status", "health", "metrics", "info/main/workers.html", "json"):
                with pytest.raises(HTTPError, match="404"):
                    urlopen(f"http://127.0.0.1:{port}/{page}", timeout=10)
        return ""

    monkeypatch.setattr(sweep_workers, "attempt", visit)
    assert run([make("1")])["1"].error == ""
    assert set(places) == {"0100007F"}  # 127.0.0.1


def test_the_user_s_configuration_of_dask_does_not_apply(monkeypatch, tmp_path):
    """A preload is a file that dask executes."""
    from dask import config

    (tmp_path / "preload.py").write_text(f"open({str(tmp_path / 'executed')!r}, 'w').close()")
    monkeypatch.setattr(sweep_workers, "attempt", lambda *_: "")
    preload = {f"distributed.{node}.preload": ["preload.py"] for node in ("scheduler", "worker")}
    monkeypatch.chdir(tmp_path)
    with config.set(preload | {"mine": 1}):
        assert run([make("1")])["1"].error == ""
        assert config.get("mine") == 1
        assert config.get("distributed.worker.preload") == ["preload.py"]
    assert not (tmp_path / "executed").exists()


def test_an_interrupt_ends_running_tasks(monkeypatch):
    children = []

    def works(make_unit, on_start):
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
        on_start(child)
        children.append(child)
        child.wait()

    def interrupted(*_):
        while not children:
            time.sleep(0.01)
        raise KeyboardInterrupt

    monkeypatch.setattr(sweep_workers, "attempt", works)
    monkeypatch.setattr(sweep_workers, "_collect", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run([make("1"), make("2")])
    assert [child.returncode for child in children] == [-signal.SIGTERM]


def test_a_worker_s_death_is_tried_once_more_and_its_own_error_is_not(monkeypatch):
    for error, times in ((WorkerError("died"), 2), (UsageError("wrong"), 1)):
        tries = []

        def carry_out(make_unit, on_start, error=error, tries=tries):
            tries.append(make_unit)
            raise error

        monkeypatch.setattr(sweep_unit, "_carry_out", carry_out)
        with pytest.raises(type(error)):
            attempt(make("1"))
        assert len(tries) == times


def test_a_folder_for_reports_that_a_machine_does_not_see_is_named(tmp_path):
    with pytest.raises(FileError, match="all machines share"):
        attempt(make("1", out=tmp_path / "elsewhere", keep=True))
