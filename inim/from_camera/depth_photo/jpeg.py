"""Depth inside a JPEG, in the three ways that are documented.

Dynamic depth (Dynamic Depth 1.0, Android): pictures are appended to the first one and listed in its
XMP metadata. GDepth (Google's depth map metadata, before it): the depth image is base64 in the
metadata, mostly in their extension. Apple: the disparity is one of the further pictures of a
multi-picture file (CIPA DC-007), known by its own metadata.
"""

from __future__ import annotations

import binascii
import io
import re
import struct
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from inim.errors import FileError
from inim.files.picture import open_picture
from inim.from_camera.depth_photo.codes import (
    REMEDY,
    Coding,
    EmbeddedDepth,
    read_apple_camera,
    read_apple_coding,
    merged,
    number,
    ranged,
    read_xmp,
)
from inim.from_camera.fit import Pinhole
from inim.from_camera.picture_files import depth_numbers

MAGIC = b"\xff\xd8\xff"
_XMP, _EXTENDED = b"http://ns.adobe.com/xap/1.0/\0", b"http://ns.adobe.com/xmp/extension/\0"
_MPF = b"MPF\0"
# Tag of the list of pictures in an MP index.
_MP_ENTRIES = 0xB002
_APP1, _APP2, _SOS, _EOI = 0xE1, 0xE2, 0xDA, 0xD9
# An extension of 256 MiB takes 4096 segments; scans of a progressive picture some tens.
_MOST_SEGMENTS = 10_000
# In coded data 0xff stands before 0 or a restart; before anything else it begins a segment.
_MARKER = re.compile(rb"\xff([^\x00\xff\xd0-\xd7])")
_UNITS_MM = {"m": 1000.0, "meters": 1000.0, "mm": 1.0, "millimeters": 1.0}
_RANGES = ("rangeinverse", "rangelinear")
_GUID_BYTES = 32


def read_jpeg_depth(path: Path, data: bytes) -> EmbeddedDepth | None:
    """The depth inside a JPEG; None where there is none that is known.

    Raises
    ------
    FileError
        It is damaged.
    """
    parts = list(_segments(path, data))
    nodes = _metadata(path, parts)
    google = merged(nodes, "GDepth")
    if "GDepth:Data" in google:
        try:
            image = binascii.a2b_base64(google["GDepth:Data"])
        except ValueError as error:
            raise FileError(f"{path}: GDepth:Data is no base64 ({error}); {REMEDY}") from None
        return _google(path, image, google, "GDepth", nodes)
    for node in nodes:
        if "DepthMap:DepthURI" in node and node.get("DepthMap:ItemSemantic") != "Segmentation":
            image = _appended(path, data, parts[-1][1], node["DepthMap:DepthURI"], nodes)
            return _google(path, image, node, "DepthMap", nodes)
    return _apple(path, data, parts)


