"""Depth inside HEIC and HEIF: an auxiliary image of the photograph, read with pillow-heif.

The coding of its numbers comes from Apple's metadata, stored as plain XMP packets, or from the
codec's depth_representation_info (ITU-T H.265), which has no unit.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from inim.errors import FileError, UsageError
from inim.files.image import check_unfolding, silence_output
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
_MAX_PACKETS = 64
_MAX_PACKET_BYTES = 2**20
# Types of depth_representation_info; a fourth type, a table, is not supported.
_INVERSE, _DISPARITY, _DISTANCE = range(3)


def is_heif(data: bytes) -> bool:
    """True if the content is HEIC or HEIF."""
    return data[4:8] == b"ftyp" and data[8:12] in _BRANDS


def read_heif(path: Path, data: bytes) -> tuple[Any, tuple[int, float], EmbeddedDepth | None]:
    """Read the Pillow picture, the result of `read_exif`, and the depth (None if absent).

    Picture and depth are upright already. Raises `FileError` for a damaged file, and `UsageError`
    if pillow-heif is not installed.
    """
    try:
        import pillow_heif
    except ImportError as error:
        raise UsageError(
            f"{path}: HEIC photographs need pillow-heif, which is not installed: "
            "pip install 'inim[photos]'"
        ) from error
    try:
        with silence_output():
            file = pillow_heif.open_heif(data)
            image = file[file.primary_index]
            depths = image.info["depth_images"]
            for part in (image, *depths[:1]):
                check_unfolding(path, 4 * part.size[0] * part.size[1], len(data))
            picture = image.to_pillow()
            picture.info["exif"] = image.info.get("exif") or b""  # pillow-heif sets it to upright
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
        raise FileError(f"{path}: its depth image is not grey of 8 or 16 bits; {REMEDY}")
    coding, camera, size = None, None, (0.0, 0.0)
    for packet in _packets(data):
        nodes = read_xmp(packet, path)
        coding = read_apple_coding(nodes, path)
        if coding is not None:
            camera, size = read_apple_camera(nodes)
            break
    depth = EmbeddedDepth(codes, coding or _codec_coding(depths[0], path), camera, size)
    return picture, exif, depth


def _packets(data: bytes) -> list[bytes]:
    """XMP packets, located by their markers as the standard recommends."""
    packets: list[bytes] = []
    at = 0
    for _ in range(_MAX_PACKETS):  # counts incomplete packets too, which bounds the time
        begin = data.find(_BEGIN, at)
        if begin < 0:
            break
        end = data.find(_END, begin, begin + _MAX_PACKET_BYTES)
        at = (begin if end < 0 else end) + len(_BEGIN)
        if end >= 0:
            packets.append(data[begin : end + len(_END)])
    return packets


def _codec_coding(depth: Any, path: Path) -> Coding:
    """Coding from the codec's metadata; a disparity of unknown range without them."""
    metadata = depth.info.get("metadata") or {}
    kind = metadata.get("representation_type")
    names = ("d_min", "d_max") if kind == _DISPARITY else ("z_near", "z_far")
    near, far = (float(metadata.get(name, np.nan)) for name in names)
    source = "HEIF depth without Apple's metadata"
    if kind == _INVERSE and 0 < near < far:
        return Coding(True, 1 / far, 1 / near, 0.0, f"{source}: inverse distance")
    if kind == _DISTANCE and 0 <= near < far:
        return Coding(False, near, far, 0.0, f"{source}: distance")
    if kind == _DISPARITY and 0 <= near < far:
        return Coding(True, near, far, 0.0, f"{source}: disparity")
    if kind in (None, _INVERSE, _DISPARITY):
        return Coding(True, 0.0, 1.0, 0.0, f"{source}: disparity of unknown range")
    raise FileError(f"{path}: unsupported depth representation {kind}; {REMEDY}")
