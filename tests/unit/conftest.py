"""Fixtures of several unit tests."""

import pytest

from inim.scores import metrics


@pytest.fixture
def announce(monkeypatch):
    """Announce metrics of other packages, by the names of the keywords."""

    def announced(**registered):
        monkeypatch.setattr("inim.scores.metrics.announced_names", lambda group: sorted(registered))
        monkeypatch.setattr("inim.scores.metrics.load", lambda group, name, kind: registered[name])
        metrics._all_metrics.cache_clear()

    yield announced
    metrics._all_metrics.cache_clear()
