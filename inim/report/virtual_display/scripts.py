"""The script, its style sheet and its data, as they go into a page."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

__all__ = ["data_element", "script", "style"]

_FILES = resources.files("inim.report.virtual_display")


@cache
def _text(suffix: str) -> str:
    return _FILES.joinpath(f"virtual_display.{suffix}").read_text("utf-8")


def style() -> str:
    """The style sheet, to be embedded after the report's own."""
    return _text("css")


def script() -> str:
    """The script; it draws where the page holds a `data_element`."""
    return _text("js")


def data_element(data: Mapping[str, Any]) -> str:
    """`data` and the shader as a block that the script reads and nothing runs."""
    whole = {**data, "shader": _text("glsl")}
    coded = json.dumps(whole, allow_nan=False).replace("<", "\\u003c").replace("&", "\\u0026")
    return f'<script type="application/json" id="virtual-display-data">{coded}</script>'
