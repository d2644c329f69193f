"""View synthesis that is not the project's: two naive methods, and MPEG's synthesizer.

The Reference View Synthesizer (https://gitlab.com/mpeg-i-visual/rvs, BSD) is that of MPEG's
immersive video. It spans triangles between neighbouring picture pixels, moves their corners, and
draws them with the nearest on top. Empty pixels show the nearest pixel. Its cameras see the light
field's disparity: their axes are parallel, their principal points are shifted, and the farthest
depth is twice the nearest.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.ndimage import distance_transform_edt

from reports.scoreboard.field import LightField, Place, Views

#: Settings of RVS, in addition to cameras and files.
RVS_SETTINGS = {
    "Precision": 1.0,
    "ColorSpace": "RGB",
    "ViewSynthesisMethod": "Triangles",
    "BlendingMethod": "Simple",
    "BlendingFactor": 1.0,
}
_DEPTH_BITS = 16
# Margin between the range of disparities and that of depths.
_BEYOND_PX = 1 / 16


def copy(field: LightField) -> Views:
    """Show the middle view in every place."""
    middle = field.middle
    return ((place, middle) for place in field.views)


def splat(field: LightField) -> Views:
    """Move each pixel to its place, the nearest on top; fill empty pixels from the nearest."""
    order = np.argsort(field.disparity, axis=None, kind="stable")
    rows, columns = np.divmod(order, field.rgbd.shape[1])
    moved = field.disparity.ravel()[order]
    color = field.middle.reshape(-1, 3)[order]
    for place in field.views:
        down, across = field.offset(place)
        y = np.rint(rows - moved * down).astype(int)
        x = np.rint(columns - moved * across).astype(int)
        inside = (y >= 0) & (y < field.rgbd.shape[0]) & (x >= 0) & (x < field.rgbd.shape[1])
        view = np.zeros((*field.rgbd.shape, 3), np.uint8)
        empty = np.ones(field.rgbd.shape, bool)
        view[y[inside], x[inside]] = color[inside]  # the last, nearest one stays
        empty[y[inside], x[inside]] = False
        yield place, view[nearest(empty)]


def nearest(empty: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the nearest pixel that is not empty."""
    rows, columns = distance_transform_edt(empty, return_distances=False, return_indices=True)
    return rows, columns


def rvs(field: LightField, program: Path) -> Views:
    """Views that RVS generates from the middle view; `program` is the executable of RVS 4."""
    from PIL import Image

    # RVS draws nothing at the farthest depth.
    low = float(field.disparity.min()) - _BEYOND_PX
    span = float(field.disparity.max()) + _BEYOND_PX - low
    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        Image.fromarray(field.middle).save(folder / "color.png")
        # 1 / z, from far to near: z = span / (disparity - low + span).
        share = (field.disparity - low) / span
        levels = np.rint(share * (2**_DEPTH_BITS - 1)).astype(np.uint16)
        Image.fromarray(levels).save(folder / "depth.png")
        places = [(field.side // 2, field.side // 2), *field.views]
        cameras = [_camera(field, place, span, span - low) for place in places]
        (folder / "cameras.json").write_text(
            json.dumps({"Version": "4.0", "cameras": cameras}), "utf-8"
        )
        names = [c["Name"] for c in cameras]
        config = {
            "Version": "3.0",
            "InputCameraParameterFile": str(folder / "cameras.json"),
            "VirtualCameraParameterFile": str(folder / "cameras.json"),
            "InputCameraNames": names[:1],
            "VirtualCameraNames": names[1:],
            "ViewImageNames": [str(folder / "color.png")],
            "DepthMapNames": [str(folder / "depth.png")],
            "OutputFiles": [str(folder / f"{name}.png") for name in names[1:]],
            "StartFrame": 0,
            "NumberOfFrames": 1,
            **RVS_SETTINGS,
        }
        (folder / "config.json").write_text(json.dumps(config), "utf-8")
        command = [str(program.resolve()), str(folder / "config.json"), "--noopengl"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        for place, name in zip(field.views, names[1:], strict=True):
            with Image.open(folder / f"{name}.png") as view:
                yield place, np.asarray(view.convert("RGB"))


def _camera(field: LightField, place: Place, focal: float, converged: float) -> dict[str, object]:
    """Camera that sees disparity d at z = focal / (d + converged); x to the front, y left."""
    rows, columns = field.rgbd.shape
    down, across = field.offset(place)
    return {
        "Name": f"view_{place[0]}_{place[1]}",
        "Position": [0.0, float(-across), float(-down)],
        "Rotation": [0.0, 0.0, 0.0],
        "Depthmap": 1,
        "Background": 0,
        "Depth_range": [0.5, 1.0],
        "Resolution": [columns, rows],
        "Projection": "Perspective",
        "Focal": [focal, focal],
        "Principle_point": [columns / 2 + converged * across, rows / 2 + converged * down],
        "BitDepthColor": 8,
        "BitDepthDepth": _DEPTH_BITS,
        "ColorSpace": "YUV420",
        "DepthColorSpace": "YUV420",
    }
