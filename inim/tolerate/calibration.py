"""What a calibration reaches: the standard errors in its `calibration.json`."""

from __future__ import annotations

import json
import math
from pathlib import Path

from inim.display.misalignment import MISALIGNMENTS
from inim.errors import FileError
from inim.regular_file import read_file

__all__ = ["read_standard_errors"]

_LARGEST_BYTES = 2**26
_WAY_OUT = "name the calibration.json that a calibration wrote"


def read_standard_errors(path: Path) -> dict[str, float]:
    """By parameter that a display can be off by, its standard error, where it was determined.

    Raises
    ------
    FileError
        Missing, no regular file, too large, or no document with `parameters.NAME.standard_error`.
    """
    data = read_file(path, _LARGEST_BYTES, way_out=_WAY_OUT)
    try:
        parameters = dict(json.loads(data.decode("utf-8"))["parameters"])
        known = {n: one for n, one in parameters.items() if one.get("is_determined", True)}
        found = {n: float(known[n]["standard_error"]) for n in MISALIGNMENTS if n in known}
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise FileError(f"{path}: has no parameters.NAME.standard_error; {_WAY_OUT}") from None
    for name, value in found.items():
        if not (math.isfinite(value) and value > 0):
            raise FileError(
                f"{path}: parameters.{name}.standard_error is {value:g}, not a positive number; "
                f"{_WAY_OUT}"
            )
    return found
