"""Decoding of the depth inside a photograph: integer codes and their metadata.

All formats quantise one of two quantities in equal steps: the distance, or its inverse (disparity).
With ``v`` the code divided by the largest code, the quantity is ``q = first + v (last - first)``.

Apple's ``apdi:FloatMinValue`` and ``FloatMaxValue`` are the quantity at the smallest and the
largest code: 1/m for a disparity, m for a depth. The metres are reliable only if
``depthData:Accuracy`` is "absolute". XMP (ISO 16684-1) is untrusted XML: document types,
and so entities, are refused.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from inim.apps.own_picture.depth_values import DepthValues
from inim.apps.own_picture.fit import Pinhole
from inim.system.errors import FileError

REMEDY = "use the photograph's original file"
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
_MAX_TAGS = 40_000
# Largest distance in any unit, limited by float precision.
_LARGEST = 1e9
_RAY_WARNING = "a photograph's depth along the ray was interpreted as depth along the optical axis"


@dataclass(frozen=True)
class Coding:
    """Mapping from the codes of a depth image to distances.

    `first` and `last` are the quantity at code 0 and at the largest code: the distance, or with
    `inverse` its inverse. `unit_mm` is 0 if the file has no reliable unit. `description` is the
    format and scale.
    """

    inverse: bool
    first: float
    last: float
    unit_mm: float
    description: str


@dataclass(frozen=True)
class EmbeddedDepth:
    """A depth image as stored in a photograph."""

    codes: np.ndarray  #: (h, w) uint8 or uint16
    coding: Coding
    #: Camera of the stored colour picture, before its rotation upright.
    camera: Pinhole | None = None
    camera_size: tuple[float, float] = (0.0, 0.0)  #: Picture size to which `camera` refers.
    along_ray: bool = False  #: Distances are measured along the ray, not along the optical axis.


def parse_number(text: str | None, path: Path, name: str) -> float:
    """Parse a number of a photograph's metadata; raises `FileError` if it is missing or invalid."""
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not abs(value) <= _LARGEST:
        problem = "is missing" if text is None else f"is {text[:40]!r}, an invalid number"
        raise FileError(f"{path}: {name} of its depth {problem}; {REMEDY}")
    return value


def decode_depth(depth: EmbeddedDepth) -> DepthValues:
    """Distances in mm if the file has a reliable unit; otherwise unitless values.

    A disparity without a unit is returned as it is, with near large: an orthographic picture with
    disparity as depth preserves planes.
    """
    coding, largest = depth.coding, np.iinfo(depth.codes.dtype).max
    warnings = (_RAY_WARNING,) if depth.along_ray else ()
    step = abs(coding.last - coding.first) / largest
    share = depth.codes.astype(np.float64) / largest
    numbers = coding.first + share * (coding.last - coding.first)
    if coding.inverse:
        values = DepthValues(numbers.astype(np.float32), True, False, step, warnings)
        return invert_disparity(values, coding.unit_mm) if coding.unit_mm else values
    scale = coding.unit_mm or 1.0
    distances = np.where(numbers > 0, numbers * scale, np.nan).astype(np.float32)
    return DepthValues(distances, False, coding.unit_mm > 0, step * scale, warnings)


def invert_disparity(values: DepthValues, unit_mm: float = 0.0) -> DepthValues:
    """Convert disparities to distances, in mm or without a unit.

    Disparities below half a quantisation step are clipped: they include infinity.
    """
    least = max(values.step / 2, 1 / _LARGEST)
    scale = unit_mm or 1.0
    depth = (scale / np.maximum(values.depth.astype(np.float64), least)).astype(np.float32)
    return DepthValues(depth, False, unit_mm > 0, 0.0, values.warnings, values.step / scale)


