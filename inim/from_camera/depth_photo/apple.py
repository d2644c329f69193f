"""What Apple's metadata say of a depth image, in HEIC and in JPEG alike.

``apdi:FloatMinValue`` and ``FloatMaxValue`` are what the least and the largest number stand for:
1/m where the image is a disparity, m where it is a depth. Only ``depthData:Accuracy`` "absolute"
vouches for the metres.
"""

from __future__ import annotations

from pathlib import Path

from inim.errors import FileError
from inim.from_camera.depth_photo.codes import Coding, number
from inim.from_camera.depth_photo.xmp import merged
from inim.from_camera.fit import Pinhole

_KINDS = ("disparity", "depth")


def apple_coding(nodes: list[dict[str, str]], path: Path) -> Coding | None:
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


def apple_camera(nodes: list[dict[str, str]]) -> tuple[Pinhole | None, tuple[float, float]]:
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
