"""Grey portable float maps: depth and disparity as vision benchmarks have them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from inim.errors import FileError

__all__ = ["read_pfm"]

_PFM = re.compile(rb"(P[Ff])\s+(\d{1,6})\s+(\d{1,6})\s+([-+]?[\d.eE+-]{1,30})[ \t\r]*\n")


def read_pfm(path: Path) -> np.ndarray:
    """A grey portable float map, (H, W) float32 with row 0 on top (the file has it below).

    Raises
    ------
    FileError
        Damaged, of another length than its header says, or in colour.
    """
    data = path.read_bytes()
    header = _PFM.match(data)
    if not header:
        raise FileError(f"{path}: its PFM header makes no sense; save it as EXR or .npy")
    if header[1] == b"PF":
        raise FileError(f"{path}: is a PFM in colour; depth is a grey one, 'Pf'")
    columns, rows = int(header[2]), int(header[3])
    size = header.end() + 4 * columns * rows
    if not columns * rows or len(data) != size:
        raise FileError(
            f"{path}: a PFM of {columns} x {rows} pixels is {size} bytes long, this one is "
            f"{len(data)}; it is cut short or damaged"
        )
    kind = "<f4" if header[4].startswith(b"-") else ">f4"
    stored = np.frombuffer(data, kind, columns * rows, header.end()).reshape(rows, columns)
    return stored[::-1].astype(np.float32)
