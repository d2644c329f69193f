"""Colour and depth pictures: of one layer, of several, and of several cameras."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cached_property
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inim.system.errors import UsageError

# Largest side of a picture in a notebook.
_THUMBNAIL_PX = 256
# Far beyond any display; numbers of picture pixels on a ray to a greater depth are no integers.
_FARTHEST_MM = 1e12


@dataclass(frozen=True)
class Layer:
    """A surface of a picture, with the solid that it begins."""

    color: np.ndarray  #: (H, W, channels): as in the picture.
    #: (H, W) float32: where the solid begins and ends, ``back_mm <= front_mm``.
    front_mm: NDArray[np.float32]
    back_mm: NDArray[np.float32]
    covered: NDArray[np.bool_]  #: (H, W) bool: where there is such a layer.


@dataclass(frozen=True, repr=False)
class RGBD:
    """RGB-D picture of a depth camera in front of the display.

    An orthographic colour and depth picture in the display frame, centred on its axis.

    Row 0 is the top. Pixel (r, c) covers x in ``[(c - W/2) p, (c + 1 - W/2) p]`` and y in
    ``[(H/2 - r - 1) p, (H/2 - r) p]``, p being `pixel_mm`.

    Parameters
    ----------
    color : (H, W, 3) float32, or (H, W, 4) uint8
        Linear RGB, for verification; or sRGB with alpha, as a player sends it to the panel.
    depth_mm : (H, W) float32
        z of the front surface in the display frame, towards the viewer; ignored where not covered.
    covered : (H, W) bool
        Whether there is a surface. Background is this flag, never a depth value.
    pixel_mm : float
        Side of a pixel.

    Raises
    ------
    UsageError
        Shapes that differ, an empty picture, or a covered pixel whose depth is not finite.
    """

    color: NDArray[np.float32] | NDArray[np.uint8]
    depth_mm: NDArray[np.float32]
    covered: NDArray[np.bool_]
    pixel_mm: float

    def __post_init__(self) -> None:
        # Copies: a caller's later changes must not slip past these checks.
        as_shown = np.asarray(self.color).dtype == np.uint8
        color = np.array(self.color, np.uint8 if as_shown else np.float32)
        channels = 4 if as_shown else 3
        depth = np.array(self.depth_mm, np.float32)
        covered = np.array(self.covered, bool)
        if color.ndim != 3 or color.shape[2] != channels or color.size == 0:
            raise UsageError(
                f"RGBD: color is {color.dtype} of shape {color.shape}; it must be (H, W, 3) float "
                "or (H, W, 4) uint8"
            )
        if depth.shape != color.shape[:2] or covered.shape != color.shape[:2]:
            raise UsageError(
                f"RGBD: color is {color.shape[:2]}, depth_mm {depth.shape}, covered "
                f"{covered.shape}; all three must have the same rows and columns"
            )
        pixel: Any = self.pixel_mm
        if not (isinstance(pixel, Real) and 0 < float(pixel) < math.inf):
            raise UsageError(f"RGBD: pixel_mm = {self.pixel_mm!r}; it must be a positive length")
        depths = depth[covered]
        farthest = float(max(depths.max(initial=0), -depths.min(initial=0)))
        if not math.isfinite(farthest):
            bad = int(np.count_nonzero(~np.isfinite(depths)))
            raise UsageError(
                f"RGBD: {bad} covered pixels have no finite depth; clear `covered` there"
            )
        if farthest > _FARTHEST_MM:
            raise UsageError(
                f"RGBD: covered depths reach {farthest:.3g} mm, and at most {_FARTHEST_MM:g} are "
                "allowed; clear `covered` where there is no surface"
            )
        for name, value in (("color", color), ("depth_mm", depth), ("covered", covered)):
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        object.__setattr__(self, "pixel_mm", float(self.pixel_mm))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.depth_mm.shape[0], self.depth_mm.shape[1]

    def __repr__(self) -> str:
        rows, columns = self.shape
        size = f"{columns} x {rows} pixels of {self.pixel_mm:.4g} mm"
        layers = f", {len(self.layers)} layers" if len(self.layers) > 1 else ""
        low, high = self._depth_limits_mm()
        depths = f"{self.covered.mean():.1%} covered, {low:.4g} to {high:.4g} mm"
        return f"{type(self).__name__}({size}{layers}, {depths if low <= high else 'empty'})"

    def _depth_limits_mm(self) -> tuple[float, float]:
        """Smallest and largest depth of the covered pixels; NaN if there is none."""
        depths = self.depth_mm[self.covered]
        return (float(depths.min()), float(depths.max())) if depths.size else (math.nan, math.nan)

    def _repr_html_(self) -> str:
        """Thumbnails of colour and depth (near is white, no surface is blue), for notebooks."""
        from inim.image.color import png_data_uri, to_srgb

        step = max(1, math.ceil(max(self.shape) / _THUMBNAIL_PX))
        color, depth = self.color[::step, ::step], self.depth_mm[::step, ::step]
        covered, (low, high) = self.covered[::step, ::step], self._depth_limits_mm()
        gray = np.where(covered, (depth - low) / max(high - low, 1e-9), 0)[..., None]
        codes = np.repeat(np.rint(255 * gray).astype(np.uint8), 3, axis=-1)
        codes[~covered] = (30, 60, 120)
        colors = color[..., :3] if color.dtype == np.uint8 else to_srgb(color)
        images = "".join(f'<img src="{png_data_uri(pixels)}"> ' for pixels in (colors, codes))
        return f"{images}<br>{self!r}"

    @property
    def layers(self) -> tuple[Layer, ...]:
        """All layers, the front surface first; one without a back is solid all the way down."""
        back = np.full(self.shape, -np.inf, np.float32)
        return (Layer(self.color, self.depth_mm, back, self.covered),)

    @property
    def palette(self) -> np.ndarray:
        """The colours that source numbers point into, row by row."""
        return self.color

    @property
    def width_mm(self) -> float:
        """Width of the picture."""
        return self.shape[1] * self.pixel_mm

    @property
    def height_mm(self) -> float:
        """Height of the picture."""
        return self.shape[0] * self.pixel_mm


@dataclass(frozen=True, repr=False)
class LayeredRGBD(RGBD):
    """Layered depth image: columns are solid from each front to its back.

    After Shade et al., Layered depth images, SIGGRAPH 1998; a layer here also has a back.
    Generators without layers use it as the RGB-D picture of its front surface.

    Parameters
    ----------
    color, depth_mm, covered, pixel_mm :
        The front surface, as in `RGBD`.
    back_mm : (H, W) float32
        Back of the solid behind the front surface; -inf for none.
    deeper : tuple of Layer
        Further layers, nearest first. A pixel covered in one layer is covered in all previous
        layers.

    Raises
    ------
    UsageError
        As for `RGBD`; a back in front of its front, or a layer without a previous layer or in front
        of it.
    """

    back_mm: NDArray[np.float32]
    deeper: tuple[Layer, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "back_mm", np.array(self.back_mm, np.float32))
        object.__setattr__(self, "deeper", tuple(self.deeper))
        above, before = self.covered, self.layers[0]
        for number, layer in enumerate(self.layers):
            if layer.color.shape != self.color.shape or layer.color.dtype != self.color.dtype:
                raise UsageError(
                    f"LayeredRGBD: layer {number} has {layer.color.dtype} colours of shape "
                    f"{layer.color.shape}; the picture's are {self.color.dtype} "
                    f"{self.color.shape}"
                )
            for name in ("front_mm", "back_mm", "covered"):
                if getattr(layer, name).shape != self.shape:
                    raise UsageError(
                        f"LayeredRGBD: layer {number}: {name} of shape "
                        f"{getattr(layer, name).shape}; the picture has {self.shape}"
                    )
            front, back = layer.front_mm[layer.covered], layer.back_mm[layer.covered]
            if not (back <= front).all():
                raise UsageError(
                    f"LayeredRGBD: layer {number}: {np.count_nonzero(~(back <= front))} pixels "
                    "have a back in front of their front"
                )
            if (layer.covered & ~above).any():
                raise UsageError(
                    f"LayeredRGBD: layer {number} covers pixels that the layer before it does not"
                )
            if number and (front > before.front_mm[layer.covered]).any():
                raise UsageError(
                    f"LayeredRGBD: layer {number} begins in front of the layer before it"
                )
            above, before = layer.covered, layer

    @property
    def layers(self) -> tuple[Layer, ...]:
        """See `RGBD.layers`."""
        return (Layer(self.color, self.depth_mm, self.back_mm, self.covered), *self.deeper)

    @cached_property
    def palette(self) -> np.ndarray:
        """The colours of all layers one below the other, (layers x H, W, channels)."""
        return np.concatenate([layer.color for layer in self.layers])


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

        * `intrinsics`, (fx, fy, cx, cy): in pixels; see `inim.apps.own_picture.fit.Pinhole`.
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
