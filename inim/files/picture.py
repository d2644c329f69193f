"""Pictures and grids that a scene names, checked before the renderer's own readers trust them.

Mitsuba goes by the content, whatever a file is called, and allocates what a header declares. Its
reader of Radiance HDR writes past its buffer when a scan line in the middle of a file is not
run-length coded; so every line of one is checked.
"""

from __future__ import annotations

import io
import os
import re
import struct
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from inim.errors import FileError
from inim.files.image import check_exr, check_unfolding, hushed, read_exr_texture
from inim.files.regular_file import open_file, read_file

_EXR_MAGIC = b"\x76\x2f\x31\x01"
_HEAD_BYTES = 16
_FORMATS = ("PNG", "JPEG", "BMP", "TGA", "PPM")
# How those open that Mitsuba reads itself; its readers of BMP, TGA and PPM trust what they read.
_READ_BY_MITSUBA = (b"\x89PNG", b"\xff\xd8", b"#?", b"PF", b"Pf")
# A texture becomes floats.
_SAMPLE_BYTES = 4
_UNKNOWN = (
    "not a picture that inim reads (EXR, PNG, JPEG, HDR, PFM, BMP, TGA, PPM); save it as PNG or EXR"
)


def check_picture(path: Path) -> None:
    """Refuse a picture that Mitsuba's textures and environment maps cannot take safely.

    Parameters
    ----------
    path : Path
        EXR, PNG, JPEG, Radiance HDR, PFM, BMP, TGA or PPM.

    Raises
    ------
    FileError
        Missing, damaged, cut short, of another kind, or unfolding to far more than its size.
    """
    head = _head(path)
    if is_pfm(head):
        check_pfm(path, read_file(path, _MOST_PFM_BYTES))
    elif is_radiance(head):
        check_radiance(path, read_file(path, _MOST_RADIANCE_BYTES, way_out="save it as EXR"))
    elif head.startswith(_EXR_MAGIC):
        check_exr(path)
    else:
        with open_picture(path, _FORMATS, _SAMPLE_BYTES, _UNKNOWN) as picture:
            picture.load()


def read_texture(path: Path) -> np.ndarray | None:
    """The pixels of a checked picture that Mitsuba's own reader had better not open.

    Returns
    -------
    (H, W, 3 or 1) float32 of an EXR, (H, W, 3) or (H, W) uint8 of BMP, TGA and PPM, or None
        None of those that Mitsuba reads well. Its reader of EXR is an old one that ends the process
        on some of what OpenEXR reads, and it takes a palette's numbers for colours.

    Raises
    ------
    FileError
        Damaged, as for `check_picture`.
    """
    head = _head(path)
    if head.startswith(_READ_BY_MITSUBA):
        return None
    if head.startswith(_EXR_MAGIC):
        return read_exr_texture(path)
    with open_picture(path, _FORMATS, _SAMPLE_BYTES, _UNKNOWN) as picture:
        is_grey = picture.mode in ("1", "L", "LA") or picture.mode.startswith("I")
        return np.array(picture.convert("L" if is_grey else "RGB"))


def is_exr(path: Path) -> bool:
    """Whether a file opens as an EXR, whatever it is called."""
    return _head(path).startswith(_EXR_MAGIC)


def _head(path: Path) -> bytes:
    with open_file(path) as file:
        return file.read(_HEAD_BYTES)


@contextmanager
def open_picture(
    path: Path,
    formats: Sequence[str],
    sample_bytes: int,
    unknown: str = "",
    data: bytes | None = None,
) -> Iterator[Any]:
    """A picture that Pillow has opened, checked; whatever is wrong with it is a `FileError`.

    Parameters
    ----------
    path : Path
    formats : sequence of str
        Pillow's names of those that are read.
    sample_bytes : int
        That a sample takes once decoded.
    unknown : str
        What to say of a picture in no such format.
    data : bytes, optional
        The picture, where it was read already or lies inside the file.

    Raises
    ------
    FileError
        Missing, damaged, cut short, of another kind, or unfolding to far more than its size.
    """
    from PIL import Image

    if data is None:
        check_png(path)
    with open_file(path) if data is None else io.BytesIO(data) as file, hushed():
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # on sizes, which are checked below
                with Image.open(file, formats=formats) as picture:
                    samples = picture.width * picture.height * len(picture.getbands())
                    size = None if data is None else len(data)
                    check_unfolding(path, sample_bytes * samples, size)
                    yield picture
        except FileError:
            raise
        except Exception as error:
            if unknown and isinstance(error, Image.UnidentifiedImageError):
                raise FileError(f"{path}: {unknown}") from error
            cause = getattr(error, "strerror", None) or str(error).partition("\n")[0]
            raise FileError(f"{path}: not a readable picture ({cause}); save it anew") from error


