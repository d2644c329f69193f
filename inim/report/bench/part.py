"""What a bench shows under a heading of its own: tables of text cells, a plot, and words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from inim.report.wording import MISSING, is_number, number, per_cent, plain

__all__ = ["TIME_HEADS", "Part", "Table", "milliseconds", "time_cells", "times"]

#: The heads of `time_cells`.
TIME_HEADS = ("ms per EIA", "fastest", "spread", "runs", "Mpx/s", "yardsticks", "by fastest")


@dataclass(frozen=True)
class Table:
    """Text cells under heads; the first cell of a row names it.

    Attributes
    ----------
    caption : str
    heads : sequence of str
    rows : sequence of sequence of str
    """

    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Part:
    """A part of a bench, or of a study that times something else.

    Attributes
    ----------
    name, title, lead : str
        Its anchor, its heading and the words below that.
    tables : sequence of Table
    plot : str
        The plot's files are ``PLOT.svg`` and ``PLOT.png``.
    figure : matplotlib Figure, optional
    remarks : sequence of str
        How it was measured; shown among the page's conditions.
    claims : (str, sequence of str)
        A heading and sentences below it; none if empty.
    """

    name: str
    title: str
    lead: str
    tables: Sequence[Table]
    plot: str = ""
    figure: Any = None
    remarks: Sequence[str] = ()
    claims: tuple[str, Sequence[str]] = ("", ())


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


def time_cells(method: Mapping[str, Any]) -> list[str]:
    """A method's times, from its entry in bench.json."""
    return [
        milliseconds(method.get("median_ms")),
        milliseconds(method.get("min_ms")),
        f"± {per_cent(method.get('spread'), 1)}",
        plain(method.get("runs", MISSING)),
        number(method.get("mpx_per_s"), 1 if method.get("mpx_per_s", 0) < 100 else 0),
        times(method.get("ratio")),
        times(method.get("ratio_min")),
    ]
