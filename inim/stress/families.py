"""All families of cases of the generators."""

from __future__ import annotations

from collections.abc import Iterator

from inim.stress.case import Case, Family, Size
from inim.stress.cases import SEPARABLE_FAMILIES
from inim.stress.free_cases import FREE_FAMILIES

__all__ = ["FAMILIES", "all_cases"]

FAMILIES = [*SEPARABLE_FAMILIES, *FREE_FAMILIES]


def all_cases(size: Size) -> Iterator[tuple[Family, Case]]:
    """Every family's cases, thinned out; the first and the last of each are kept."""
    for family in FAMILIES:
        cases = family.cases(size)
        for i, case in enumerate(cases):
            if i % size.thin == 0 or i == len(cases) - 1:
                yield family, case
