"""Lens sheets: a table with sources, tables of a user, and sheets of any pitch."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct, ValidationError, convert

from inim.display.layouts import LAYOUTS
from inim.display.parameters import Lattice
from inim.errors import FileError, UsageError
from inim.sweeps.study import read_toml

TABLE = Path(__file__).with_name("sheets.toml")
#: Pitches of the sheets of any size, mm, and their focal lengths in pitches: from the strongest
#: plano-convex lenses of PMMA to those of a narrow zone.
PITCHES_MM = tuple(float(f"{p:.2g}") for p in np.geomspace(0.2, 2.0, 16))
FOCAL_LENGTHS = (2.5, 3.0, 3.5, 4.0, 5.0, 6.0)


_Length = Annotated[float, Meta(gt=0, lt=1000)]


class LensSheet(Struct, frozen=True, forbid_unknown_fields=True):
    """A lens sheet; lengths in mm, the focal length in air."""

    name: str
    pitch_mm: _Length
    focal_length_mm: _Length
    lattice: Lattice = "square"
    source: str = ""


def read_sheets(path: Path) -> tuple[LensSheet, ...]:
    """Read a table of sheets: TOML with a `[[sheet]]` of the fields of `LensSheet` for each.

    Raises `FileError`: not such a file, or a value that describes no sheet.
    """
    tables = read_toml(path)
    try:
        sheets = convert(tables.get("sheet"), tuple[LensSheet, ...])
    except ValidationError as error:
        raise FileError(
            f"{path}: {error}; give each [[sheet]] a name, pitch_mm and focal_length_mm"
        ) from None
    if not sheets:
        raise FileError(f"{path}: no [[sheet]] in it; give one at least")
    return sheets


def any_sheets(lattices: Sequence[str] = ("square",)) -> tuple[LensSheet, ...]:
    """Sheets of `PITCHES_MM` and `FOCAL_LENGTHS`, which can be manufactured to order.

    Raises `UsageError`: an unknown layout.
    """
    for lattice in lattices:
        if lattice not in LAYOUTS:
            raise UsageError(f"--lattice {lattice}: use {' or '.join(LAYOUTS)}")
    return tuple(
        LensSheet(f"any, {p:g} mm, f/{ratio:g}", p, float(f"{p * ratio:.3g}"), lattice)  # type: ignore[arg-type]
        for lattice in lattices
        for p in PITCHES_MM
        for ratio in FOCAL_LENGTHS
    )
