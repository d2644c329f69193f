"""Checks of the options a generator takes; they may arrive as text, from ``name:key=value``."""

from __future__ import annotations

import math
from typing import Any

from inim.errors import UsageError

__all__ = ["one_of", "positive_mm"]


def one_of(name: str, value: Any, choices: tuple[str, ...]) -> str:
    """The value of an option that is one of a few words.

    Raises
    ------
    UsageError
        Any other value.
    """
    if value not in choices:
        raise UsageError(f"{name} = {value!r}: use {' or '.join(choices)}")
    return str(value)


def positive_mm(name: str, value: Any) -> float:
    """The value of an option that is a length, given as a number or as text.

    Raises
    ------
    UsageError
        Not a positive finite length.
    """
    try:
        length = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        length = math.nan
    if not 0 < length < math.inf:
        raise UsageError(f"{name} = {value!r}: it must be a positive length in mm")
    return length