def _segments(path: Path, data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Kind, place and content of each segment of a JPEG; its end is the last."""
    at = 2
    for _ in range(_MOST_SEGMENTS):
        found = _MARKER.search(data, at)
        if not found:
            raise FileError(f"{path}: the JPEG has no end; it is cut short")
        kind, begin = found[1][0], found.end()
        if kind == _EOI:
            yield kind, begin, b""
            return
        (length,) = struct.unpack(">H", data[begin : begin + 2].ljust(2, b"\0"))
        if length < 2 or begin + length > len(data):
            raise FileError(f"{path}: a segment of {length} bytes at {begin} ends beyond the file")
        yield kind, begin + 2, data[begin + 2 : begin + length] if kind != _SOS else b""
        at = begin + length
    raise FileError(f"{path}: the JPEG has more than {_MOST_SEGMENTS} segments; it is damaged")


def _metadata(path: Path, parts: list[tuple[int, int, bytes]]) -> list[dict[str, str]]:
    """The properties of the XMP packet and of its extension."""
    texts = [text for kind, _, text in parts if kind == _APP1]
    packet = next((text[len(_XMP) :] for text in texts if text.startswith(_XMP)), b"")
    if not packet:
        return []
    nodes = read_xmp(packet, path)
    guid = merged(nodes, "xmpNote").get("xmpNote:HasExtendedXMP", "").encode()
    pieces = [text[len(_EXTENDED) :] for text in texts if text.startswith(_EXTENDED)]
    pieces = [piece for piece in pieces if guid and piece.startswith(guid)]
    if not guid or not pieces:
        return nodes
    heads = [piece[_GUID_BYTES : _GUID_BYTES + 8].ljust(8, b"\0") for piece in pieces]
    placed = sorted(
        (struct.unpack(">II", head)[1], piece[_GUID_BYTES + 8 :])
        for head, piece in zip(heads, pieces, strict=True)
    )
    extension = b"".join(piece for _, piece in placed)
    (whole,) = struct.unpack(">I", heads[0][:4])
    ends = np.cumsum([0, *(len(piece) for _, piece in placed)])
    if [place for place, _ in placed] != list(ends[:-1]) or ends[-1] != whole:
        raise FileError(
            f"{path}: {len(extension)} of the {whole} bytes of its extended XMP metadata are there;"
            f" {REMEDY}"
        )
    return nodes + read_xmp(extension, path)


def _google(
    path: Path, image: bytes, found: dict[str, str], prefix: str, nodes: list[dict[str, str]]
) -> EmbeddedDepth:
    """What GDepth and dynamic depth say in the same words, but for their prefix."""
    form = found.get(f"{prefix}:Format", "")
    if form.lower() not in _RANGES:
        raise FileError(
            f"{path}: {prefix}:Format {form[:40]!r}: RangeInverse and RangeLinear are known"
        )
    near, far = (number(found.get(f"{prefix}:{e}"), path, f"{prefix}:{e}") for e in ("Near", "Far"))
    units = found.get(f"{prefix}:Units")
    unit_mm = _UNITS_MM.get((units or "").lower(), 0.0)
    name = "GDepth" if prefix == "GDepth" else "dynamic depth"
    said = f"{name}, {form} {near:g} .. {far:g}, units {units[:20] if units else 'not stated'}"
    coding = ranged(path, form, near, far, unit_mm, said, form.lower() == _RANGES[0])
    ray = found.get(f"{prefix}:MeasureType", "").lower() == "opticray"
    return EmbeddedDepth(_numbers(path, image), coding, *_google_camera(nodes), along_ray=ray)


def _google_camera(nodes: list[dict[str, str]]) -> tuple[Pinhole | None, tuple[float, float]]:
    """The imaging model: in pixels of the size it states; its middle as a share of that, or so."""
    found = merged(nodes, "ImagingModel")
    try:
        fx, fy, columns, rows = (
            float(found[f"ImagingModel:{name}"])
            for name in ("FocalLengthX", "FocalLengthY", "ImageWidth", "ImageHeight")
        )
        x, y = (float(found.get(f"ImagingModel:PrincipalPoint{axis}", 0.5)) for axis in "XY")
    except (KeyError, ValueError):
        return None, (0.0, 0.0)
    if 0 <= x <= 1 and 0 <= y <= 1:
        x, y = x * columns, y * rows
    return Pinhole(fx, fy, x - 0.5, y - 0.5), (columns, rows)


def _numbers(path: Path, image: bytes) -> np.ndarray:
    """The numbers of a depth image, (h, w) uint8 or uint16."""
    with open_picture(path, ("JPEG", "PNG"), 4, "its depth is no JPEG or PNG", image) as picture:
        numbers = depth_numbers(picture, path)
    return numbers if numbers.dtype == np.uint16 else numbers.astype(np.uint8)


def _appended(path: Path, data: bytes, end: int, uri: str, nodes: list[dict[str, str]]) -> bytes:
    """The picture of that name behind the end of the first; they lie there in their order."""
    at = end
    for place, item in enumerate(node for node in nodes if "Item:Mime" in node):
        length, padding = (_size(path, item, name) for name in ("Length", "Padding"))
        if place == 0:  # the photograph itself
            at = (length or end) + padding
            continue
        if uri in (item.get("Item:DataURI"), item.get("Item:URI")):
            if length == 0 or at + length > len(data):
                raise FileError(
                    f"{path}: its depth should be {length} bytes at {at}, and the file has "
                    f"{len(data)}; appended pictures were cut off: {REMEDY}"
                )
            return data[at : at + length]
        at += length + padding
    raise FileError(
        f"{path}: names a depth picture {uri[:80]!r} that its directory does not list; {REMEDY}"
    )


def _size(path: Path, item: dict[str, str], name: str) -> int:
    text = item.get(f"Item:{name}", "0")
    if not (text.isascii() and text.isdigit() and len(text) <= 10):
        raise FileError(f"{path}: Item:{name} {text[:40]!r} of a picture in it is no size")
    return int(text)


def _apple(path: Path, data: bytes, parts: list[tuple[int, int, bytes]]) -> EmbeddedDepth | None:
    """The disparity or depth among the further pictures of a multi-picture file."""
    places = [at for kind, at, text in parts if kind == _APP2 and text.startswith(_MPF)]
    if not places:
        return None
    for begin, size in _further(path, data, places[0] + len(_MPF)):
        picture = data[begin : begin + size]
        if not picture.startswith(MAGIC):
            continue
        nodes = _metadata(path, list(_segments(path, picture)))
        coding: Coding | None = read_apple_coding(nodes, path)
        if coding is not None:
            return EmbeddedDepth(_numbers(path, picture), coding, *read_apple_camera(nodes))
    return None


def _further(path: Path, data: bytes, base: int) -> list[tuple[int, int]]:
    """Place and size of all pictures but the first; offsets count from the MP index."""
    from PIL import MpoImagePlugin

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with MpoImagePlugin.MpoImageFile(io.BytesIO(data)) as picture:
                entries = picture.mpinfo[_MP_ENTRIES][1:]
        pictures = [(base + entry["DataOffset"], entry["Size"]) for entry in entries]
    except Exception as error:  # whatever Pillow raises
        raise FileError(f"{path}: its list of pictures (MPF) is damaged; {REMEDY}") from error
    for begin, length in pictures:
        if begin + length > len(data):
            raise FileError(
                f"{path}: lists a picture of {length} bytes at {begin}, and the file has "
                f"{len(data)}; it is cut short: {REMEDY}"
            )
    return pictures
