"""Work beside the rest of a run, in threads: most of it is in libraries that let others run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from typing import Any, TypeVar

from inim.backend.machine import cpu_count

__all__ = ["Begin", "beside"]

_Found = TypeVar("_Found")
#: Begins a call, `begin(function, *arguments)`; its result is that of the `Future` it returns.
Begin = Callable[..., "Future[Any]"]


@contextmanager
def beside(most: int | None = None) -> Iterator[Begin]:
    """Threads, one per processor but no more than `most`; the block ends when all are idle.

    Where that leaves one, there is none: calls are made as they are begun, and never two at once.
    """
    count = cpu_count() if most is None else min(cpu_count(), most)
    if count < 2:
        yield _at_once
        return
    threads = ThreadPoolExecutor(count, "beside")

    def begin(function: Callable[..., _Found], *arguments: Any) -> Future[_Found]:
        # With this thread's context, which knows the store in use.
        return threads.submit(copy_context().run, function, *arguments)

    try:
        yield begin
    finally:
        threads.shutdown(cancel_futures=True)


def _at_once(function: Callable[..., _Found], *arguments: Any) -> Future[_Found]:
    done: Future[_Found] = Future()
    done.set_result(function(*arguments))
    return done
