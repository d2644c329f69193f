"""Grids in Mitsuba's binary `.vol` format, held against the bytes there are."""

from __future__ import annotations

import struct
from pathlib import Path

from inim.errors import FileError

__all__ = ["check_volume"]

_HEAD = struct.Struct("<3sBiiiii6f")


def check_volume(path: Path) -> None:
    """Refuse a grid whose header does not fit its file: the renderer allocates what it says.

    Raises
    ------
    FileError
        Missing, of another kind, or not as long as it declares.
    """
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(_HEAD.size)
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error.strerror})") from None
    if len(head) < _HEAD.size:
        raise FileError(f"{path}: not a grid of Mitsuba's .vol format; it is cut short")
    magic, version, kind, x, y, z, channels, *_ = _HEAD.unpack(head)
    if (magic, version, kind) != (b"VOL", 3, 1) or min(x, y, z, channels) < 1:
        raise FileError(f"{path}: not a grid of Mitsuba's .vol format, version 3, of float32")
    wanted = _HEAD.size + 4 * x * y * z * channels
    if size < wanted:
        raise FileError(
            f"{path}: a grid of {x} x {y} x {z} x {channels} is {wanted} bytes long, this one is "
            f"{size}; it is cut short or damaged"
        )