def rotate_upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Rotate stored pixels upright, by the EXIF orientation, 1 to 8."""
    pixels = pixels.swapaxes(0, 1) if orientation >= 5 else pixels
    pixels = pixels[:, ::-1] if orientation in (2, 3, 6, 7) else pixels
    return pixels[::-1] if orientation in (3, 4, 7, 8) else pixels


def rotate_camera(camera: Pinhole, size: tuple[int, int], orientation: int) -> Pinhole:
    """Camera of a stored picture of size (columns, rows) after its rotation upright."""
    columns, rows = size
    if orientation >= 5:
        camera = Pinhole(camera.fy, camera.fx, camera.cy, camera.cx)
        columns, rows = rows, columns
    if orientation in (2, 3, 6, 7):
        camera = replace(camera, cx=columns - 1 - camera.cx)
    if orientation in (3, 4, 7, 8):
        camera = replace(camera, cy=rows - 1 - camera.cy)
    return camera


class _XmpBuilder(ElementTree.TreeBuilder):
    """Builder of XMP elements without a document type."""

    def doctype(self, *_: object) -> None:
        """Refuse a document type, and so entities."""
        raise ValueError("they contain a DOCTYPE, which is refused")


def read_xmp(packet: bytes, path: Path) -> list[dict[str, str]]:
    """Properties ("DepthMap:Near") of each element, in document order.

    Raises `FileError` for invalid XML, a document type, or too many elements.
    """
    if packet.count(b"<") > _MAX_TAGS:
        raise FileError(f"{path}: its XMP metadata exceed {_MAX_TAGS} tags; {REMEDY}")
    try:
        parser = ElementTree.XMLParser(target=_XmpBuilder())
        root = ElementTree.fromstring(packet.strip(b"\0 \n\r\t"), parser)
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise FileError(f"{path}: its XMP metadata are damaged ({error}); {REMEDY}") from None
    return [_properties(element) for element in root.iter()]


def _properties(element: ElementTree.Element) -> dict[str, str]:
    """Attributes, and texts of children; the numbers of a list are joined."""
    properties = {name: text for key, text in element.items() if (name := _name(key))}
    for child in element:
        texts = [(part.text or "").strip() for part in (child, *child.iterfind("*/*"))]
        if (name := _name(child.tag)) and any(texts):
            properties.setdefault(name, " ".join(texts).strip())
    return properties


def _name(key: str) -> str:
    """Property name with its usual prefix; empty for other namespaces."""
    namespace, _, local = key[1:].rpartition("}")
    prefix = _NAMESPACES.get(namespace)
    return f"{prefix}:{local}" if prefix else ""


def collect_properties(nodes: list[dict[str, str]], prefix: str) -> dict[str, str]:
    """All properties of a namespace; the first value of each."""
    return {
        name: text
        for node in reversed(nodes)
        for name, text in node.items()
        if name.startswith(f"{prefix}:")
    }


def read_apple_coding(nodes: list[dict[str, str]], path: Path) -> Coding | None:
    """Coding from Apple's metadata; None if they do not describe a depth image."""
    properties = collect_properties(nodes, "apdi") | collect_properties(nodes, "depthData")
    kind = properties.get("apdi:AuxiliaryImageType", "")
    if kind not in _KINDS:
        return None
    names = ("FloatMinValue", "FloatMaxValue")
    least, most = (parse_number(properties.get(f"apdi:{name}"), path, name) for name in names)
    if not 0 <= least <= most or most == 0:
        raise FileError(
            f"{path}: its {kind} has an invalid range from {least:g} to {most:g}; {REMEDY}"
        )
    accuracy = properties.get("depthData:Accuracy", "not given")
    description = f"Apple {kind}, accuracy {accuracy[:20]}"
    unit_mm = 1000.0 if accuracy == "absolute" else 0.0
    return Coding(kind == "disparity", least, most, unit_mm, description)


def read_apple_camera(nodes: list[dict[str, str]]) -> tuple[Pinhole | None, tuple[float, float]]:
    """Camera from Apple's intrinsic matrix (column by column), and its picture size."""
    properties = collect_properties(nodes, "depthData")
    names = ("", "ReferenceWidth", "ReferenceHeight")
    try:
        lists = [properties[f"depthData:IntrinsicMatrix{name}"].split() for name in names]
        matrix, (columns,), (rows,) = ([float(text) for text in texts] for texts in lists)
        fx, _, _, _, fy, _, cx, cy, _ = matrix
    except (KeyError, ValueError):
        return None, (0.0, 0.0)
    return Pinhole(fx, fy, cx - 0.5, cy - 0.5), (columns, rows)
