"""Calls in threads, for libraries that release the interpreter lock."""

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache
from typing import Any, TypeVar

from inim.system.process.machine import cpu_count

_Result = TypeVar("_Result")
#: Starts a call, `submit(function, *arguments)`; its result is that of the `Future` it returns.
Submit = Callable[..., "Future[Any]"]


class OneThread(ThreadPoolExecutor):
    """A thread for calls, one after the other; the end of its block discards the waiting calls."""

    def __init__(self, name: str) -> None:
        super().__init__(1, name)

    def __exit__(self, *_: object) -> None:
        self.shutdown(cancel_futures=True)


@contextmanager
def threads(most: int | None = None) -> Iterator[Submit]:
    """Threads, one per processor but at most `most`; the block waits for all calls.

    With a single thread, calls run when they are submitted. A call must not submit others, because
    threads that wait for each other would never end.
    """
    count = cpu_count() if most is None else min(cpu_count(), most)
    if count < 2:
        yield _run_now
        return
    pool = _pool(count)
    pending: list[Future[Any]] = []

    def submit(function: Callable[..., _Result], *arguments: Any, **named: Any) -> Future[_Result]:
        future = pool.submit(function, *arguments, **named)
        pending.append(future)
        return future

    try:
        yield submit
    finally:
        for future in pending:
            future.cancel()
        wait(pending)


@cache
def _pool(count: int) -> ThreadPoolExecutor:
    """Pool of reused threads: each new thread may keep memory."""
    return ThreadPoolExecutor(count, "inim")


def _run_now(function: Callable[..., _Result], *arguments: Any, **named: Any) -> Future[_Result]:
    future: Future[_Result] = Future()
    future.set_result(function(*arguments, **named))
    return future
