"""RGB-D pictures from several cameras, each with its position and direction."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inim.errors import UsageError

#: Most cameras of a scene or of a list of pictures.
MOST_CAMERAS = 9
#: Steepest surface, in depth over width, that connects neighbouring pixels: 10 is 84 degrees.
MAX_SLOPE = 10.0

_GRID = re.compile(r"([1-9])x([1-9])")
# Rows and columns of arrangements that are given by the number of cameras.
_GRIDS = {"1": (1, 1), "2": (1, 2), "3": (1, 3), "4": (2, 2), "6": (2, 3), "8": (2, 4), "9": (3, 3)}


def camera_directions(arrangement: str) -> tuple[tuple[float, float], ...]:
    """Directions of the cameras of an arrangement, to the right and upwards.

    1 is the direction of the corner of the viewing zone: of the corner pixels of an elemental
    image. An arrangement is a grid of rows and columns, ``3x3``, or a number of cameras: ``5`` is
    the centre and the four corners, and other numbers are grids, the longer side across.

    Raises `UsageError`: another text, or more than `MOST_CAMERAS`.
    """
    grid = _GRID.fullmatch(arrangement)
    rows, columns = (int(grid[1]), int(grid[2])) if grid else _GRIDS.get(arrangement, (0, 0))
    if arrangement != "5" and not 1 <= rows * columns <= MOST_CAMERAS:
        raise UsageError(
            f"cameras {arrangement!r}: write a number, {', '.join(sorted({*_GRIDS, '5'}))}, or "
            f"rows and columns of at most {MOST_CAMERAS} cameras, such as 3x3"
        )
    if arrangement == "5":
        corners = tuple((x, y) for y in (1.0, -1.0) for x in (-1.0, 1.0))
        return ((0.0, 0.0), *corners)
    right, up = (
        [0.0] if n == 1 else [2 * k / (n - 1) - 1 for k in range(n)] for n in (columns, rows)
    )
    return tuple((x, y) for y in reversed(up) for x in right)


@dataclass(frozen=True)
class Camera:
    """Map from pixels and depths of a picture to points of the display frame."""

    #: (3, 4) float64: times ``(j w, i w, d, 1)`` it gives the point of column j and row i at depth
    #: d, in mm. The centre of the first pixel is at (0, 0).
    display_from_picture: NDArray[np.float64]
    is_pinhole: bool  #: True if w = d, the distance along the camera's axis; False if w = 1.
    #: (least, share) of float: neighbouring pixels are one surface if their depths differ by at
    #: most ``least + share min(d)``.
    same_surface: tuple[float, float]

    @classmethod
    def orthographic(
        cls, slopes: tuple[float, float], shape: tuple[int, int], pixel_mm: float
    ) -> Camera:
        """Parallel rays, whose depth is z of the display frame.

        * `slopes`, (right, up): millimetres per millimetre towards the viewer.
        * `shape`, (rows, columns): of the picture, which is centred on the array's plane, z = 0.
        * `pixel_mm`: side of a pixel on that plane.
        """
        (rows, columns), (right, up) = shape, slopes
        matrix = [
            [pixel_mm, 0, right, -(columns - 1) / 2 * pixel_mm],
            [0, -pixel_mm, up, (rows - 1) / 2 * pixel_mm],
            [0, 0, 1, 0],
        ]
        return cls(np.array(matrix, np.float64), False, (MAX_SLOPE * pixel_mm, 0.0))

    @classmethod
    def pinhole(
        cls, intrinsics: tuple[float, float, float, float], display_from_camera: np.ndarray
    ) -> Camera:
        """A perspective camera.

        * `intrinsics`, (fx, fy, cx, cy): in pixels; see `inim.from_camera.fit.Pinhole`.
        * `display_from_camera`, (3, 4): affine map from the camera's frame: x to the right, y down,
          z away from the camera.
        """
        fx, fy, cx, cy = intrinsics
        camera_from_picture = [
            [1 / fx, 0, -cx / fx, 0], [0, 1 / fy, -cy / fy, 0], [0, 0, 1, 0], [0, 0, 0, 1]
        ]  # fmt: skip
        matrix = np.asarray(display_from_camera, np.float64) @ np.array(camera_from_picture)
        return cls(matrix, True, (0.0, MAX_SLOPE / min(fx, fy)))


@dataclass(frozen=True)
class CameraRGBD:
    """RGB-D picture of a camera with a position and direction of its own."""

    color: NDArray[np.float32]  #: (H, W, 3) float32: linear RGB.
    #: (H, W) float32: depth as the camera defines it; inf where the camera sees that there is
    #: nothing, and NaN where the depth is unknown.
    depth: NDArray[np.float32]
    camera: Camera
    name: str = "camera"  #: For messages: its file.

    def __post_init__(self) -> None:
        color, depth = np.asarray(self.color, np.float32), np.asarray(self.depth, np.float32)
        if color.shape != (*depth.shape, 3) or depth.ndim != 2 or not depth.size:
            raise UsageError(
                f"{self.name}: color is {color.shape}, depth {depth.shape}; they must be "
                "(H, W, 3) and (H, W)"
            )
        matrix = self.camera.display_from_picture
        if not np.isfinite(matrix).all() or np.linalg.matrix_rank(matrix[:, :3]) < 3:
            raise UsageError(f"{self.name}: its camera has no inverse; correct its pose")
        object.__setattr__(self, "color", color)
        object.__setattr__(self, "depth", depth)


@dataclass(frozen=True)
class CameraRGBDs:
    """RGB-D pictures of one scene from several cameras.

    Raises `UsageError`: none, or more than `MOST_CAMERAS`.
    """

    pictures: tuple[CameraRGBD, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "pictures", tuple(self.pictures))
        if not 1 <= len(self.pictures) <= MOST_CAMERAS:
            raise UsageError(
                f"{len(self.pictures)} cameras; give 1 to {MOST_CAMERAS} pictures with a camera "
                "each"
            )
