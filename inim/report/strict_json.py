"""A report's data as strict JSON and back: JSON has neither NaN nor infinity."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

__all__ = ["NOT_FINITE", "from_strict", "to_strict"]

#: The top-level key under which the paths of lost numbers are listed.
NOT_FINITE = "not_finite"

_Path = tuple[str | int, ...]


def to_strict(data: Mapping[str, Any]) -> dict[str, Any]:
    """`data` with null for every number that is not finite.

    Paths to those that were NaN or −infinity are listed under ``not_finite``, as lists of keys
    and indices. +infinity is the PSNR of identical pictures: a plain null, not listed.
    """
    lost: list[_Path] = []
    strict = {k: _strict(v, (k,), lost) for k, v in data.items() if k != NOT_FINITE}
    return {**strict, NOT_FINITE: [list(path) for path in lost]}


def _strict(value: Any, path: _Path, lost: list[_Path]) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _strict(v, (*path, str(k)), lost) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_strict(v, (*path, i), lost) for i, v in enumerate(value)]
    if not isinstance(value, float) or math.isfinite(value):
        return value
    if value != math.inf:
        lost.append(path)
    return None


def from_strict(strict: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of `strict` with NaN at each of the paths it lists, the list itself kept.

    Raises
    ------
    ValueError
        A path that leads to no null.
    """
    data: dict[str, Any] = _copy(dict(strict))
    lost = data.get(NOT_FINITE, [])
    if not isinstance(lost, list):
        raise ValueError(f"{NOT_FINITE} is {lost!r}; it must be a list of paths")
    for path in lost:
        _put_nan(data, path)
    return data


def _put_nan(data: dict[str, Any], path: list[Any]) -> None:
    place: Any = data
    try:
        *way, last = path
        for key in way:
            place = place[key]
        is_null = place[last] is None
    except (LookupError, TypeError, ValueError):
        is_null = False
    if not is_null:
        raise ValueError(f"{NOT_FINITE} names {path}, where there is no null")
    place[last] = math.nan


def _copy(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _copy(v) for k, v in value.items()}
    return [_copy(v) for v in value] if isinstance(value, list) else value
