"""The virtual display: an EIA through its lens array, drawn live in the page by WebGL.

Geometry, panels and pictures are put together in Python; one script and one shader, package data
beside this file, draw. Without scripts or WebGL 2, pre-rendered views stand in.
"""

from __future__ import annotations

from inim.report.virtual_display.body import ANCHOR, TITLE, is_live, report_display
from inim.report.virtual_display.scripts import script, style

__all__ = [
    "ANCHOR",
    "TITLE",
    "is_live",
    "report_display",
    "script",
    "style",
]
