"""Standard errors of a calibration, from its `calibration.json`."""

from __future__ import annotations

from pathlib import Path

from inim.display.misalignment import MISALIGNMENTS
from inim.documents import read_document
from inim.documents.calibration import CalibrationDocument
from inim.errors import FileError

_REMEDY = "name the calibration.json that a calibration wrote"


def read_standard_errors(path: Path) -> dict[str, float]:
    """Standard errors of the misalignments that the calibration determined, by parameter.

    Raises
    ------
    FileError
        As `inim.documents.read_document`, or a standard error that is not positive.
    """
    parameters = read_document(path, _REMEDY, CalibrationDocument).parameters
    errors = {
        name: estimate.standard_error
        for name, estimate in parameters.items()
        if name in MISALIGNMENTS and estimate.is_determined
    }
    for name, error in errors.items():
        if not error > 0:
            raise FileError(
                f"{path}: parameters.{name}.standard_error is {error:g}, not a positive number; "
                f"{_REMEDY}"
            )
    return errors