_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# Length and name before a chunk's data, a checksum after it.
_CHUNK_HEAD_BYTES, _CHUNK_SUM_BYTES = 8, 4


def check_png(path: Path) -> None:
    """Raise `FileError` where a PNG's chunk is longer than its file; other files pass.

    Raises
    ------
    FileError
        Cut short or damaged, or it cannot be read.
    """
    with open_file(path) as file:
        if file.read(len(_PNG_SIGNATURE)) == _PNG_SIGNATURE:
            _check_chunks(path, file, os.fstat(file.fileno()).st_size)


def _check_chunks(path: Path, file: BinaryIO, size: int) -> None:
    while len(head := file.read(_CHUNK_HEAD_BYTES)) == _CHUNK_HEAD_BYTES:
        length, name = struct.unpack(">I4s", head)
        after = file.tell() + length + _CHUNK_SUM_BYTES
        if after > size:
            raise FileError(
                f"{path}: not a readable PNG (a chunk declares {length} bytes, more than there "
                "are); it is cut short or damaged"
            )
        if name == b"IEND":
            return
        file.seek(after)


# No line of the header may be mistaken for the one that states the size.
_HEADER = re.compile(
    rb"#\?(?:RADIANCE|RGBE)\n(?:(?!-Y|\+Y)[\x20-\x7e\t]*\n)*?\n-Y (\d{1,5}) \+X (\d{1,5})\n"
)
_FORMAT = re.compile(rb"^FORMAT=32-bit_rle_(?:rgbe|xyze)$", re.M)
_PFM_OF_SCENE = re.compile(rb"(P[Ff])\n(\d{1,5}) (\d{1,5})\n[-+]?\d{1,9}(?:\.\d{0,9})?\n")
# By the format's own rule, lines of other lengths are not run-length coded.
_SHORTEST_CODED, _LONGEST_CODED = 8, 0x7FFF
# Of three floats in each of 2^28 pixels, with a header.
_MOST_PFM_BYTES = 12 * 2**28 + 2**10
# Going through a file costs about a second for each 10 MiB at worst.
_MOST_RADIANCE_BYTES = 48 * 2**20


def is_radiance(data: bytes) -> bool:
    """Whether Mitsuba takes the file for Radiance HDR."""
    return data[:2] == b"#?"


def is_pfm(data: bytes) -> bool:
    """Whether Mitsuba takes the file for a portable float map."""
    return data[:2] in (b"PF", b"Pf")


def check_pfm(path: Path, data: bytes) -> None:
    """Raise `FileError` unless a PFM is exactly as long as its header says."""
    header = _PFM_OF_SCENE.match(data)
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


_PFM = re.compile(rb"(P[Ff])\s+(\d{1,6})\s+(\d{1,6})\s+([-+]?[\d.eE+-]{1,30})[ \t\r]*\n")


def read_pfm(path: Path) -> np.ndarray:
    """A grey portable float map, (H, W) float32 with row 0 on top (the file has it below).

    Raises
    ------
    FileError
        Damaged, of another length than its header says, or in colour.
    """
    data = read_file(path, _MOST_PFM_BYTES)
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


def write_pfm(path: Path, values: np.ndarray) -> None:
    """Write (H, W) numbers, row 0 on top, as a grey portable float map."""
    rows, columns = values.shape
    path.write_bytes(b"Pf\n%d %d\n-1\n" % (columns, rows) + values[::-1].astype("<f4").tobytes())


_VOLUME_HEAD = struct.Struct("<3sBiiiii6f")


def check_volume(path: Path) -> None:
    """Refuse a grid whose header does not fit its file: the renderer allocates what it says.

    Raises
    ------
    FileError
        Missing, of another kind, or not as long as it declares.
    """
    with open_file(path) as file:
        size, head = os.fstat(file.fileno()).st_size, file.read(_VOLUME_HEAD.size)
    if len(head) < _VOLUME_HEAD.size:
        raise FileError(f"{path}: not a grid of Mitsuba's .vol format; it is cut short")
    magic, version, kind, x, y, z, channels, *_ = _VOLUME_HEAD.unpack(head)
    if (magic, version, kind) != (b"VOL", 3, 1) or min(x, y, z, channels) < 1:
        raise FileError(f"{path}: not a grid of Mitsuba's .vol format, version 3, of float32")
    wanted = _VOLUME_HEAD.size + 4 * x * y * z * channels
    if size < wanted:
        raise FileError(
            f"{path}: a grid of {x} x {y} x {z} x {channels} is {wanted} bytes long, this one is "
            f"{size}; it is cut short or damaged"
        )
