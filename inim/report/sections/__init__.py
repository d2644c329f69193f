"""The sections of the page, in their order: each is one function from the report to HTML."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from inim.report.pictures import Pictures
from inim.report.sections.display import display
from inim.report.sections.elemental_images import elemental_images
from inim.report.sections.meanings import meanings
from inim.report.sections.overview import overview
from inim.report.sections.parallax import parallax
from inim.report.sections.record import check_list, reproduce, timings, warnings
from inim.report.sections.regression import regression
from inim.report.sections.rgbd import rgbd
from inim.report.sections.skipped import skipped
from inim.report.sections.time_against_error import time_against_error
from inim.report.sections.views import views
from inim.report.sections.virtual_display import report_display
from inim.report.virtual_display.live import ANCHOR, TITLE

__all__ = ["SECTIONS", "Section"]

_Body = Callable[[Mapping[str, Any], Pictures], str]


@dataclass(frozen=True)
class Section:
    """A part of the page; one whose body is empty is left out."""

    anchor: str
    title: str
    body: _Body


def _without_pictures(body: Callable[[Mapping[str, Any]], str]) -> _Body:
    return lambda data, _: body(data)


SECTIONS = (
    Section("overview", "Scores", overview),
    Section(ANCHOR, TITLE, report_display),
    Section("regression", "Against the baseline", regression),
    Section("display", "Display", _without_pictures(display)),
    Section("parallax", "Parallax", parallax),
    Section("views", "Views", views),
    Section("eia", "Elemental images", elemental_images),
    Section("time", "Time against error", _without_pictures(time_against_error)),
    Section("rgbd", "RGB-D input", rgbd),
    Section("checks", "Checks", _without_pictures(check_list)),
    Section("timings", "Timings", _without_pictures(timings)),
    Section("skipped", "What was skipped", _without_pictures(skipped)),
    Section("warnings", "Warnings", _without_pictures(warnings)),
    Section("reproduce", "How to reproduce", _without_pictures(reproduce)),
    Section("meaning", "What the numbers mean", _without_pictures(meanings)),
)
