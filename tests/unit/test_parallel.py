"""Calls in threads: results, errors, and how much at a time."""

import threading
import time
from concurrent.futures import Future, wait

import pytest

from inim.system.process import threads as module
from inim.system.process.threads import threads


@pytest.fixture(params=[1, 4], ids=["one processor", "four"])
def processors(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(module, "cpu_count", lambda: request.param)
    return int(request.param)


def test_results_are_those_of_their_calls(processors):
    def late(number: int) -> int:
        time.sleep(0.02 * (number == 0))  # the first ends last
        return number * number

    with threads() as submit:
        begun = [submit(late, number) for number in range(8)]
        assert [future.result() for future in begun] == [number * number for number in range(8)]


@pytest.mark.parametrize("most", [None, 0, 1, 2])
def test_never_more_at_once_than_asked_for(processors, most):
    most_seen, now, lock = 0, 0, threading.Lock()

    def call() -> None:
        nonlocal most_seen, now
        with lock:
            now += 1
            most_seen = max(most_seen, now)
        time.sleep(0.01)
        with lock:
            now -= 1

    with threads(most) as submit:
        for _ in range(8):
            submit(call)
    assert now == 0
    assert most_seen <= max(1, min(processors, processors if most is None else most))


def test_alone_everything_is_done_in_the_callers_thread(monkeypatch):
    monkeypatch.setattr(module, "cpu_count", lambda: 64)
    with threads(1) as submit:
        assert submit(threading.current_thread).result() is threading.current_thread()


def test_errors_are_raised_and_waiting_tasks_are_dropped(processors, monkeypatch):
    begun, dropped = [], threading.Event()

    def wait_for_begun(futures: list[Future]) -> None:
        dropped.set()
        wait(futures)

    monkeypatch.setattr(module, "wait", wait_for_begun)

    def fail() -> None:
        raise ValueError("no")

    def run(*numbers: int) -> None:
        with threads() as submit:
            first = submit(fail)
            for number in numbers:
                submit(lambda number: (begun.append(number), dropped.wait()), number)
            first.result()

    with pytest.raises(ValueError, match="no"):
        run(*range(100))
    assert len(begun) <= processors
