"""Execution of sweeps: dask tasks, on this machine or on a cluster.

A unit is one dask task. On one machine, scheduler and worker run in this process, and each task
reserves its share of the worker's memory. Results return through dask. Effects of a crash
(distributed 2024.1 to 2026.8):

* If a worker dies, the scheduler gives its task to another worker, up to
  `distributed.scheduler.allowed-failures` (3) times, and then reports a `KilledWorker`. No retry
  is therefore needed here, and a unit that kills four workers has failed.
* If native code crashes, only our own child process dies, not dask's worker: this is a result.
* If the client dies, its waiting tasks are dropped. A running task finishes on its worker, whose
  result cache keeps its images and scores. Keys identify the work, so a run that requests a task
  still running joins it and starts no second one.
"""

import copy
import logging
import queue
import socket
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from typing import Any, NamedTuple

from inim.apps.sweep.unit import SweepTask, attempt
from inim.system.cache import value_digest
from inim.system.errors import InimError, UsageError
from inim.system.process import machine
from inim.system.process.printing import printable
from inim.system.process.python_process import configuration_hidden, end_process

# How often the connection to the scheduler is checked.
_TICK_S = 0.5


def choose_slots(workers: int | None, threads: int | None, cores: int) -> tuple[int, int]:
    """Number of workers and threads of each; missing choices follow from the number of cores.

    A validation spends more than half of its time on one thread: scoring, compiling, writing
    images. So one worker per core is faster than one with all cores (docs/how-to/sweep.md).
    """
    for option, value in (("--workers", workers), ("--threads", threads)):
        if value is not None and value < 1:
            raise UsageError(f"{option} {value}: must be at least 1")
    if workers is None:
        workers = max(1, cores // (threads or 1))
    return workers, threads or max(1, cores // workers)


_ANSWERS_WITHIN_S = 10
# A dask worker with several threads runs several tasks at once; on a cluster, a validation needs
# all cores of its worker.
_ONE_AT_A_TIME = threading.Lock()
# The resource of the worker on this machine that tasks share.
_MEMORY = "memory"
# Processes of the tasks on this machine; no more of them start once the sweep has ended.
_CHILDREN: list[subprocess.Popen[bytes]] = []
_ENDED = threading.Event()


class Progress:
    """Progress of a sweep: a line for each finished task, and a bar on a terminal.

    With `quiet`, there are neither lines nor a bar.
    """

    def __init__(self, total: int, *, quiet: bool = False) -> None:
        from tqdm import tqdm

        self._quiet = quiet
        self._bar = tqdm(
            total=total,
            disable=quiet or not total or not sys.stderr.isatty(),
            leave=False,
            dynamic_ncols=True,
            smoothing=0,
            file=sys.stderr,
        )
        self._counts = (f"[{n:{len(str(total))}}/{total}]" for n in range(1, total + 1))

    def report_end(self, label: str, seconds: float, error: str) -> None:
        """Report a finished task, or a failed one with its error message."""
        self._bar.update()
        failure = f"  FAILED: {error}" if error else ""
        self.say(f"{next(self._counts)} {seconds:7.1f} s  {label}{failure}")

    def say(self, line: str) -> None:
        """Print a line above the bar."""
        if self._quiet:
            return
        self._bar.clear()
        try:
            print(printable(line), flush=True)
        except OSError:  # a closed reader or a full disk must not stop the sweep
            self._quiet = True
        self._bar.refresh()

    def close(self) -> None:
        """Remove the bar."""
        self._bar.close()


def check_dask() -> None:
    """Raise `UsageError` with the installation command if dask.distributed is missing."""
    try:
        with configuration_hidden():
            import distributed  # noqa: F401
    except ImportError:
        raise UsageError(
            "sweeps run on dask.distributed, which is not installed: pip install 'inim[sweep]'"
        ) from None


class Outcome(NamedTuple):
    """Outcome of a task: its time, and either the text of its `report.json` or its error."""

    seconds: float
    report: str = ""
    error: str = ""


#: Receives each finished task.
OnEnd = Callable[[SweepTask, Outcome], object]


def on_worker(task: SweepTask, alone: bool = True) -> Outcome:
    """Run one task on a dask worker, in a separate process.

    With `alone`, wait until no other task runs on this dask worker, as on a cluster.
    """
    with _ONE_AT_A_TIME if alone else nullcontext():
        if _ENDED.is_set():
            return Outcome(0.0, error="the sweep has ended")
        started = time.monotonic()
        report = error = ""
        try:
            report = attempt(task, None if alone else _record_child)
        except InimError as failure:
            error = str(failure)
    return Outcome(time.monotonic() - started, report, error)


def _record_child(process: subprocess.Popen[bytes]) -> None:
    _CHILDREN.append(process)
    if _ENDED.is_set():
        end_process(process)


def run_tasks(
    tasks: Sequence[SweepTask],
    scheduler: str | None,
    workers: int,
    on_end: OnEnd,
    say: Callable[[str], object],
) -> None:
    """Run tasks on the workers of a scheduler, or on this machine as far as the memory permits.

    `scheduler` is an address, `tcp://HOST:PORT`; `workers` is the largest number of simultaneous
    tasks on this machine. `on_end` receives each task when it has ended, and `say` a line for the
    user. Raises `UsageError` if no scheduler answers.
    """
    limit = machine.memory_limit_bytes() or sys.maxsize
    connection = _local(workers, limit) if scheduler is None else _client(scheduler)
    _ENDED.clear()
    with connection as client:
        if not client.nthreads():
            say(f"no worker yet; start some: dask worker {scheduler} --nthreads 1")

        ended: queue.Queue[Any] = queue.Queue()
        futures = {}
        for task in tasks:
            if scheduler is None:
                memory = {_MEMORY: min(task.memory_bytes, limit)}
                here = {"alone": False, "resources": memory}
            else:
                here = {}
            future = client.submit(on_worker, task, key=_key(task), pure=False, **here)
            futures[future.key] = task
            future.add_done_callback(ended.put)
        try:
            _collect(client, futures, ended, on_end)
        finally:  # after an interrupt, some tasks still run
            _ENDED.set()
            while _CHILDREN:
                end_process(_CHILDREN.pop())


def _collect(
    client: Any, futures: dict[str, SweepTask], ended: queue.Queue[Any], on_end: OnEnd
) -> None:
    """Wait for all tasks, in the order in which they finish."""
    left = dict(futures)
    while left:
        try:
            future = ended.get(timeout=_TICK_S)
        except queue.Empty:
            if client.status not in ("running", "connecting"):
                for task in left.values():
                    on_end(task, Outcome(0.0, error="the scheduler went away; run the sweep again"))
                return
            continue
        on_end(left.pop(future.key), _outcome_of(future))


def _outcome_of(future: Any) -> Outcome:
    """Result of `on_worker`, or an error message if dask lost the task."""
    if future.status == "finished":
        outcome: Outcome = future.result()
        return outcome
    if future.status == "error":
        exception = future.exception()
        words = " ".join(f"{type(exception).__name__}: {exception}".split())[:400]
        return Outcome(0.0, error=words)
    return Outcome(0.0, error=f"{future.status} by the scheduler; run the sweep again")


def _key(task: SweepTask) -> str:
    """Name of a task on the scheduler, derived from its work."""
    place = value_digest([str(task.request.out), task.keep_report])
    return f"inim-{task.hash}-{place[:8]}"


def check_answers(scheduler: str) -> None:
    """Raise `UsageError` if no scheduler answers; a dask client would wait and print tracebacks."""
    host, _, port = scheduler.rpartition("://")[2].rpartition(":")
    if not (host and port.isdigit()):
        raise UsageError(
            f"--scheduler {scheduler}: write tcp://HOST:PORT, as `dask scheduler` prints it"
        )
    try:
        socket.create_connection((host.strip("[]"), int(port)), _ANSWERS_WITHIN_S).close()
    except (OSError, OverflowError) as error:
        raise UsageError(
            f"--scheduler {scheduler}: no answer ({error}); start one: dask scheduler"
        ) from None


@contextmanager
def _local(workers: int, memory_bytes: int) -> Iterator[Any]:
    """Client of a scheduler and a worker in this process.

    Both always start an HTTP server: on a free port that only this machine reaches, without pages.
    """
    from distributed import Client, Scheduler, SpecCluster, Worker

    _silence_dask()
    common = {"protocol": "inproc://", "dashboard": False, "dashboard_address": "127.0.0.1:0"}
    own = {"nthreads": workers, "memory_limit": 0, "resources": {_MEMORY: memory_bytes}}
    scheduler = {"cls": Scheduler, "options": common}
    worker = {"cls": Worker, "options": common | own}
    with (
        _default_configuration(),
        SpecCluster(scheduler=scheduler, workers={0: worker}) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client


@contextmanager
def _default_configuration() -> Iterator[None]:
    """Use dask's own defaults without pages, and none of the user's files and variables."""
    from dask import config

    before = copy.deepcopy(config.config)
    config.refresh(paths=[], env={})
    try:
        with config.set(
            {f"distributed.{node}.http.routes": [] for node in ("scheduler", "worker")}
        ):
            yield
    finally:
        config.config.clear()
        config.config.update(before)


def _silence_dask() -> None:
    for name in ("distributed", "tornado", "asyncio"):  # `Progress` prints every error
        logging.getLogger(name).setLevel(logging.CRITICAL)


@contextmanager
def _client(scheduler: str) -> Iterator[Any]:
    """Client of the scheduler at an address."""
    from distributed import Client

    _silence_dask()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about different versions, which are part of the key
        try:
            client = Client(scheduler, timeout=_ANSWERS_WITHIN_S, set_as_default=False)
        except (OSError, ValueError) as error:
            words = " ".join(str(error).split())[:160]
            raise UsageError(
                f"--scheduler {scheduler}: not a dask scheduler ({words}); give the address that "
                "`dask scheduler` prints"
            ) from None
    with client:
        yield client
