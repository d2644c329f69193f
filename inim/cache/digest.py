"""Digests of what decides a result: values, arrays, and the program's own code."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

_PACKAGE = Path(__file__).resolve().parent.parent


def address_of(product: str, parts: Mapping[str, str]) -> str:
    """Where the result of a product lies whose parts have these digests."""
    return value_digest([product, sorted(parts.items())])


def value_digest(value: Any) -> str:
    """Of anything that JSON can hold, and of arrays and dataclasses in it; 40 hex digits."""
    text = json.dumps(value, sort_keys=True, default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()[:40]


def array_digest(*arrays: np.ndarray | None) -> str:
    """Of the shapes, types and bytes of arrays."""
    found = hashlib.sha256()
    for array in arrays:
        if array is None:
            found.update(b"none")
            continue
        found.update(f"{array.shape} {array.dtype.str} ".encode())
        found.update(np.ascontiguousarray(array).data)
    return found.hexdigest()[:40]


@cache
def code_digest(*places: str) -> str:
    """Of the source of modules and packages of this program: edited code makes other results.

    Parameters
    ----------
    places : str
        Paths below the package, such as ``"kernel"`` or ``"metrics.py"``.
    """
    found = hashlib.sha256()
    for place in places:
        path = _PACKAGE / place
        files = [path] if path.is_file() else sorted(path.rglob("*.py"))
        if not files:
            raise FileNotFoundError(place)
        for file in files:
            found.update(str(file.relative_to(_PACKAGE)).encode() + b"\0" + file.read_bytes())
    return found.hexdigest()[:40]


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return array_digest(value)
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: getattr(value, f.name) for f in fields(value)}
    if isinstance(value, Path):
        raise TypeError("paths decide nothing")
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} has no digest")
