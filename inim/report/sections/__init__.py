"""The sections of a validation's page.

Each module in this folder registers one or several sections in its ``SECTIONS``; adding a section
is adding a file.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any

from inim.report.images import Images

__all__ = ["ReportSection", "all_sections"]


@dataclass(frozen=True)
class ReportSection:
    """A part of the page.

    Attributes
    ----------
    place : int
        Sections stand on the page in the order of their places.
    anchor, title : str
        As of `inim.report.page.Section`.
    body : callable
        From the report's data and its images to HTML; empty where the section does not apply.
    """

    place: int
    anchor: str
    title: str
    body: Callable[[Mapping[str, Any], Images], str]


@cache
def all_sections() -> tuple[ReportSection, ...]:
    """Every section that a module in this folder registers, in order."""
    modules = [
        import_module(f"{__name__}.{found.name}") for found in pkgutil.iter_modules(__path__)
    ]
    sections: list[ReportSection] = [one for module in modules for one in module.SECTIONS]
    return tuple(sorted(sections, key=lambda section: section.place))
