"""Tests of the studies, which belong to the slow tier."""

from pathlib import Path

import pytest

from tests.conftest import renderer  # noqa: F401


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests below this folder as slow."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.slow)
