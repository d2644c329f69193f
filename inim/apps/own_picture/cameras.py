"""A user's RGB-D pictures from several cameras (`CamerasDocument`), fitted to a display."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from inim.apps.own_picture.document import CamerasDocument, PlacedPicture
from inim.apps.own_picture.fit import (
    DepthMap,
    check_pinhole,
    depth_range,
    map_depth,
    parse_intrinsics,
    unprojection,
)
from inim.apps.own_picture.picture import CameraPicture, ColorDepth
from inim.apps.own_picture.tiles import linear_light
from inim.display import Display
from inim.image.rgbd import MAX_SLOPE, MOST_CAMERAS, Camera, CameraRGBD, CameraRGBDs
from inim.system.document import read_document
from inim.system.errors import FileError, UsageError

# A rotation written with four digits is orthonormal to this precision.
_ORTHONORMAL = 1e-3


class PlacedCameras(NamedTuple):
    """Pictures in the display frame; `frame_at` is the distance at which the first one fits."""

    pictures: CameraRGBDs
    depth_map: DepthMap
    frame_at: float
    warnings: tuple[str, ...]


def read_cameras(path: Path, options: CameraPicture, display: Display) -> PlacedCameras:
    """Read the pictures of a document; depth range and framing are those of the first camera.

    `options` are those of a single picture, without files, projection and depth map. Raises an
    `InimError` if a file is damaged or contradicts the options.
    """
    _check_options(options)
    document = read_document(path, "see docs/how-to/several-cameras.md", CamerasDocument)
    if not 2 <= len(document.pictures) <= MOST_CAMERAS:
        raise FileError(
            f"{path}: {len(document.pictures)} pictures; give 2 to {MOST_CAMERAS}, or for one use "
            "`inim generate COLOR --depth DEPTH`"
        )
    poses = [_pose(path, placed) for placed in document.pictures]
    pictures = [_read(path, document, placed, options) for placed in document.pictures]
    first = pictures[0]
    assert first.camera is not None
    depth_map = map_depth(
        "linear", first.values, depth_range(first.values, options.near, options.far), display
    )
    scale, offset, frame_at = unprojection(
        first.values, first.camera, display, options.fit or "cover", options.frame_at
    )
    display_from_first = np.eye(4)
    display_from_first[:3] = [
        [scale, 0, 0, offset[0]],
        [0, -scale, 0, offset[1]],
        [0, 0, depth_map.slope, depth_map.offset_mm],
    ]
    display_from_world = display_from_first @ np.linalg.inv(poses[0])
    placed_pictures = tuple(
        _place(placed.depth, picture, display_from_world @ pose, depth_map, options)
        for placed, picture, pose in zip(document.pictures, pictures, poses, strict=True)
    )
    warnings = tuple(dict.fromkeys(text for picture in pictures for text in picture.warnings))
    return PlacedCameras(CameraRGBDs(placed_pictures), depth_map, frame_at, warnings)


def _check_options(options: CameraPicture) -> None:
    if options.depth_unit == "none":
        raise UsageError(
            "--depth-unit none: several cameras need distances in a known unit; give --depth-unit "
            "mm, cm, m, or a number of units per metre"
        )
    if options.fit == "auto":
        raise UsageError("--fit auto: several cameras need contain or cover")


def _pose(path: Path, placed: PlacedPicture) -> np.ndarray:
    """Map from a camera's frame to that of the document, (4, 4)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = placed.rotation, placed.position_mm
    rotation = pose[:3, :3]
    error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if error > _ORTHONORMAL or np.linalg.det(rotation) < 0:
        raise FileError(
            f"{path}: rotation of {placed.color} is no rotation matrix; its columns are the "
            "camera's right, down and forward directions, of length 1"
        )
    return pose


def _read(
    path: Path, document: CamerasDocument, placed: PlacedPicture, options: CameraPicture
) -> ColorDepth:
    """Picture of a camera, with depth in millimetres."""
    intrinsics = placed.intrinsics or document.intrinsics
    if intrinsics is None:
        raise FileError(f"{path}: {placed.color} has no intrinsics; add fx, fy, cx, cy in pixels")
    files = _file(path, placed.color), _file(path, placed.depth)
    source = f"{path}: intrinsics of {placed.color}"
    camera = parse_intrinsics(",".join(map(repr, intrinsics)), source)
    picture = replace(options, color=files[0], depth=files[1], pinhole=camera).read()
    assert picture.camera is not None
    check_pinhole(picture.camera, (picture.color.shape[0], picture.color.shape[1]))
    return picture


def _file(document: Path, name: str) -> Path:
    """File that a document names; raises `FileError` unless it is in the document's folder."""
    file = document.parent / name
    try:
        is_inside = file.resolve().is_relative_to(document.parent.resolve())
    except (OSError, ValueError, RuntimeError):
        raise FileError(f"{document}: {name!r} is no file name; correct it") from None
    if not is_inside:
        raise FileError(
            f"{document}: {name!r} is outside the document's folder; copy it there, or move the "
            "document to a folder that contains all pictures"
        )
    return file


def _place(
    name: str,
    picture: ColorDepth,
    display_from_camera: np.ndarray,
    depth_map: DepthMap,
    options: CameraPicture,
) -> CameraRGBD:
    """Picture in the display frame, its depth limited to the display's range."""
    pinhole, depth = picture.camera, picture.values.depth.astype(np.float64)
    assert pinhole is not None
    intrinsics = pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy
    camera = Camera.pinhole(intrinsics, display_from_camera[:3])
    share = MAX_SLOPE * picture.coarseness / min(pinhole.fx, pinhole.fy)
    share = max(share, 1.5 * picture.values.inverse_step * depth_map.far)
    camera = replace(camera, same_surface=(1.5 * picture.values.step, share))
    rows, columns = np.indices(depth.shape)
    right, down, away, start = camera.display_from_picture[2]
    along = right * columns + down * rows + away
    z_mm = start + along * depth
    limited = np.clip(z_mm, depth_map.low_mm, depth_map.high_mm)
    tolerance = 1e-6 * (depth_map.high_mm - depth_map.low_mm)
    outside = np.abs(z_mm - limited) > tolerance
    if options.out_of_range == "drop":
        depth[outside] = np.where(z_mm < depth_map.low_mm, np.inf, np.nan)[outside]
    else:
        depth[outside] = ((limited - start) / along)[outside]
    return CameraRGBD(linear_light(picture.color), depth.astype(np.float32), camera, name)
