"""Work beside the rest of a run: results, errors, and how much at a time."""

import threading
import time

import numpy as np
import pytest

from inim import parallel as module
from inim.cache.store import Store, remembered, use_store
from inim.parallel import beside


@pytest.fixture(params=[1, 4], ids=["one processor", "four"])
def processors(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(module, "cpu_count", lambda: request.param)
    return int(request.param)


def test_results_are_those_of_their_calls(processors):
    def late(number: int) -> int:
        time.sleep(0.02 * (number == 0))  # the first ends last
        return number * number

    with beside() as begin:
        begun = [begin(late, number) for number in range(8)]
        assert [one.result() for one in begun] == [number * number for number in range(8)]


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

    with beside(most) as begin:
        for _ in range(8):
            begin(call)
    assert now == 0
    assert most_seen <= max(1, min(processors, processors if most is None else most))


def test_alone_everything_is_done_in_the_callers_thread(monkeypatch):
    monkeypatch.setattr(module, "cpu_count", lambda: 64)
    with beside(1) as begin:
        assert begin(threading.current_thread).result() is threading.current_thread()


def test_errors_come_out_and_what_has_not_begun_is_dropped(processors):
    begun = []

    def fail() -> None:
        raise ValueError("no")

    def run(*numbers: int) -> None:
        with beside() as begin:
            first = begin(fail)
            for number in numbers:
                begin(lambda number: (time.sleep(0.05), begun.append(number)), number)
            first.result()

    with pytest.raises(ValueError, match="no"):
        run(*range(100))
    assert len(begun) <= processors


def test_the_store_in_use_is_known_beside(processors, tmp_path):
    made = []

    def make() -> np.ndarray:
        made.append(1)
        return np.arange(3)

    with use_store(Store(tmp_path, 2**20)), beside() as begin:
        for _ in range(3):
            found = begin(remembered, lambda: "address", make).result()
            assert found.tolist() == [0, 1, 2]
    assert len(made) == 1
