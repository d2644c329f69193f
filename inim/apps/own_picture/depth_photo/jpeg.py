"""Depth inside a JPEG, in the three documented formats.

Dynamic depth (Dynamic Depth 1.0, Android): images are appended to the photograph and listed in its
XMP metadata. GDepth (Google's earlier depth map metadata): the depth image is base64 in the
metadata, usually in their extension. Apple: the disparity is an extra image of a multi-picture file
(CIPA DC-007), identified by its metadata.
"""

import binascii
import io
import re
import struct
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from inim.apps.own_picture.depth_photo.codes import (
    REMEDY,
    Coding,
    EmbeddedDepth,
    collect_properties,
    parse_number,
    read_apple_camera,
    read_apple_coding,
    read_xmp,
)
from inim.apps.own_picture.fit import Pinhole
from inim.apps.own_picture.picture_files import depth_numbers
from inim.image.files.picture import open_picture
from inim.system.errors import FileError

MAGIC = b"\xff\xd8\xff"
_XMP, _EXTENDED = b"http://ns.adobe.com/xap/1.0/\0", b"http://ns.adobe.com/xmp/extension/\0"
_MPF = b"MPF\0"
# Tag of the image list in an MP index.
_MP_ENTRIES = 0xB002
_APP1, _APP2, _SOS, _EOI = 0xE1, 0xE2, 0xDA, 0xD9
# An extension of 256 MiB takes 4096 segments; scans of a progressive picture a few dozen.
_MAX_SEGMENTS = 10_000
# In coded data, 0xff precedes 0 or a restart marker; any other 0xff begins a segment.
_MARKER = re.compile(rb"\xff([^\x00\xff\xd0-\xd7])")
_UNITS_MM = {"m": 1000.0, "meters": 1000.0, "mm": 1.0, "millimeters": 1.0}
_RANGES = ("rangeinverse", "rangelinear")
_GUID_BYTES = 32


def read_jpeg_depth(path: Path, data: bytes) -> EmbeddedDepth | None:
    """Depth inside a JPEG; None if there is no supported one."""
    parts = list(_segments(path, data))
    nodes = _metadata(path, parts)
    google = collect_properties(nodes, "GDepth")
    if "GDepth:Data" in google:
        try:
            image = binascii.a2b_base64(google["GDepth:Data"])
        except ValueError as error:
            raise FileError(f"{path}: GDepth:Data is not base64 ({error}); {REMEDY}") from None
        return _google(path, image, google, "GDepth", nodes)
    for node in nodes:
        if "DepthMap:DepthURI" in node and node.get("DepthMap:ItemSemantic") != "Segmentation":
            image = _appended(path, data, parts[-1][1], node["DepthMap:DepthURI"], nodes)
            return _google(path, image, node, "DepthMap", nodes)
    return _apple(path, data, parts)


