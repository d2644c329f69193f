"""Distributions of the errors of a display, from a study's file or from its geometry.

==============  ===================================================================================
``[study]``     ``alone``, ``together``, ``reach``, ``seed``: see `ToleranceStudy`
``[errors]``    by parameter, ``{ normal = S }``, S its standard deviation, or
                ``{ uniform = H }``, H half of its range
==============  ===================================================================================
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random
from statistics import NormalDist
from typing import Any

from inim.display import Display
from inim.display.misalignment import MISALIGNMENTS, one_pixel_errors
from inim.documents import read_document
from inim.documents.display import CalibrationDocument
from inim.errors import FileError
from inim.sweeps.study import MOST_UNITS, Tables, read_toml, short_value

#: Fewest draws for a curve with three parameters.
LEAST_ALONE = 5
_DISTRIBUTIONS = ("normal", "uniform")
# Default shift of the observed panel point by an error, in pixels.
_DEFAULT_SHARE = 0.05
# Golden-ratio steps cover a range evenly, whatever their start and number.
_GOLDEN = (math.sqrt(5) - 1) / 2
# Significant digits of a drawn error.
_DIGITS = 4


@dataclass(frozen=True)
class Spread:
    """Distribution of a parameter's error about zero: "normal" or "uniform".

    `size` is the standard deviation, or half of the range.
    """

    distribution: str
    size: float

    def at(self, share: float) -> float:
        """Quantile of the error for a share of the displays."""
        if self.distribution == "uniform":
            return self.size * (2 * share - 1)
        return self.size * NormalDist().inv_cdf(share)


@dataclass(frozen=True)
class ToleranceStudy:
    """Design of the random draws.

    `spreads` are distributions by parameter; other parameters are exact. `alone` is the number of
    draws per parameter, within `reach` times its spread on either side; `together` is the number of
    displays with all errors at once.
    """

    spreads: Mapping[str, Spread]
    alone: int = 16
    together: int = 40
    reach: float = 6.0
    seed: int = 0

    def draw_alone(self, name: str) -> list[float]:
        """Errors of one parameter, evenly over its range; more draws keep the earlier ones."""
        start = Random(f"{self.seed} alone {name}").random()
        farthest = self.reach * self.spreads[name].size
        places = ((start + i * _GOLDEN) % 1 for i in range(self.alone))
        return [round_digits(farthest * (2 * place - 1)) for place in places]

    def draw_together(self) -> list[dict[str, float]]:
        """Random errors of each display, by parameter; more displays keep the earlier ones."""
        return [
            {
                # Text seeds give the same numbers in every version of Python.
                name: round_digits(
                    spread.at(max(Random(f"{self.seed} {i} {name}").random(), 2**-53))
                )
                for name, spread in self.spreads.items()
            }
            for i in range(self.together)
        ]


def round_digits(value: float) -> float:
    """Round to four significant digits; other processors differ beyond them."""
    return float(f"{value:.{_DIGITS}g}")


def default_spreads(display: Display) -> dict[str, Spread]:
    """Errors that each shift the observed panel point by the same fraction of a pixel."""
    return {
        name: Spread("normal", float(f"{_DEFAULT_SHARE * error:.2g}"))
        for name, error in one_pixel_errors(display).items()
    }


def read_tolerance_study(path: Path | None, display: Display) -> ToleranceStudy:
    """Read and check a study; without a file or errors in it, use `default_spreads`.

    Raises `FileError` for a file that is not TOML, and `UsageError` for an invalid key or value.
    """
    if path is None:
        return ToleranceStudy(default_spreads(display))
    reader = _ToleranceTables(path, read_toml(path))
    reader.check_names("", reader.tables, ("study", "errors"))
    table, spreads = reader.table("study"), reader.spreads() or default_spreads(display)
    whole = {"alone": LEAST_ALONE, "together": 0, "seed": 0}
    reader.check_names("study.", table, (*whole, "reach"))
    counts = {
        name: reader.count(f"study.{name}", table[name], least)
        for name, least in whole.items()
        if name in table
    }
    study = ToleranceStudy(spreads, **counts)
    if "reach" in table:
        study = replace(study, reach=reader.size("study.reach", table["reach"]))
    displays = 1 + study.alone * len(spreads) + study.together
    if displays > MOST_UNITS:
        raise reader.wrong("study", f"{displays} displays; at most {MOST_UNITS}: draw fewer")
    return study


class _ToleranceTables(Tables):
    """Reader of a tolerance study."""

    def count(self, key: str, value: Any, least: int) -> int:
        """Check a whole number."""
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise self.wrong(
                key, f"must be a whole number of at least {least}, not {short_value(value)}"
            )
        return value

    def size(self, key: str, value: Any) -> float:
        """Check a positive number."""
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < 1e9:
            raise self.wrong(key, f"must be a positive number, not {short_value(value)}")
        return float(value)

    def spreads(self) -> dict[str, Spread]:
        """Distribution by parameter, in the table's order."""
        table = self.table("errors")
        self.check_names("errors.", table, tuple(MISALIGNMENTS))
        spreads = {}
        for name, values in table.items():
            key = f"errors.{name}"
            if not isinstance(values, dict) or len(values) != 1:
                raise self.wrong(key, f"write {{ normal = SIZE }}, not {short_value(values)}")
            self.check_names(f"{key}.", values, _DISTRIBUTIONS)
            ((distribution, size),) = values.items()
            spreads[name] = Spread(distribution, self.size(f"{key}.{distribution}", size))
        return spreads


_REMEDY = "give the calibration.json that a calibration wrote"


def read_standard_errors(path: Path) -> dict[str, float]:
    """Standard errors of the misalignments that the calibration determined, by parameter."""
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
