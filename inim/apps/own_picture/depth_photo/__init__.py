"""Photographs with depth inside: one file holds the colour picture and its depth.

| module  | contents                                                                        |
| ------- | ------------------------------------------------------------------------------- |
| `jpeg`  | JPEG: dynamic depth (Android), GDepth, and Apple's disparity as an extra image  |
| `codes` | decoding of integer codes to distances or disparities; XMP and Apple's metadata |

In HEIC and HEIF, depth is an auxiliary image of the photograph, read here with pillow-heif. The
coding of its numbers comes from Apple's metadata, stored as plain XMP packets, or from the codec's
depth_representation_info (ITU-T H.265), which has no unit.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inim.apps.own_picture.depth_photo.codes import (
    REMEDY,
    Coding,
    EmbeddedDepth,
    decode_depth,
    read_apple_camera,
    read_apple_coding,
    read_xmp,
    rotate_camera,
    rotate_upright,
)
from inim.apps.own_picture.depth_photo.jpeg import MAGIC, read_jpeg_depth
from inim.apps.own_picture.depth_values import DepthValues
from inim.apps.own_picture.fit import Pinhole
from inim.apps.own_picture.picture_files import convert_to_srgb, read_srgb
from inim.image.files.image import check_unfolding, silence_output
from inim.image.files.picture import DIAGONAL_35MM, open_picture, read_exif
from inim.system.errors import FileError, UsageError
from inim.system.files import read_file

#: File name suffixes of photographs.
SUFFIXES = (".heic", ".heif", ".hif", ".jpeg", ".jpg")
# Twice the size of a photograph of 200 megapixels.
_MAX_BYTES = 2**27
# Colour primaries (ITU-T H.273): those of BT.709, which are sRGB's; unspecified; absent.
_SRGB_PRIMARIES = (1, 2, None)
_SAME_SHAPE = 0.02
# Tag of the list of pictures in the multi-picture format.
_MPF_ENTRIES = 0xB002


@dataclass(frozen=True)
class DepthPhoto:
    """A photograph with depth inside."""

    color: NDArray[np.uint8]  #: (H, W, 3) uint8: sRGB, upright.
    values: DepthValues  #: Upright, at the resolution of the depth image.
    camera: Pinhole | None  #: Camera of the upright colour picture; None if the file has none.
    notes: tuple[str, ...]  #: Two lines: kind and scale of the depth; source of the camera.


def read_depth_photo(path: Path) -> DepthPhoto:
    """Read a photograph with depth inside.

    * `path`: HEIC or HEIF, or JPEG with dynamic depth, GDepth or Apple's disparity.

    Raises `FileError`: missing, damaged, unsupported format, or no depth. `UsageError`: the file is
    HEIC, and pillow-heif is not installed.
    """
    data = read_file(path, _MAX_BYTES)
    if is_heif(data):
        return _decode_photo(path, data, *read_heif(path, data), is_upright=True)
    if not data.startswith(MAGIC):
        raise FileError(
            f"{path}: neither HEIC nor JPEG; other pictures have no depth inside: add --depth "
            "FILE or --estimate-depth MODEL"
        )
    depth = read_jpeg_depth(path, data)
    with open_picture(path, ("JPEG",), 1, data=data) as picture:
        return _decode_photo(path, data, picture, read_exif(picture), depth, is_upright=False)


def read_photo_srgb(path: Path) -> NDArray[np.uint8]:
    """Colours of a photograph, with or without depth inside: (H, W, 3) uint8 sRGB, upright.

    Raises `FileError`: missing, damaged or unsupported format.
    """
    data = read_file(path, _MAX_BYTES)
    if not is_heif(data):
        return read_srgb(path)
    return np.asarray(convert_to_srgb(read_heif(path, data)[0], path).convert("RGB"))


def _decode_photo(
    path: Path,
    data: bytes,
    picture: Any,
    exif: tuple[int, float],
    depth: EmbeddedDepth | None,
    *,
    is_upright: bool,
) -> DepthPhoto:
    if depth is None:
        if is_stereo(data, picture):
            raise FileError(
                f"{path}: a spatial photograph: it contains a left and a right picture, which inim "
                "does not compare, and no depth; add --depth FILE or --estimate-depth MODEL"
            )
        raise FileError(
            f"{path}: no depth inside (HEIC, dynamic depth, GDepth or Apple's disparity); use the "
            "original file of a portrait photograph, or add --estimate-depth MODEL"
        )
    orientation, focal_35mm = exif
    color = np.asarray(convert_to_srgb(picture, path).convert("RGB"))
    values = decode_depth(depth)
    primaries = (picture.info.get("nclx_profile") or {}).get("color_primaries")
    if primaries not in _SRGB_PRIMARIES:
        warning = (
            f"{path}: its colour primaries are not sRGB's (nclx {primaries}) and were ignored; "
            "convert it to sRGB for exact colours"
        )
        values = replace(values, warnings=(*values.warnings, warning))
    if not is_upright:
        color = np.ascontiguousarray(rotate_upright(color, orientation))
        values = replace(
            values, depth=np.ascontiguousarray(rotate_upright(values.depth, orientation))
        )
    rows, columns = color.shape[:2]
    stored_size = (rows, columns) if orientation >= 5 else (columns, rows)
    camera, source = _find_camera(depth, stored_size, focal_35mm)
    camera = None if camera is None else rotate_camera(camera, stored_size, orientation)
    return DepthPhoto(color, values, camera, (_describe_scale(values, depth), source))


def _describe_scale(values: DepthValues, depth: EmbeddedDepth) -> str:
    if values.has_unit:
        return f"{depth.coding.description}: metric"
    trend = "numbers grow towards the camera" if values.near_is_large else "numbers grow away"
    return f"{depth.coding.description}: relative, no millimetres ({trend})"


def _find_camera(
    depth: EmbeddedDepth, size: tuple[int, int], focal_35mm: float
) -> tuple[Pinhole | None, str]:
    """Camera of the stored colour picture of `size` (columns, rows), and its source."""
    camera, (columns, rows) = depth.camera, depth.camera_size
    numbers = () if camera is None else (camera.fx, camera.fy, camera.cx, camera.cy, columns, rows)
    if camera is not None and all(map(math.isfinite, numbers)) and min(columns, rows) > 0:
        x, y = size[0] / columns, size[1] / rows
        scaled = Pinhole(
            camera.fx * x, camera.fy * y, (camera.cx + 0.5) * x - 0.5, (camera.cy + 0.5) * y - 0.5
        )
        if abs(x / y - 1) <= _SAME_SHAPE and min(scaled.fx, scaled.fy) > 0:
            return scaled, "camera by the file's calibration"
    if 0 < focal_35mm < math.inf:
        focal = focal_35mm * math.hypot(*size) / DIAGONAL_35MM
        middle = ((size[0] - 1) / 2, (size[1] - 1) / 2)
        return Pinhole(focal, focal, *middle), f"camera by EXIF, {focal_35mm:g} mm in 35 mm film"
    return None, "camera unknown"


_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1")
_BEGIN, _END = b"<x:xmpmeta", b"</x:xmpmeta>"
_MAX_PACKETS = 64
_MAX_PACKET_BYTES = 2**20
# Types of depth_representation_info; a fourth type, a table, is not supported.
_INVERSE, _DISPARITY, _DISTANCE = range(3)


def is_heif(data: bytes) -> bool:
    """True if the content is HEIC or HEIF."""
    return data[4:8] == b"ftyp" and data[8:12] in _BRANDS


def is_stereo(data: bytes, picture: Any) -> bool:
    """True for a spatial photograph: a stereo pair in HEIF or in the multi-picture format.

    * `data`, `picture`: content of the file, and Pillow's picture of it.
    """
    if is_heif(data):  # ISO/IEC 14496-12: a group of the type `ster` in the box `grpl`
        start = data.find(b"grpl")
        length = int.from_bytes(data[max(start - 4, 0) : max(start, 0)], "big")
        return start >= 0 and b"ster" in data[start : start - 4 + length]
    entries = getattr(picture, "mpinfo", {}).get(_MPF_ENTRIES, ())  # CIPA DC-007
    return any(entry["Attribute"]["MPType"].endswith("(Disparity)") for entry in entries)


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
