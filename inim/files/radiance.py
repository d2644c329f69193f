"""Radiance HDR and PFM pictures, gone through to the end before the renderer reads them.

Mitsuba's own reader of Radiance HDR writes past its buffer when a scan line in the middle of a
file is not run-length coded; so every line of one is looked at first.
"""

from __future__ import annotations

import re
from pathlib import Path

from inim.errors import FileError

__all__ = ["check_pfm", "check_radiance", "is_pfm", "is_radiance"]

# No line of the header may be mistaken for the one that states the size.
_HEADER = re.compile(
    rb"#\?(?:RADIANCE|RGBE)\n(?:(?!-Y|\+Y)[\x20-\x7e\t]*\n)*?\n-Y (\d{1,5}) \+X (\d{1,5})\n"
)
_FORMAT = re.compile(rb"^FORMAT=32-bit_rle_(?:rgbe|xyze)$", re.M)
_PFM = re.compile(rb"(P[Ff])\n(\d{1,5}) (\d{1,5})\n[-+]?\d{1,9}(?:\.\d{0,9})?\n")
# By the format's own rule, lines of other lengths are not run-length coded.
_SHORTEST_CODED, _LONGEST_CODED = 8, 0x7FFF
# Going through a file costs about a second for each 10 MiB at worst.
_MOST_BYTES = 48 * 2**20


def is_radiance(data: bytes) -> bool:
    """Whether Mitsuba takes the file for Radiance HDR."""
    return data[:2] == b"#?"


def is_pfm(data: bytes) -> bool:
    """Whether Mitsuba takes the file for a portable float map."""
    return data[:2] in (b"PF", b"Pf")


def check_pfm(path: Path, data: bytes) -> None:
    """Raise `FileError` unless a PFM is exactly as long as its header says."""
    header = _PFM.match(data)
    if not header:
        raise FileError(f"{path}: its PFM header makes no sense; save it as EXR")
    columns, rows = int(header[2]), int(header[3])
    size = header.end() + 4 * columns * rows * (3 if header[1] == b"PF" else 1)
    if not columns * rows or len(data) != size:
        raise FileError(
            f"{path}: a PFM of {columns} x {rows} pixels is {size} bytes long, this one is "
            f"{len(data)}; it is cut short or damaged"
        )


def check_radiance(path: Path, data: bytes) -> None:
    """Raise `FileError` unless every scan line of a Radiance HDR is whole."""
    if len(data) > _MOST_BYTES:
        raise FileError(f"{path}: Radiance HDR of {len(data)} bytes; save it as EXR")
    header = _HEADER.match(data)
    if not header or not _FORMAT.search(data, 0, header.end()):
        raise FileError(f"{path}: its Radiance header makes no sense; save it as EXR")
    rows, columns, at = int(header[1]), int(header[2]), header.end()
    if not rows * columns:
        raise FileError(f"{path}: declares {columns} x {rows} pixels; refused as damaged")
    coded = _SHORTEST_CODED <= columns <= _LONGEST_CODED and _is_coded(data, at)
    if not coded and len(data) != at + 4 * columns * rows:
        raise FileError(f"{path}: is not as long as its {columns} x {rows} pixels; damaged")
    for row in range(rows if coded else 0):
        after = _line_end(data, at, columns)
        if after is None:
            raise FileError(f"{path}: scan line {row} is damaged or cut short; save it anew")
        at = after


def _is_coded(data: bytes, at: int) -> bool:
    return data[at : at + 2] == b"\2\2" and data[at + 2 : at + 3] < b"\x80"


def _line_end(data: bytes, at: int, columns: int) -> int | None:
    """Where a run-length coded scan line ends; None where it is none or not whole."""
    if data[at : at + 4] != b"\2\2" + columns.to_bytes(2, "big"):
        return None
    at += 4
    for _ in range(4):
        left = columns
        while left:
            if at + 2 > len(data):
                return None
            count = data[at]
            if count > 128:
                count -= 128
                at += 2
            else:
                at += 1 + count
            if not 0 < count <= left:
                return None
            left -= count
    return at if at <= len(data) else None
