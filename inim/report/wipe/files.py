"""The script and the style sheet, as they go into a page."""

from __future__ import annotations

from functools import cache
from importlib import resources

__all__ = ["script", "style"]


@cache
def _text(name: str) -> str:
    return resources.files("inim.report.wipe").joinpath(name).read_text("utf-8")


def script() -> str:
    """The script; it works where the page holds a `wipe`."""
    return _text("wipe.js")


def style() -> str:
    """The style sheet, to be embedded after the report's own."""
    return _text("wipe.css")
