"""A verdict as data: what was found, how sure it is, what is allowed, and whether that holds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["Verdict", "all_passed", "within"]

#: Between a change and the largest that passes, either way.
WITHIN = "within"


@dataclass(frozen=True)
class Verdict:
    """One row of a regression report.

    Attributes
    ----------
    name : str
        What was compared; the same in every run.
    kind : {"picture", "score", "pixels", "noise", "time"}
    value : float
        What was found: a change, a share or a ratio, in `unit`.
    relation : {"within", "<="}
    limit : float
        The largest that passes: the smallest change that counts or, where noise is above it, what
        noise alone may do.
    interval : (float, float)
        Confidence interval of `value`.
    passed : bool
        False for whatever is missing or not finite.
    unit : str
    p_value : float, optional
        Of no change at all, before the correction for many tests.
    detail : str
        The rest in words.
    """

    name: str
    kind: str
    value: float
    relation: str
    limit: float
    interval: tuple[float, float]
    passed: bool
    unit: str = ""
    p_value: float | None = None
    detail: str = ""

    def as_check(self) -> dict[str, Any]:
        """As a check of a report."""
        return {
            "name": self.name,
            "value": self.value,
            "relation": self.relation,
            "limit": self.limit,
            "passed": self.passed,
            "detail": self.detail,
            "interval": list(self.interval),
            "p_value": self.p_value,
            "unit": self.unit,
            "kind": self.kind,
        }

    def line(self) -> str:
        """As a line of text."""
        word = "passed" if self.passed else "FAILED"
        low, high = self.interval
        unit = f" {self.unit}" if self.unit else ""
        sign = "within ±" if self.relation == WITHIN else "at most "
        value = f"{self.value:+.4g}" if self.relation == WITHIN else f"{self.value:.4g}"
        return (
            f"{word}  {self.name}: {value}{unit} ({low:.4g} to {high:.4g}), {sign}{self.limit:.4g}"
            f"{f'; {self.detail}' if self.detail else ''}"
        )


def within(
    name: str,
    kind: str,
    change: float,
    half_width: float,
    smallest: float,
    **more: Any,
) -> Verdict:
    """The verdict on a change that fails only if it counts *and* noise does not explain it.

    Parameters
    ----------
    name, kind : str
    change : float
    half_width : float
        Of its confidence interval.
    smallest : float
        The smallest change that counts.
    **more
        Further fields of `Verdict`.
    """
    limit = max(smallest, half_width) if math.isfinite(half_width) else smallest
    known = math.isfinite(change) and math.isfinite(half_width)
    interval = (change - half_width, change + half_width)
    return Verdict(
        name, kind, change, WITHIN, limit, interval, bool(known and abs(change) <= limit), **more
    )


def all_passed(verdicts: Iterable[Verdict | Mapping[str, Any]]) -> bool:
    """Whether there is any verdict at all, and every one passed."""
    said = [v.passed if isinstance(v, Verdict) else v.get("passed") is True for v in verdicts]
    return bool(said) and all(said)
