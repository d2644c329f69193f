"""Readers of pictures: textures of a scene, portable float maps, and whatever Pillow opens.

The content decides on the format, not the name, as in Mitsuba. Mitsuba reads PNG and JPEG itself,
through libpng and libjpeg: Pillow has no 16-bit colours. All else is decoded here and passed as
arrays, because Mitsuba's own readers trust what a header declares.
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
from typing import Any

import numpy as np

from inim.errors import FileError
from inim.files.image import check_unfolding, read_exr, silence_output
from inim.files.regular_file import open_file, read_file

_EXR_MAGIC = b"\x76\x2f\x31\x01"
_HEAD_BYTES = 16
_FORMATS = ("PNG", "JPEG", "BMP", "TGA", "PPM")
_READ_BY_MITSUBA = (b"\x89PNG", b"\xff\xd8")
# A texture becomes floats.
_SAMPLE_BYTES = 4
_UNKNOWN = (
    "not a picture that inim reads (EXR, PNG, JPEG, HDR, PFM, BMP, TGA, PPM); save it as PNG or EXR"
)


def read_texture(path: Path) -> np.ndarray | None:
    """Decode a picture that a scene names.

    Parameters
    ----------
    path : Path
        EXR, PNG, JPEG, Radiance HDR, PFM, BMP, TGA or PPM.

    Returns
    -------
    (H, W, 3 or 1) float32 of EXR, HDR and PFM, (H, W, 3) or (H, W) uint8 of others, or None
        None of a sound PNG or JPEG, which Mitsuba reads.

    Raises
    ------
    FileError
        Missing, damaged, cut short, of another kind, or unfolding to far more than its size.
    """
    with open_file(path) as file:
        head = file.read(_HEAD_BYTES)
    if head.startswith((b"PF", b"Pf")):
        values, scale = _read_pfm(path)
        return values * np.float32(abs(scale))
    if head.startswith(b"#?"):
        return _read_radiance(path)
    if head.startswith(_EXR_MAGIC):
        return read_exr(path)
    with open_picture(path, _FORMATS, _SAMPLE_BYTES, _UNKNOWN) as picture:
        picture.load()
        if head.startswith(_READ_BY_MITSUBA):
            return None
        is_grey = picture.mode in ("1", "L", "LA") or picture.mode.startswith("I")
        return np.array(picture.convert("L" if is_grey else "RGB"))


def is_exr(path: Path) -> bool:
    """True if the file content is EXR, regardless of its name."""
    with open_file(path) as file:
        return file.read(_HEAD_BYTES).startswith(_EXR_MAGIC)


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

    with open_file(path) if data is None else io.BytesIO(data) as file, silence_output():
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


# No line of the header may be mistaken for the one that states the size.
_RADIANCE = re.compile(
    rb"#\?(?:RADIANCE|RGBE)\n((?:(?!-Y|\+Y)[\x20-\x7e\t]*\n)*?)\n-Y (\d{1,5}) \+X (\d{1,5})\n"
)
_FORMAT = re.compile(rb"^FORMAT=32-bit_rle_(rgbe|xyze)$", re.M)
# By the format's own rule, lines of other lengths are not run-length coded.
_SHORTEST_CODED, _LONGEST_CODED = 8, 0x7FFF
# Decoding takes about a second for each 10 MiB at worst.
_MOST_RADIANCE_BYTES = 48 * 2**20
# Exponents are stored with 128 added, mantissas as eighths of a byte: 2^(e - 128) m / 256.
_EXPONENT_OFFSET = 136
# CIE XYZ to linear sRGB, IEC 61966-2-1.
_RGB_FROM_XYZ = np.array(
    [[3.240479, -1.537150, -0.498535], [-0.969256, 1.875991, 0.041556],
     [0.055648, -0.204043, 1.057311]], np.float32,
)  # fmt: skip


def _read_radiance(path: Path) -> np.ndarray:
    """Decode a Radiance HDR, (H, W, 3) float32 linear RGB.

    Ward, Real pixels, Graphics Gems II, 1991.
    """
    data = read_file(path, _MOST_RADIANCE_BYTES, remedy="save it as EXR")
    header = _RADIANCE.match(data)
    color = header and _FORMAT.search(header[1])
    if not header or not color:
        raise FileError(f"{path}: invalid Radiance header; save it as EXR")
    rows, columns, at = int(header[2]), int(header[3]), header.end()
    check_unfolding(path, 12 * rows * columns)
    if _SHORTEST_CODED <= columns <= _LONGEST_CODED and data[at : at + 2] == b"\2\2":
        lines = []
        for row in range(rows):
            line, at = _radiance_line(data, at, columns)
            if line is None:
                raise FileError(f"{path}: scan line {row} is damaged or cut short; save it again")
            lines.append(line)
        codes = b"".join(lines)
        rgbe = np.frombuffer(codes, np.uint8).reshape(rows, 4, columns).transpose(0, 2, 1)
    else:
        codes = data[at:]
        if not rows * columns or len(codes) != 4 * columns * rows:
            raise FileError(f"{path}: is not as long as its {columns} x {rows} pixels; damaged")
        rgbe = np.frombuffer(codes, np.uint8).reshape(rows, columns, 4)
    scale = np.ldexp(np.float32(1), rgbe[..., 3].astype(np.int32) - _EXPONENT_OFFSET)
    scale = np.where(rgbe[..., 3] > 0, scale, np.float32(0))
    rgb = rgbe[..., :3] * scale[..., None]
    return rgb @ _RGB_FROM_XYZ.T if color[1] == b"xyze" else rgb


def _radiance_line(data: bytes, at: int, columns: int) -> tuple[bytes | None, int]:
    """The four channels of a run-length coded scan line, and its end; None where it is damaged."""
    if data[at : at + 4] != b"\2\2" + columns.to_bytes(2, "big"):
        return None, at
    at += 4
    line = bytearray()
    for channel in range(1, 5):
        while len(line) < channel * columns:
            count = data[at] if at + 1 < len(data) else 0
            if count > 128:
                run = data[at + 1 : at + 2] * (count - 128)
                at += 2
            else:
                run = data[at + 1 : at + 1 + count]
                at += 1 + count
            line += run
            if not run or len(line) > channel * columns or at > len(data):
                return None, at
    return bytes(line), at


_PFM = re.compile(rb"(P[Ff])\s+(\d{1,6})\s+(\d{1,6})\s+([-+]?[\d.eE+-]{1,30})[ \t\r]*\n")
# Of three floats in each of 2^28 pixels, with a header.
_MOST_PFM_BYTES = 12 * 2**28 + 2**10


def read_pfm(path: Path) -> np.ndarray:
    """A grey portable float map, (H, W) float32 with row 0 on top (the file has it below).

    Raises
    ------
    FileError
        Damaged, of another length than its header says, or in colour.
    """
    values, _ = _read_pfm(path)
    if values.shape[2] != 1:
        raise FileError(f"{path}: is a PFM in colour; depth is a grey one, 'Pf'")
    return values[..., 0]


def _read_pfm(path: Path) -> tuple[np.ndarray, float]:
    """Values of a portable float map, (H, W, 1 or 3) float32, and its signed scale."""
    data = read_file(path, _MOST_PFM_BYTES)
    header = _PFM.match(data)
    try:
        scale = float(header[4]) if header else 0.0
    except ValueError:
        header = None
    if not header:
        raise FileError(f"{path}: invalid PFM header; save it as EXR or .npy")
    columns, rows, channels = int(header[2]), int(header[3]), 3 if header[1] == b"PF" else 1
    size = header.end() + 4 * columns * rows * channels
    if not columns * rows or len(data) != size:
        raise FileError(
            f"{path}: a PFM of {columns} x {rows} pixels is {size} bytes long, this one is "
            f"{len(data)}; it is cut short or damaged"
        )
    kind = "<f4" if header[4].startswith(b"-") else ">f4"
    stored = np.frombuffer(data, kind, offset=header.end()).reshape(rows, columns, channels)
    return stored[::-1].astype(np.float32), scale


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
