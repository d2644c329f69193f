"""What a calibration reaches: the standard errors in its `calibration.json`."""

from __future__ import annotations

from pathlib import Path

from inim.display.misalignment import MISALIGNMENTS
from inim.errors import FileError
from inim.files.json_file import read_json

_WAY_OUT = "name the calibration.json that a calibration wrote"


def read_standard_errors(path: Path) -> dict[str, float]:
    """By parameter that a display can be off by, its standard error, where it was determined.

    Raises
    ------
    FileError
        As `inim.files.json_file.read_json`, or a standard error that is none.
    """
    parameters = read_json(path, _WAY_OUT, "calibration")["parameters"]
    known = {name: parameters[name] for name in MISALIGNMENTS}
    found = {n: one["standard_error"] for n, one in known.items() if one["is_determined"]}
    for name, value in found.items():
        if not value > 0:
            raise FileError(
                f"{path}: parameters.{name}.standard_error is {value:g}, not a positive number; "
                f"{_WAY_OUT}"
            )
    return found
