"""Readers of pictures: textures of a scene, portable float maps, and Pillow's formats.

The content determines the format, as in Mitsuba. Mitsuba reads PNG and JPEG itself, because Pillow
has no 16-bit colours. Other formats are decoded here and passed as arrays, because Mitsuba's
readers trust the header.
"""

import io
import math
import os
import re
import struct
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from inim.image.color import linear_from_srgb
from inim.image.files.image import check_unfolding, read_exr, silence_output
from inim.system.errors import FileError
from inim.system.files import open_file, read_file

_EXR_MAGIC = b"\x76\x2f\x31\x01"
_HEAD_BYTES = 16
_FORMATS = ("PNG", "JPEG", "BMP", "TGA", "PPM")
_READ_BY_MITSUBA = (b"\x89PNG", b"\xff\xd8")
# Textures are converted to float32.
_SAMPLE_BYTES = 4
_UNKNOWN = (
    "not a picture that inim reads (EXR, PNG, JPEG, HDR, PFM, BMP, TGA, PPM); save it as PNG or EXR"
)

_LIGHT_FORMATS = ("PNG", "JPEG", "TIFF", "PPM", "BMP")
_NO_LIGHT = "not a picture that inim reads; save it as PNG, TIFF, JPEG or EXR"


def read_texture(path: Path) -> np.ndarray | None:
    """Decode a texture of a scene.

    * `path`: EXR, PNG, JPEG, Radiance HDR, PFM, BMP, TGA or PPM.

    Returns (H, W, 3 or 1) float32 of EXR, HDR and PFM, (H, W, 3) or (H, W) uint8 of others, or
    None: None for a valid PNG or JPEG, which Mitsuba reads.

    Raises `FileError`: missing, damaged, unsupported, or suspiciously large when decoded.
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


def read_light(path: Path, raw: bool) -> NDArray[np.float32]:
    """Linear light of a picture, (rows, columns, 3); 1 is the largest code.

    * `path`: PNG, TIFF, JPEG, PPM or BMP, or a linear EXR.
    * `raw`: codes are proportional to light, as in a sensor's picture; sRGB otherwise.

    Raises `FileError`: missing, damaged, unsupported, or with values that are not finite.
    """
    if is_exr(path):
        light = read_exr(path)
        if not np.isfinite(light).all():
            raise FileError(f"{path}: has colours that are not finite; save it again")
    else:
        with open_picture(path, _LIGHT_FORMATS, _SAMPLE_BYTES, _NO_LIGHT) as picture:
            if picture.mode.startswith("I"):  # grey of 16 bits
                codes, largest = np.asarray(picture, np.float32)[..., None], 65535
            else:
                codes, largest = np.asarray(picture.convert("RGB"), np.float32), 255
        light = codes / np.float32(largest)
        light = light if raw else linear_from_srgb(light)
    return np.broadcast_to(light, (*light.shape[:2], 3))


def is_exr(path: Path) -> bool:
    """True if the file content is EXR, regardless of its name."""
    with open_file(path) as file:
        return file.read(_HEAD_BYTES).startswith(_EXR_MAGIC)


# Codes of 16 bits per code of 8.
_CODES_OF_16_BITS = 257


def grey_of_16_bits(picture: Any) -> NDArray[np.uint8]:
    """Pixels of a grey picture of 16 bits, (H, W, 3); Pillow would clip them to 255."""
    codes = np.asarray(picture).astype(np.float32) / _CODES_OF_16_BITS
    grey = np.rint(np.clip(codes, 0, 255)).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=-1)


# Exponent of PNGs whose codes are sRGB as far as anybody can see.
_USUAL_GAMMA, _GAMMA_TOLERANCE = 0.45455, 0.02


def png_gamma(picture: Any) -> float | None:
    """Exponent of the codes of a PNG by its chunk gAMA; None where they are sRGB.

    A colour profile or a chunk sRGB counts more (PNG, third edition, 13.13).
    """
    gamma = picture.info.get("gamma")
    if not gamma or "icc_profile" in picture.info or "srgb" in picture.info:
        return None
    return float(gamma) if abs(gamma - _USUAL_GAMMA) > _GAMMA_TOLERANCE else None


class _BoundedReads:
    """A file whose reads allocate its size at most: a damaged chunk may claim to have gigabytes."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._size = file, os.fstat(file.fileno()).st_size

    def read(self, count: int = -1) -> bytes:
        return self._file.read(min(count, self._size))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


@contextmanager
def open_picture(
    path: Path,
    formats: Sequence[str],
    sample_bytes: int,
    unknown: str = "",
    data: bytes | None = None,
) -> Iterator[Any]:
    """Open a picture with Pillow and check its size.

    * `formats`: accepted formats, by Pillow's names.
    * `sample_bytes`: size of a decoded sample.
    * `unknown`: error message for other formats.
    * `data`: content of the picture, if already read or embedded in the file.

    Raises `FileError`: missing, damaged, unsupported, or suspiciously large when decoded.
    """
    from PIL import Image

    with open_file(path) if data is None else io.BytesIO(data) as file, silence_output():
        stream = _BoundedReads(file) if data is None else file
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # sizes are checked below
                with Image.open(stream, formats=formats) as picture:
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
            cause = cause or type(error).__name__
            raise FileError(f"{path}: not a readable picture ({cause}); save it again") from error


