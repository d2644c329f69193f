"""Depth inside a photograph: whole numbers, what they stand for, and the metadata about them.

All formats quantise one of two quantities evenly: the distance, or its inverse (a disparity). With
``v`` the number over the largest there is, ``q = first + v (last - first)`` is that quantity.

Apple's ``apdi:FloatMinValue`` and ``FloatMaxValue`` are the quantity at the least and the largest
number: 1/m for a disparity, m for a depth. Only ``depthData:Accuracy`` "absolute" vouches for the
metres. XMP (ISO 16684-1) is XML from anybody, read in bounded time: a document type, the only way
to entities, is refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

from inim.errors import FileError
from inim.from_camera.depth_values import DepthValues
from inim.from_camera.fit import Pinhole

REMEDY = "take the photograph's original file"
_KINDS = ("disparity", "depth")
_NAMESPACES = {
    "http://ns.google.com/photos/1.0/depthmap/": "GDepth",
    "http://ns.google.com/photos/dd/1.0/depthmap/": "DepthMap",
    "http://ns.google.com/photos/dd/1.0/item/": "Item",
    "http://ns.google.com/photos/1.0/container/item/": "Item",
    "http://ns.google.com/photos/dd/1.0/imagingmodel/": "ImagingModel",
    "http://ns.apple.com/pixeldatainfo/1.0/": "apdi",
    "http://ns.apple.com/depthData/1.0/": "depthData",
    "http://ns.adobe.com/xmp/note/": "xmpNote",
}
_DEEPEST = 64
_MOST_ELEMENTS = 20_000
# Texts up to this length count as their parents', too: the numbers of a list are one text so.
_SHORT = 4096
# Of distances, in any unit; beyond it a float's own precision is used up.
_LARGEST = 1e9
_ORIENTATION, _EXIF, _FOCAL_35MM = 0x0112, 0x8769, 0xA405
_RAY = "a photograph's depth, measured along the ray, was taken as along the optical axis"


@dataclass(frozen=True)
class Coding:
    """What the numbers of a depth image stand for.

    Attributes
    ----------
    inverse : bool
        Whether they quantise the inverse of the distance.
    first, last : float
        The quantity at number 0 and at the largest number.
    unit_mm : float
        Millimetres of the unit of distance; 0 where the file does not vouch for one.
    said : str
        The kind of file, and what it says of the scale.
    """

    inverse: bool
    first: float
    last: float
    unit_mm: float
    said: str


@dataclass(frozen=True)
class EmbeddedDepth:
    """A depth image as it lies in a photograph.

    Attributes
    ----------
    codes : (h, w) uint8 or uint16
    coding : Coding
    camera : Pinhole or None
        Of the stored colour picture, before it is turned upright.
    camera_size : (columns, rows)
        Of the picture that `camera` is stated for.
    along_ray : bool
        Distances go along the ray rather than along the optical axis.
    """

    codes: np.ndarray
    coding: Coding
    camera: Pinhole | None = None
    camera_size: tuple[float, float] = (0.0, 0.0)
    along_ray: bool = False


def number(text: str | None, path: Path, name: str) -> float:
    """A finite number of a photograph's metadata.

    Raises
    ------
    FileError
        Missing or none.
    """
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not abs(value) <= _LARGEST:
        shown = "is missing" if text is None else f"is {text[:40]!r}, no usable number"
        raise FileError(f"{path}: {name} of its depth {shown}; {REMEDY}")
    return value


def ranged(
    path: Path, form: str, near: float, far: float, unit_mm: float, said: str, inverse: bool
) -> Coding:
    """Coding of a depth image that states its nearest and farthest distance.

    ``RangeLinear``: ``d = near + v (far - near)``; ``RangeInverse``:
    ``d = far near / (far - v (far - near))``, so 1 / d goes evenly from 1 / near to 1 / far.

    Raises
    ------
    FileError
        A range that is none.
    """
    if not (0 < near <= far if inverse else 0 <= near <= far and far > 0):
        raise FileError(
            f"{path}: its depth, {form}, goes from Near {near:g} to Far {far:g}; distances from "
            "the camera are above 0 and Near is less: the file is damaged"
        )
    ends = (1 / near, 1 / far) if inverse else (near, far)
    return Coding(inverse, *ends, unit_mm, said)


def decoded(inside: EmbeddedDepth) -> DepthValues:
    """Distances in mm where the file vouches for a unit; otherwise plain numbers.

    An inverse without a unit stays one, larger where nearer: taken as orthographic, planes stay
    planes under it.
    """
    coding, most = inside.coding, np.iinfo(inside.codes.dtype).max
    said = (_RAY,) if inside.along_ray else ()
    step = abs(coding.last - coding.first) / most
    share = inside.codes.astype(np.float64) / most
    numbers = coding.first + share * (coding.last - coding.first)
    if coding.inverse:
        values = DepthValues(numbers.astype(np.float32), True, False, step, said)
        return distances(values, coding.unit_mm) if coding.unit_mm else values
    scale = coding.unit_mm or 1.0
    depth = np.where(numbers > 0, numbers * scale, np.nan).astype(np.float32)
    return DepthValues(depth, False, coding.unit_mm > 0, step * scale, said)


def distances(values: DepthValues, unit_mm: float = 0.0) -> DepthValues:
    """Distances of inverse ones, in mm or without a unit.

    Below half a step of its numbers a file cannot tell far from infinitely far: that is farthest.
    """
    least = max(values.step / 2, 1 / _LARGEST)
    scale = unit_mm or 1.0
    depth = (scale / np.maximum(values.depth.astype(np.float64), least)).astype(np.float32)
    return DepthValues(depth, False, unit_mm > 0, 0.0, values.warnings, values.step / scale)


def read_exif(picture: Any) -> tuple[int, float]:
    """Orientation, 1 to 8, and focal length in 35 mm film, 0 where not stated, of a Pillow picture.

    Whatever is wrong with its EXIF is raised as Pillow does.
    """
    exif = picture.getexif()
    orientation = exif.get(_ORIENTATION)
    focal = exif.get_ifd(_EXIF).get(_FOCAL_35MM)
    focal = float(focal) if isinstance(focal, (int, float)) and focal > 0 else 0.0
    return orientation if orientation in range(1, 9) else 1, focal


def upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Stored pixels as they are to be looked at, by EXIF's orientation, 1 to 8."""
    pixels = pixels.swapaxes(0, 1) if orientation >= 5 else pixels
    pixels = pixels[:, ::-1] if orientation in (2, 3, 6, 7) else pixels
    return pixels[::-1] if orientation in (3, 4, 7, 8) else pixels


