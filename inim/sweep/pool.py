"""Units on this machine: as many workers at once as its cores and its memory hold."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait

from inim import backend as backends
from inim.errors import InimError, UsageError
from inim.observer import Observer
from inim.sweep.progress import Progress
from inim.sweep.task import Task, attempt

__all__ = ["choose_slots", "run_pool"]

# How often the progress's clocks move on.
_TICK_S = 0.5


def choose_slots(workers: int | None, threads: int | None, cores: int) -> tuple[int, int]:
    """Workers at once and threads of each; what the user leaves open follows from the cores.

    A validation spends more than half of its time on one thread: scoring, compiling, writing
    pictures. So a worker for each core is faster than one with them all (README, *Sweeps*).

    Raises
    ------
    UsageError
        Less than one of either.
    """
    for option, value in (("--workers", workers), ("--threads", threads)):
        if value is not None and value < 1:
            raise UsageError(f"{option} {value}: must be at least 1")
    if workers is None:
        workers = max(1, cores // (threads or 1))
    return workers, threads or max(1, cores // workers)


class _Ended(BaseException):
    """The pool is being taken down: no worker may start any more."""


class _Pool:
    """The processes at work, to be ended together."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._processes: list[subprocess.Popen[bytes]] = []
        self._closed = False

    def add(self, process: subprocess.Popen[bytes]) -> None:
        with self._lock:
            if self._closed:
                raise _Ended
            self._processes = [p for p in self._processes if p.returncode is None]
            self._processes.append(process)

    def end(self) -> None:
        """End all that run, and whatever is about to start."""
        with self._lock:
            self._closed = True
            for process in self._processes:
                process.terminate()


class _TaskObserver(Observer):
    """Shows the stages of one task."""

    def __init__(self, task: Task, progress: Progress) -> None:
        super().__init__()
        self._task, self._progress = task, progress

    def stage(self, name: str) -> None:
        """See `Observer`."""
        self._progress.stage(self._task.unit, name)


def run_pool(tasks: Sequence[Task], workers: int, progress: Progress) -> dict[str, str]:
    """Carry out tasks, so many at once, never more than memory holds.

    Parameters
    ----------
    tasks : sequence of Task
    workers : int
    progress : Progress

    Returns
    -------
    dict of str to str
        By unit, the error of each that failed.
    """
    pool, limit = _Pool(), backends.memory_limit_bytes()
    waiting, running = list(tasks), dict[Future[InimError | None], Task]()
    errors: dict[str, str] = {}
    with ThreadPoolExecutor(workers) as executor:
        try:
            while waiting or running:
                taken = sum(task.memory_bytes for task in running.values())
                while len(running) < workers and (task := _next(waiting, taken, limit, running)):
                    waiting.remove(task)
                    taken += task.memory_bytes
                    progress.began(task.unit, task.label)
                    observer = _TaskObserver(task, progress)
                    running[executor.submit(attempt, task, observer, pool.add)] = task
                done, _ = wait(running, _TICK_S, FIRST_COMPLETED)
                progress.draw()
                for future in done:
                    task = running.pop(future)
                    error = future.result()
                    if error is not None:
                        errors[task.unit] = str(error)
                    progress.ended(task.unit, task.label, errors.get(task.unit, ""))
        except BaseException:  # an interrupt: workers end with the pool, what they had is lost
            pool.end()
            raise
    return errors


def _next(
    waiting: Sequence[Task], taken: int, limit: int, running: dict[Future[InimError | None], Task]
) -> Task | None:
    """The first task that fits into what memory is left; alone, a task always fits."""
    for task in waiting:
        if not running or not limit or taken + task.memory_bytes <= limit:
            return task
    return None
