"""Calls in threads: most of the work is in libraries that let other threads run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache
from typing import Any, TypeVar

from inim.process.machine import cpu_count

_Found = TypeVar("_Found")
#: Starts a call, `submit(function, *arguments)`; its result is that of the `Future` it returns.
Submit = Callable[..., "Future[Any]"]


@contextmanager
def threads(most: int | None = None) -> Iterator[Submit]:
    """Threads, one per processor but no more than `most`; the block ends when all calls have.

    Where that leaves one, there is none: calls are made as they are submitted, never two at once.
    A call must not submit others: threads that wait for one another would wait for ever.
    """
    count = cpu_count() if most is None else min(cpu_count(), most)
    if count < 2:
        yield _now
        return
    pool = _pool(count)
    pending: list[Future[Any]] = []

    def submit(function: Callable[..., _Found], *arguments: Any, **named: Any) -> Future[_Found]:
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


def _now(function: Callable[..., _Found], *arguments: Any, **named: Any) -> Future[_Found]:
    future: Future[_Found] = Future()
    future.set_result(function(*arguments, **named))
    return future