_ORIENTATION, _EXIF, _FOCAL_35MM = 0x0112, 0x8769, 0xA405
#: Diagonal of 35 mm film, mm: lenses are compared by it (CIPA DCG-001).
DIAGONAL_35MM = math.hypot(36, 24)


def read_exif(picture: Any) -> tuple[int, float]:
    """Orientation (1 to 8) and 35 mm equivalent focal length (0 if absent) of a Pillow picture.

    Pillow's exceptions for damaged EXIF pass through.
    """
    exif = picture.getexif()
    orientation = exif.get(_ORIENTATION)
    focal = exif.get_ifd(_EXIF).get(_FOCAL_35MM)
    focal = float(focal) if isinstance(focal, (int, float)) and focal > 0 else 0.0
    return orientation if orientation in range(1, 9) else 1, focal


# Header lines that start with -Y or +Y are excluded: they give the size.
_RADIANCE = re.compile(
    rb"#\?(?:RADIANCE|RGBE)\n((?:(?!-Y|\+Y)[\x20-\x7e\t]*\n)*?)\n"
    rb"-Y ([1-9]\d{0,4}) \+X ([1-9]\d{0,4})\n"
)
_FORMAT = re.compile(rb"^FORMAT=32-bit_rle_(rgbe|xyze)$", re.M)
# The format run-length codes only lines of these lengths.
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
    rows, columns = int(header[2]), int(header[3])
    check_unfolding(path, 12 * rows * columns)
    stream = io.BytesIO(data[header.end() :])
    try:
        if _SHORTEST_CODED <= columns <= _LONGEST_CODED and data[header.end() :][:2] == b"\2\2":
            codes = b"".join(_radiance_line(stream, columns) for _ in range(rows))
            rgbe = np.frombuffer(codes, np.uint8).reshape(rows, 4, columns).transpose(0, 2, 1)
        else:
            rgbe = np.frombuffer(stream.read(), np.uint8).reshape(rows, columns, 4)
    except ValueError:
        raise FileError(f"{path}: its pixels are damaged or cut short; save it again") from None
    scale = np.ldexp(np.float32(1), rgbe[..., 3].astype(np.int32) - _EXPONENT_OFFSET)
    scale = np.where(rgbe[..., 3] > 0, scale, np.float32(0))
    rgb = rgbe[..., :3] * scale[..., None]
    return rgb @ _RGB_FROM_XYZ.T if color[1] == b"xyze" else rgb


def _radiance_line(stream: io.BytesIO, columns: int) -> bytes:
    """Four channels of a run-length coded scan line; `ValueError` if it is damaged."""
    if stream.read(4) != b"\2\2" + columns.to_bytes(2, "big"):
        raise ValueError
    line = bytearray()
    for end in range(columns, 4 * columns + 1, columns):
        while len(line) < end:
            (count,) = stream.read(1)
            run = stream.read(1) * (count - 128) if count > 128 else stream.read(count)
            line += run
            if not run or len(line) > end:
                raise ValueError
    return bytes(line)


_PFM = re.compile(
    rb"(P[Ff])\s+(\d{1,6})\s+(\d{1,6})\s+([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)[ \t\r]*\n"
)
# Three floats for each of 2^28 pixels, and a header.
_MOST_PFM_BYTES = 12 * 2**28 + 2**10


def read_pfm(path: Path) -> np.ndarray:
    """Read a grey portable float map, (H, W) float32 with row 0 on top (at the end of the file).

    Raises `FileError`: damaged, wrong length, or in colour.
    """
    values, _ = _read_pfm(path)
    if values.shape[2] != 1:
        raise FileError(f"{path}: is a PFM in colour; save depth as a grey one, 'Pf'")
    return values[..., 0]


def _read_pfm(path: Path) -> tuple[np.ndarray, float]:
    """Values of a portable float map, (H, W, 1 or 3) float32, and its signed scale."""
    data = read_file(path, _MOST_PFM_BYTES)
    header = _PFM.match(data)
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
    return stored[::-1].astype(np.float32), float(header[4])


def write_pfm(path: Path, values: np.ndarray) -> None:
    """Write (H, W) numbers, row 0 on top, as a grey portable float map."""
    rows, columns = values.shape
    path.write_bytes(b"Pf\n%d %d\n-1\n" % (columns, rows) + values[::-1].astype("<f4").tobytes())


_VOLUME_HEAD = struct.Struct("<3sBiiiii6f")


def check_volume(path: Path) -> None:
    """Check a volume's header against its length: the renderer trusts the header.

    Raises `FileError`: missing, unsupported, or too short.
    """
    with open_file(path) as file:
        size, head = os.fstat(file.fileno()).st_size, file.read(_VOLUME_HEAD.size)
    if len(head) < _VOLUME_HEAD.size:
        raise FileError(f"{path}: not a grid of Mitsuba's .vol format; it is cut short")
    magic, version, kind, x, y, z, channels, *_ = _VOLUME_HEAD.unpack(head)
    if (magic, version, kind) != (b"VOL", 3, 1) or min(x, y, z, channels) < 1:
        raise FileError(f"{path}: not a grid of Mitsuba's .vol format, version 3, of float32")
    expected = _VOLUME_HEAD.size + 4 * x * y * z * channels
    if size < expected:
        raise FileError(
            f"{path}: a grid of {x} x {y} x {z} x {channels} is {expected} bytes long, this one is "
            f"{size}; it is cut short or damaged"
        )
