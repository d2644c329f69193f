"""The chunks of a PNG, held against the bytes there are: Pillow asks for what a chunk declares."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

from inim.errors import FileError

__all__ = ["check_png"]

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# Length and name before a chunk's data, a checksum after it.
_HEAD_BYTES, _SUM_BYTES = 8, 4


def check_png(path: Path) -> None:
    """Raise `FileError` where a PNG's chunk is longer than its file; other files pass.

    Raises
    ------
    FileError
        Cut short or damaged, or it cannot be read.
    """
    try:
        with path.open("rb") as file:
            if file.read(len(_SIGNATURE)) == _SIGNATURE:
                _check_chunks(path, file, path.stat().st_size)
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error.strerror})") from None


def _check_chunks(path: Path, file: BinaryIO, size: int) -> None:
    while len(head := file.read(_HEAD_BYTES)) == _HEAD_BYTES:
        length, name = struct.unpack(">I4s", head)
        after = file.tell() + length + _SUM_BYTES
        if after > size:
            raise FileError(
                f"{path}: not a readable PNG (a chunk declares {length} bytes, more than there "
                "are); it is cut short or damaged"
            )
        if name == b"IEND":
            return
        file.seek(after)
