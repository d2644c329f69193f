"""What the tables of a bench are made of: text cells, times and ratios."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from inim.report.wording import MISSING, is_number, number

__all__ = ["Table", "milliseconds", "times"]


@dataclass(frozen=True)
class Table:
    """Text cells under heads; the first cell of a row names it.

    Attributes
    ----------
    part : str
        The part of the bench it belongs to: scene, scaling, paper, views, layers or commands.
    caption : str
    heads : sequence of str
    rows : sequence of sequence of str
    """

    part: str
    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]


def milliseconds(value: object) -> str:
    """A time with three significant digits or so: no run repeats itself to more."""
    if not is_number(value):
        return MISSING
    return number(value, 3 if value < 1 else 2 if value < 100 else 0 if value >= 1000 else 1)


def times(value: object) -> str:
    """A ratio."""
    if not is_number(value):
        return MISSING
    return f"{number(value, 2 if value < 100 else 0)} ×"