def turned(camera: Pinhole, size: tuple[int, int], orientation: int) -> Pinhole:
    """The camera of a picture of stored size, (columns, rows), once that is upright."""
    columns, rows = size
    if orientation >= 5:
        camera = Pinhole(camera.fy, camera.fx, camera.cy, camera.cx)
        columns, rows = rows, columns
    if orientation in (2, 3, 6, 7):
        camera = replace(camera, cx=columns - 1 - camera.cx)
    if orientation in (3, 4, 7, 8):
        camera = replace(camera, cy=rows - 1 - camera.cy)
    return camera


def read_xmp(packet: bytes, path: Path) -> list[dict[str, str]]:
    """Properties by element, in the order of the document.

    Parameters
    ----------
    packet : bytes
    path : Path
        Of the photograph, for messages.

    Returns
    -------
    list of dict of str to str
        Of each element its properties ("DepthMap:Near"), be they attributes or elements in it.

    Raises
    ------
    FileError
        Broken XML, or a document type, or more than a photograph has.
    """
    nodes: list[dict[str, str]] = []
    stack: list[tuple[dict[str, str], list[str]]] = []

    def start(_: str, attributes: dict[str, str]) -> None:
        if len(stack) >= _DEEPEST or len(nodes) >= _MOST_ELEMENTS:
            raise FileError(f"{path}: its XMP metadata nest too deep or never end; {REMEDY}")
        node = {name: text for key, text in attributes.items() if (name := _name(key))}
        nodes.append(node)
        stack.append((node, []))

    def end(tag: str) -> None:
        text = "".join(stack.pop()[1]).strip()
        if not (text and stack):
            return
        if name := _name(tag):
            stack[-1][0].setdefault(name, text)
        if len(text) <= _SHORT:
            stack[-1][1].append(f" {text} ")

    def doctype(*_: object) -> None:
        raise FileError(f"{path}: its XMP metadata have a DOCTYPE; entities are refused")

    parser = expat.ParserCreate(namespace_separator=" ")
    parser.buffer_text = True
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.StartDoctypeDeclHandler = doctype
    parser.CharacterDataHandler = lambda text: stack[-1][1].append(text)
    try:
        parser.Parse(packet.strip(b"\0 \n\r\t"), True)
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise FileError(f"{path}: its XMP metadata are broken ({error}); {REMEDY}") from None
    return nodes


def _name(key: str) -> str:
    """The usual name of a property; empty where it is none of ours."""
    namespace, _, local = key.rpartition(" ")
    prefix = _NAMESPACES.get(namespace)
    return f"{prefix}:{local}" if prefix else ""


def merged(nodes: list[dict[str, str]], prefix: str) -> dict[str, str]:
    """All properties of a namespace, wherever they stand; the first of each."""
    found: dict[str, str] = {}
    for node in nodes:
        for name, text in node.items():
            if name.startswith(f"{prefix}:"):
                found.setdefault(name, text)
    return found


def read_apple_coding(nodes: list[dict[str, str]], path: Path) -> Coding | None:
    """Coding of the depth image that the metadata belong to; None where they are of another kind.

    Raises
    ------
    FileError
        A range that is none.
    """
    found = merged(nodes, "apdi") | merged(nodes, "depthData")
    kind = found.get("apdi:AuxiliaryImageType", "")
    if kind not in _KINDS:
        return None
    names = ("FloatMinValue", "FloatMaxValue")
    least, most = (number(found.get(f"apdi:{name}"), path, name) for name in names)
    if not 0 <= least <= most or most == 0:
        raise FileError(f"{path}: its {kind} goes from {least:g} to {most:g}; it is damaged")
    accuracy = found.get("depthData:Accuracy", "not stated")
    said = f"Apple {kind}, accuracy {accuracy[:20]}"
    unit_mm = 1000.0 if accuracy == "absolute" else 0.0
    return Coding(kind == "disparity", least, most, unit_mm, said)


def read_apple_camera(nodes: list[dict[str, str]]) -> tuple[Pinhole | None, tuple[float, float]]:
    """The camera by its intrinsic matrix, column by column, and the size it is stated for."""
    found = merged(nodes, "depthData")
    names = ("", "ReferenceWidth", "ReferenceHeight")
    try:
        texts = [found[f"depthData:IntrinsicMatrix{name}"].split() for name in names]
        matrix, (columns,), (rows,) = ([float(text) for text in some] for some in texts)
        fx, _, _, _, fy, _, cx, cy, _ = matrix
    except (KeyError, ValueError):
        return None, (0.0, 0.0)
    return Pinhole(fx, fy, cx - 0.5, cy - 0.5), (columns, rows)
