"""Work beside the rest of a run, in threads: most of it is in libraries that let others run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import copy_context
from functools import cache
from typing import Any, TypeVar

from inim.backend.machine import cpu_count

__all__ = ["Begin", "beside"]

_Found = TypeVar("_Found")
#: Begins a call, `begin(function, *arguments)`; its result is that of the `Future` it returns.
Begin = Callable[..., "Future[Any]"]


@contextmanager
def beside(most: int | None = None) -> Iterator[Begin]:
    """Threads, one per processor but no more than `most`; the block ends when all calls have.

    Where that leaves one, there is none: calls are made as they are begun, and never two at once.
    A call must not begin others: threads that wait for one another would wait for ever.
    """
    count = cpu_count() if most is None else min(cpu_count(), most)
    if count < 2:
        yield _at_once
        return
    threads = _threads(count)
    begun: list[Future[Any]] = []

    def begin(function: Callable[..., _Found], *arguments: Any) -> Future[_Found]:
        # With this thread's context, which knows the store in use.
        one = threads.submit(copy_context().run, function, *arguments)
        begun.append(one)
        return one

    try:
        yield begin
    finally:
        for one in begun:
            one.cancel()
        wait(begun)


@cache
def _threads(count: int) -> ThreadPoolExecutor:
    """The same ones again and again: each new thread may keep memory of its own."""
    return ThreadPoolExecutor(count, "beside")


def _at_once(function: Callable[..., _Found], *arguments: Any) -> Future[_Found]:
    done: Future[_Found] = Future()
    done.set_result(function(*arguments))
    return done