def _segments(path: Path, data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Kind, offset and content of each segment of a JPEG; the last is the end marker."""
    at = 2
    for _ in range(_MAX_SEGMENTS):
        marker = _MARKER.search(data, at)
        if not marker:
            raise FileError(f"{path}: the JPEG has no end marker, as it is truncated; {REMEDY}")
        kind, begin = marker[1][0], marker.end()
        if kind == _EOI:
            yield kind, begin, b""
            return
        (length,) = struct.unpack(">H", data[begin : begin + 2].ljust(2, b"\0"))
        if length < 2 or begin + length > len(data):
            raise FileError(
                f"{path}: a segment of {length} bytes at {begin} ends beyond the file; {REMEDY}"
            )
        yield kind, begin + 2, data[begin + 2 : begin + length] if kind != _SOS else b""
        at = begin + length
    raise FileError(f"{path}: the JPEG has more than {_MAX_SEGMENTS} segments; {REMEDY}")


def _metadata(path: Path, parts: list[tuple[int, int, bytes]]) -> list[dict[str, str]]:
    """Properties of the XMP packet and of its extension."""
    texts = [text for kind, _, text in parts if kind == _APP1]
    packet = next((text[len(_XMP) :] for text in texts if text.startswith(_XMP)), b"")
    if not packet:
        return []
    nodes = read_xmp(packet, path)
    guid = collect_properties(nodes, "xmpNote").get("xmpNote:HasExtendedXMP", "").encode()
    pieces = [text[len(_EXTENDED) :] for text in texts if text.startswith(_EXTENDED)]
    pieces = [piece for piece in pieces if guid and piece.startswith(guid)]
    if not guid or not pieces:
        return nodes
    heads = [piece[_GUID_BYTES : _GUID_BYTES + 8].ljust(8, b"\0") for piece in pieces]
    chunks = sorted(
        (struct.unpack(">II", head)[1], piece[_GUID_BYTES + 8 :])
        for head, piece in zip(heads, pieces, strict=True)
    )
    extension = b"".join(chunk for _, chunk in chunks)
    (size,) = struct.unpack(">I", heads[0][:4])
    ends = np.cumsum([0, *(len(chunk) for _, chunk in chunks)])
    if [offset for offset, _ in chunks] != list(ends[:-1]) or ends[-1] != size:
        raise FileError(
            f"{path}: its extended XMP metadata have {len(extension)} of {size} bytes; {REMEDY}"
        )
    return nodes + read_xmp(extension, path)


def _google(
    path: Path, image: bytes, properties: dict[str, str], prefix: str, nodes: list[dict[str, str]]
) -> EmbeddedDepth:
    """Depth of GDepth or dynamic depth, which share their property names except the prefix.

    ``RangeLinear``: ``d = near + v (far - near)``; ``RangeInverse``:
    ``d = far near / (far - v (far - near))``, so 1 / d is linear between 1 / near and 1 / far.
    """
    form = properties.get(f"{prefix}:Format", "")
    if form.lower() not in _RANGES:
        raise FileError(
            f"{path}: unsupported {prefix}:Format {form[:40]!r}; convert it to RangeInverse or "
            "RangeLinear"
        )
    near, far = (
        parse_number(properties.get(f"{prefix}:{end}"), path, f"{prefix}:{end}")
        for end in ("Near", "Far")
    )
    units = properties.get(f"{prefix}:Units")
    unit_mm = _UNITS_MM.get((units or "").lower(), 0.0)
    name = "GDepth" if prefix == "GDepth" else "dynamic depth"
    scale = f"{form} {near:g} .. {far:g}, units {units[:20] if units else 'not given'}"
    is_inverse = form.lower() == _RANGES[0]
    if not (0 < near <= far if is_inverse else 0 <= near <= far and far > 0):
        raise FileError(
            f"{path}: its depth, {form}, has an invalid range from Near {near:g} to Far {far:g}; "
            f"{REMEDY}"
        )
    ends = (1 / near, 1 / far) if is_inverse else (near, far)
    coding = Coding(is_inverse, *ends, unit_mm, f"{name}, {scale}")
    along_ray = properties.get(f"{prefix}:MeasureType", "").lower() == "opticray"
    camera, size = _google_camera(nodes)
    return EmbeddedDepth(_decode_image(path, image), coding, camera, size, along_ray=along_ray)


def _google_camera(nodes: list[dict[str, str]]) -> tuple[Pinhole | None, tuple[float, float]]:
    """Camera of the imaging model and its picture size.

    Principal points within 0 .. 1 are shares of the size, others are in pixels.
    """
    properties = collect_properties(nodes, "ImagingModel")
    try:
        fx, fy, columns, rows = (
            float(properties[f"ImagingModel:{name}"])
            for name in ("FocalLengthX", "FocalLengthY", "ImageWidth", "ImageHeight")
        )
        x, y = (float(properties.get(f"ImagingModel:PrincipalPoint{axis}", 0.5)) for axis in "XY")
    except (KeyError, ValueError):
        return None, (0.0, 0.0)
    if 0 <= x <= 1 and 0 <= y <= 1:
        x, y = x * columns, y * rows
    return Pinhole(fx, fy, x - 0.5, y - 0.5), (columns, rows)


def _decode_image(path: Path, image: bytes) -> np.ndarray:
    """Codes of a depth image, (h, w) uint8 or uint16."""
    problem = f"its depth is not JPEG or PNG; {REMEDY}"
    with open_picture(path, ("JPEG", "PNG"), 4, problem, image) as picture:
        numbers = depth_numbers(picture, path, [])
    return numbers if numbers.dtype == np.uint16 else numbers.astype(np.uint8)


def _appended(path: Path, data: bytes, end: int, uri: str, nodes: list[dict[str, str]]) -> bytes:
    """Image `uri` among those appended to the photograph in the order of the directory."""
    at = end
    for index, item in enumerate(node for node in nodes if "Item:Mime" in node):
        length, padding = (_parse_size(path, item, name) for name in ("Length", "Padding"))
        if index == 0:  # the photograph itself
            at = (length or end) + padding
            continue
        if uri in (item.get("Item:DataURI"), item.get("Item:URI")):
            if length == 0 or at + length > len(data):
                raise FileError(
                    f"{path}: truncated: {length} bytes of depth at {at} do not fit the file's "
                    f"{len(data)}; {REMEDY}"
                )
            return data[at : at + length]
        at += length + padding
    raise FileError(
        f"{path}: its depth picture {uri[:80]!r} is missing from its directory; {REMEDY}"
    )


def _parse_size(path: Path, item: dict[str, str], name: str) -> int:
    text = item.get(f"Item:{name}", "0")
    if not (text.isascii() and text.isdigit() and len(text) <= 10):
        raise FileError(f"{path}: Item:{name} {text[:40]!r} is not a size; {REMEDY}")
    return int(text)


def _apple(path: Path, data: bytes, parts: list[tuple[int, int, bytes]]) -> EmbeddedDepth | None:
    """Disparity or depth among the extra images of a multi-picture file."""
    offsets = [at for kind, at, text in parts if kind == _APP2 and text.startswith(_MPF)]
    if not offsets:
        return None
    for begin, size in _extra_images(path, data, offsets[0] + len(_MPF)):
        picture = data[begin : begin + size]
        if not picture.startswith(MAGIC):
            continue
        nodes = _metadata(path, list(_segments(path, picture)))
        coding: Coding | None = read_apple_coding(nodes, path)
        if coding is not None:
            return EmbeddedDepth(_decode_image(path, picture), coding, *read_apple_camera(nodes))
    return None


def _extra_images(path: Path, data: bytes, base: int) -> list[tuple[int, int]]:
    """Offset and size of all images except the first; `base` is the offset of the MP index."""
    from PIL import MpoImagePlugin

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with MpoImagePlugin.MpoImageFile(io.BytesIO(data)) as picture:
                entries = picture.mpinfo[_MP_ENTRIES][1:]
        pictures = [(base + entry["DataOffset"], entry["Size"]) for entry in entries]
    except Exception as error:  # any exception of Pillow
        raise FileError(f"{path}: its list of images (MPF) is damaged; {REMEDY}") from error
    for begin, length in pictures:
        if begin + length > len(data):
            raise FileError(
                f"{path}: truncated: an image of {length} bytes at {begin} does not fit the file's "
                f"{len(data)}; {REMEDY}"
            )
    return pictures
