"""Depth inside HEIC and HEIF: an auxiliary image of the photograph, by the package pillow-heif.

What its numbers stand for is said by Apple's metadata, which lie in the file as plain XMP packets,
or by the codec's depth_representation_info (ITU-T H.265), which knows no unit.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from inim.errors import FileError, UsageError
from inim.files.image import check_unfolding, hushed
from inim.from_camera.depth_photo.codes import (
    REMEDY,
    Coding,
    EmbeddedDepth,
    read_apple_camera,
    read_apple_coding,
    read_exif,
    read_xmp,
)

_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1")
_BEGIN, _END = b"<x:xmpmeta", b"</x:xmpmeta>"
_MOST_PACKETS = 64
_MOST_PACKET_BYTES = 2**20
# Kinds of depth_representation_info: inverse distance, disparity, distance; a fourth is a table.
_INVERSE, _DISPARITY, _DISTANCE = range(3)


def is_heif(data: bytes) -> bool:
    """Whether a file begins as HEIC or HEIF do."""
    return data[4:8] == b"ftyp" and data[8:12] in _BRANDS


def read_heif(path: Path, data: bytes) -> tuple[Any, tuple[int, float], EmbeddedDepth | None]:
    """The picture, for Pillow, what `by_exif` says, and its depth or None; both upright already.

    Raises
    ------
    UsageError
        pillow-heif is not installed.
    FileError
        Damaged, or unfolding to far more than its size.
    """
    try:
        import pillow_heif
    except ImportError as error:
        raise UsageError(
            f"{path}: HEIC photographs need pillow-heif, which is not installed: "
            "pip install 'inim[photos]'"
        ) from error
    try:
        with hushed():
            file = pillow_heif.open_heif(data)
            image = file[file.primary_index]
            depths = image.info["depth_images"]
            for one in (image, *depths[:1]):
                check_unfolding(path, 4 * one.size[0] * one.size[1], len(data))
            picture = image.to_pillow()
            picture.info["exif"] = image.info.get("exif") or b""  # pillow-heif made it say upright
            exif = read_exif(picture)
            codes = np.asarray(depths[0].to_pillow()) if depths else None
    except (FileError, MemoryError):
        raise
    except Exception as error:
        cause = str(error).partition("\n")[0]
        raise FileError(f"{path}: not a readable HEIC ({cause}); {REMEDY}") from error
    if codes is None:
        return picture, exif, None
    if codes.ndim != 2 or codes.dtype not in (np.uint8, np.uint16):
        raise FileError(f"{path}: its depth image is none in grey of 8 or 16 bits")
    coding, camera, size = None, None, (0.0, 0.0)
    for packet in _packets(data):
        nodes = read_xmp(packet, path)
        coding = read_apple_coding(nodes, path)
        if coding is not None:
            camera, size = read_apple_camera(nodes)
            break
    inside = EmbeddedDepth(codes, coding or _represented(depths[0], path), camera, size)
    return picture, exif, inside


def _packets(data: bytes) -> list[bytes]:
    """The XMP packets, found as their standard has scanners find them."""
    packets: list[bytes] = []
    at = 0
    for _ in range(_MOST_PACKETS):  # whole ones or not: no file makes this slow
        begin = data.find(_BEGIN, at)
        if begin < 0:
            break
        end = data.find(_END, begin, begin + _MOST_PACKET_BYTES)
        at = (begin if end < 0 else end) + len(_BEGIN)
        if end >= 0:
            packets.append(data[begin : end + len(_END)])
    return packets


def _represented(depth: Any, path: Path) -> Coding:
    """Coding by the codec's own words; the larger the nearer where it has none."""
    said = depth.info.get("metadata") or {}
    kind = said.get("representation_type")
    names = ("d_min", "d_max") if kind == _DISPARITY else ("z_near", "z_far")
    near, far = (float(said.get(name, np.nan)) for name in names)
    words = "HEIF depth without Apple's metadata"
    if kind == _INVERSE and 0 < near < far:
        return Coding(True, 1 / far, 1 / near, 0.0, f"{words}: inverse distance")
    if kind == _DISTANCE and 0 <= near < far:
        return Coding(False, near, far, 0.0, f"{words}: distance")
    if kind == _DISPARITY and 0 <= near < far:
        return Coding(True, near, far, 0.0, f"{words}: disparity")
    if kind in (None, _INVERSE, _DISPARITY):
        return Coding(True, 0.0, 1.0, 0.0, f"{words}: disparity of unknown range")
    raise FileError(
        f"{path}: its depth is of a kind that is not read (depth representation {kind}); {REMEDY}"
    )
