"""The files of a report: its data as strict JSON, which has neither NaN nor infinity, and texts.

Every file is written whole or not at all, the data last: it marks a whole report.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from inim.files.image import write_atomically

#: The top-level key under which the paths of lost numbers are listed.
NOT_FINITE = "not_finite"

_Path = tuple[str | int, ...]


def to_strict(data: Mapping[str, Any]) -> dict[str, Any]:
    """`data` with null for every number that is not finite.

    Paths to those that were NaN or −infinity are listed under ``not_finite``, as lists of keys
    and indices. +infinity is the PSNR of identical images: a plain null, not listed.
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


def json_text(strict: Mapping[str, Any]) -> str:
    """Strict data as the text of its file."""
    return json.dumps(strict, indent=1, allow_nan=False, ensure_ascii=False)


def list_files(data: Mapping[str, Any], folder: Path, *written: str) -> dict[str, Any]:
    """`data` with `files`: all that lie below `folder`, and those still to be written there."""
    present = (str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())
    return {**data, "files": sorted({*present, *written})}


def write_forms(
    data: Mapping[str, Any],
    folder: Path,
    record: str,
    forms: Mapping[str, Callable[[Mapping[str, Any]], str]],
    encode: Callable[[Mapping[str, Any]], str] = json_text,
) -> None:
    """Write a report in all its forms.

    Parameters
    ----------
    data : mapping
    folder : Path
    record : str
        File name of the data, which is written last.
    forms : mapping of str to callable
        By file name, what makes the file's text from the data as a reader of `record` has them, so
        that all forms agree.
    encode : callable
        From strict data to the text of `record`.
    """
    strict = to_strict(data)
    read = from_strict(strict)
    texts = {name: render(read) for name, render in forms.items()}
    for name, content in {**texts, record: encode(strict)}.items():
        write_text(folder / name, content)


def write_text(path: Path, content: str) -> None:
    """Write UTF-8 text that ends in one line break, whole or not at all."""
    line = content.rstrip("\n") + "\n"

    def put(temporary: Path) -> None:
        # A path may hold bytes that are no UTF-8, which Python keeps as lone surrogates. Written as
        # backslash and number they are valid UTF-8, and in JSON the very escape that reads back.
        temporary.write_text(line, encoding="utf-8", errors="backslashreplace")

    write_atomically(path, put)
