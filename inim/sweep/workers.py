"""Units on this machine, as many workers at once as its cores and its memory hold; or on a cluster.

On a cluster a unit is one dask task, on workers that share the sweep's folder. What dask does when
something dies (distributed 2024.1 to 2026.8), and what follows for us:

* A worker that dies takes its task along; the scheduler gives the task to another worker, up to
  `distributed.scheduler.allowed-failures` (3) times, then calls it a `KilledWorker`. So nothing
  has to be retried here, and a unit that takes down four workers is a failed one.
* Native code that dies takes our own child process along, not dask's worker: that is a result.
* A client that dies has its waiting tasks forgotten. One in work runs to its end on its worker,
  which puts its result into the shared folder: the next run finds it there. Keys name what is done,
  so a run that asks for a task still in work is given that one and starts no second.
"""

from __future__ import annotations

import hashlib
import logging
import queue
import socket
import subprocess
import threading
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import partial
from typing import Any

from inim import backend as backends
from inim.errors import InimError, UsageError
from inim.sweep.progress import Progress
from inim.sweep.task import Task, attempt

# How often the progress's clocks move on.
_TICK_S = 0.5


def choose_slots(workers: int | None, threads: int | None, cores: int) -> tuple[int, int]:
    """Workers at once and threads of each; what the user leaves open follows from the cores.

    A validation spends more than half of its time on one thread: scoring, compiling, writing
    pictures. So a worker for each core is faster than one with them all (docs/how-to/sweep.md).

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
                    on_stage = partial(progress.stage, task.unit)
                    running[executor.submit(attempt, task, pool.add, on_stage)] = task
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


_TOPIC = "inim-sweep"
_ANSWERS_WITHIN_S = 10
# A dask worker with several threads takes as many tasks; a validation wants its cores to itself.
_ONE_AT_A_TIME = threading.Lock()


def check_dask() -> None:
    """Raise the `UsageError` with the line to type where dask.distributed is missing."""
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise UsageError(
            "--scheduler needs dask.distributed, which is not installed: pip install 'inim[dask]'"
        ) from None


def on_worker(task: Task) -> str:
    """What a dask worker does: carry out one task, in a process of its own; the error, or ""."""
    from distributed import get_worker

    worker = get_worker()

    def on_stage(name: str) -> None:
        event = {"unit": task.unit, "stage": name, "where": str(worker.address)}
        worker.log_event(_TOPIC, event)

    with _ONE_AT_A_TIME:
        error = attempt(task, on_stage=on_stage)
    return "" if error is None else str(error)


def run_cluster(tasks: Sequence[Task], scheduler: str, progress: Progress) -> dict[str, str]:
    """Carry out tasks on the workers of a scheduler.

    Parameters
    ----------
    tasks : sequence of Task
    scheduler : str
        Its address, `tcp://HOST:PORT`.
    progress : Progress

    Returns
    -------
    dict of str to str
        By unit, the error of each that failed.

    Raises
    ------
    UsageError
        No scheduler answers there.
    """
    by_unit = {task.unit: task for task in tasks}
    with _client(scheduler) as client:
        if not client.nthreads():
            progress.say(f"no worker yet; start some: dask worker {scheduler} --nthreads 1")

        def hear(event: Any) -> None:
            said = event[1]
            task = by_unit.get(said["unit"])
            if task is not None:
                progress.began(task.unit, task.label, said["where"])
                progress.stage(task.unit, said["stage"])

        client.subscribe_topic(_TOPIC, hear)
        ended: queue.Queue[Any] = queue.Queue()
        futures = {}
        for task in tasks:
            future = client.submit(on_worker, task, key=_key(task), pure=False)
            futures[future.key] = task
            future.add_done_callback(ended.put)
        return _collect(client, futures, ended, progress)


def _collect(
    client: Any, futures: dict[str, Task], ended: queue.Queue[Any], progress: Progress
) -> dict[str, str]:
    """Wait for every task, in whatever order they end."""
    errors: dict[str, str] = {}
    left = dict(futures)
    while left:
        progress.draw()
        try:
            future = ended.get(timeout=_TICK_S)
        except queue.Empty:
            if client.status not in ("running", "connecting"):
                for task in left.values():
                    errors[task.unit] = "the scheduler went away; run the sweep again"
                return errors
            continue
        task = left.pop(future.key)
        error = _error_of(future)
        if error:
            errors[task.unit] = error
        progress.ended(task.unit, task.label, error)
    return errors


def _error_of(future: Any) -> str:
    """The sentence a task left, or one on how dask lost it; empty where it is done."""
    if future.status == "finished":
        return str(future.result())
    if future.status == "error":
        exception = future.exception()
        return " ".join(f"{type(exception).__name__}: {exception}".split())[:400]
    return f"{future.status} by the scheduler; run the sweep again"


def _key(task: Task) -> str:
    """A task's name on the scheduler: what it computes, whoever asks for it."""
    words = "\0".join((str(task.request.out), *task.algorithms))
    return f"inim-{task.unit}-{hashlib.sha256(words.encode()).hexdigest()[:8]}"


def check_answers(scheduler: str) -> None:
    """Raise the `UsageError` that fits where nobody listens at a scheduler's address.

    A dask client that cannot connect takes twice its patience to give up, and prints tracebacks.
    """
    host, _, port = scheduler.rpartition("://")[2].rpartition(":")
    if not (host and port.isdigit()):
        raise UsageError(
            f"--scheduler {scheduler}: write tcp://HOST:PORT, as `dask scheduler` says"
        )
    try:
        socket.create_connection((host.strip("[]"), int(port)), _ANSWERS_WITHIN_S).close()
    except (OSError, OverflowError) as error:
        raise UsageError(
            f"--scheduler {scheduler}: nobody answers there ({error}); start one: dask scheduler"
        ) from None


@contextmanager
def _client(scheduler: str) -> Iterator[Any]:
    from distributed import Client

    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # our own lines name every error
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of versions that differ; ours are in every key
        try:
            client = Client(scheduler, timeout=_ANSWERS_WITHIN_S, set_as_default=False)
        except (OSError, ValueError) as error:
            words = " ".join(str(error).split())[:160]
            raise UsageError(
                f"--scheduler {scheduler}: what answers there is no dask scheduler ({words})"
            ) from None
    with client:
        yield client
