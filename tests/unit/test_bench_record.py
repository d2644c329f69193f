"""A busy machine is said to be one."""

import os

import pytest

from inim.bench.job import load_average, warn_of_load


@pytest.mark.parametrize(("load", "warned"), [(0.0, 0), (0.5, 0), (0.6, 1), (8.0, 1), (None, 1)])
def test_a_busy_machine_is_warned_of(monkeypatch, load, warned):
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    found = warn_of_load(load)
    assert len(found) == warned
    assert not warned or ("load" in found[0])


def test_a_system_without_load_averages_says_none(monkeypatch):
    def fails():
        raise OSError

    monkeypatch.setattr(os, "getloadavg", fails)
    assert load_average() is None
