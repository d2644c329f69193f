"""Photographs with depth inside: one file holds the colour picture and its depth.

| module  | what it does                                                                      |
| ------- | --------------------------------------------------------------------------------- |
| `heif`  | HEIC and HEIF: auxiliary depth images, with Apple's metadata or the codec's own   |
| `jpeg`  | JPEG: dynamic depth (Android), GDepth, and Apple's disparity as a further picture |
| `codes` | from whole numbers to distances or disparities; XMP; Apple's metadata             |
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inim.errors import FileError
from inim.files.picture import open_picture
from inim.files.regular_file import read_file
from inim.from_camera.depth_photo.codes import EmbeddedDepth, read_exif, decoded, turned, upright
from inim.from_camera.depth_photo.heif import is_heif, read_heif
from inim.from_camera.depth_photo.jpeg import MAGIC, read_jpeg_depth
from inim.from_camera.depth_values import DepthValues
from inim.from_camera.fit import Pinhole
from inim.from_camera.picture_files import convert_to_srgb

#: Of the photographs in a folder.
SUFFIXES = (".heic", ".heif", ".hif", ".jpeg", ".jpg")
# Photographs of 200 megapixels have half of that.
_MOST_BYTES = 2**27
# ITU-T H.273: those of BT.709, which are sRGB's; unspecified; none stated.
_OF_SRGB = (1, 2, None)
_DIAGONAL_35MM = math.hypot(36, 24)
_SAME_SHAPE = 0.02


@dataclass(frozen=True)
class DepthPhoto:
    """A photograph with depth inside.

    Attributes
    ----------
    color : (H, W, 3) uint8
        sRGB, upright.
    values : DepthValues
        Upright, of the depth image's own rows and columns.
    camera : Pinhole or None
        Of the upright colour picture, where the file says.
    said : tuple of str
        The kind of depth and whether it has a scale; the camera.
    """

    color: NDArray[np.uint8]
    values: DepthValues
    camera: Pinhole | None
    said: tuple[str, ...]


def read_depth_photo(path: Path) -> DepthPhoto:
    """Read a photograph with depth inside.

    Parameters
    ----------
    path : Path
        HEIC or HEIF, or JPEG with dynamic depth, GDepth or Apple's disparity.

    Raises
    ------
    FileError
        Missing, damaged, of another kind, or without depth.
    UsageError
        HEIC, and pillow-heif is not installed.
    """
    data = read_file(path, _MOST_BYTES)
    if is_heif(data):
        return _made(path, *read_heif(path, data), is_upright=True)
    if not data.startswith(MAGIC):
        raise FileError(
            f"{path}: neither HEIC nor JPEG; give other pictures as --color and --depth"
        )
    inside = read_jpeg_depth(path, data)
    with open_picture(path, ("JPEG",), 1, data=data) as picture:
        return _made(path, picture, read_exif(picture), inside, is_upright=False)


def _made(
    path: Path, picture: Any, exif: tuple[int, float], inside: EmbeddedDepth | None, *, is_upright: bool
) -> DepthPhoto:
    if inside is None:
        raise FileError(
            f"{path}: has no depth inside that inim knows (HEIC, dynamic depth, GDepth, Apple's "
            "disparity); take the original file of a portrait photograph, or `inim depth`"
        )
    orientation, focal_35mm = exif
    color = np.asarray(convert_to_srgb(picture, path).convert("RGB"))
    values = decoded(inside)
    primaries = (picture.info.get("nclx_profile") or {}).get("color_primaries")
    if primaries not in _OF_SRGB:
        said = (
            f"{path}: its colours have other primaries than sRGB (nclx {primaries}), and were "
            "taken as sRGB"
        )
        values = replace(values, warnings=(*values.warnings, said))
    if not is_upright:
        color = np.ascontiguousarray(upright(color, orientation))
        values = replace(values, depth=np.ascontiguousarray(upright(values.depth, orientation)))
    rows, columns = color.shape[:2]
    stored = (rows, columns) if orientation >= 5 else (columns, rows)
    camera, words = _camera(inside, stored, focal_35mm)
    camera = None if camera is None else turned(camera, stored, orientation)
    return DepthPhoto(color, values, camera, (_scale_words(values, inside), words))


def _scale_words(values: DepthValues, inside: EmbeddedDepth) -> str:
    if values.has_unit:
        return f"{inside.coding.said}: metric"
    larger = "numbers grow towards the camera" if values.near_is_large else "numbers grow away"
    return f"{inside.coding.said}: relative, no millimetres ({larger})"


def _camera(
    inside: EmbeddedDepth, stored: tuple[int, int], focal_35mm: float
) -> tuple[Pinhole | None, str]:
    """The camera of the stored colour picture, and how it is known."""
    camera, (columns, rows) = inside.camera, inside.camera_size
    stated = () if camera is None else (*vars(camera).values(), columns, rows)
    usable = all(map(math.isfinite, stated))
    if camera is not None and usable and min(columns, rows) > 0:
        x, y = stored[0] / columns, stored[1] / rows
        scaled = Pinhole(
            camera.fx * x,
            camera.fy * y,
            (camera.cx + 0.5) * x - 0.5,
            (camera.cy + 0.5) * y - 0.5,
        )
        if abs(x / y - 1) <= _SAME_SHAPE and min(scaled.fx, scaled.fy) > 0:
            return scaled, "camera by the file's own calibration"
    if 0 < focal_35mm < math.inf:
        focal = focal_35mm * math.hypot(*stored) / _DIAGONAL_35MM
        middle = ((stored[0] - 1) / 2, (stored[1] - 1) / 2)
        return Pinhole(focal, focal, *middle), f"camera by EXIF, {focal_35mm:g} mm in 35 mm film"
    return None, "camera unknown"
