"""Fit of a camera's picture to a display: position, size and depth.

There are three depth maps; docs/theory/paper.md compares them. `linear` maps the camera's depth
range onto the display's, ``z = z_min + (far - d) / (far - near) (z_max - z_min)``, reversed if
numbers grow towards the viewer. A flat picture is placed at the central depth plane. `reciprocal`
is ``z = D (near + far) / 2 d`` (Li et al. 2012). `printed` is Eq. 4 of the paper as printed:
``z = z_max + (d - d_min) / (d_max - d_min) (z_max - z_min)``, beyond the displayable depth.

A perspective picture is unprojected: each sample is moved to its position in space, and an affine
map takes that space to the display. It has one scale for x and y, and another for z if depths are
mapped linearly. At the distance `frame_at` (by default the median depth), the picture fits the lens
array, centred on the display's axis. An orthographic picture fits the array at every depth.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inim.apps.own_picture.depth_values import DepthValues, sample
from inim.apps.own_picture.options import DepthMapName
from inim.apps.own_picture.tiles import TileFrame, draw_tiles
from inim.display import Display
from inim.image.rgbd import RGBD
from inim.pipeline.stages.picture import empty_share
from inim.system.errors import UsageError

# Stray pixels at the rims of objects must not set the range.
_STRAY = 0.005


@dataclass(frozen=True)
class DepthMap:
    """Map from depth d to display depth: ``z = offset_mm + slope d``, or ``+ slope / d``."""

    name: DepthMapName
    #: Range of d; values beyond it are clipped.
    near: float
    far: float
    offset_mm: float
    slope: float
    #: Range to which display depths are clipped.
    low_mm: float
    high_mm: float

    @property
    def is_reciprocal(self) -> bool:
        """True if z is linear in 1 / d."""
        return self.name == "reciprocal"

    def warnings(self, clipped: float) -> tuple[str, ...]:
        """Warnings about `printed`, given the share of clipped samples."""
        if self.name != "printed":
            return ()
        ends = sorted(self.offset_mm + self.slope * d for d in (self.near, self.far))
        warning = (
            f"--depth-map printed: Eq. 4 as printed maps onto {ends[0]:.6g} .. {ends[1]:.6g} mm; "
            f"{clipped:.1%} of the samples are beyond the display's range, {self.low_mm:.6g} .. "
            f"{self.high_mm:.6g} mm"
        )
        if clipped and self.low_mm > 0:
            warning += (
                f"; to show them there: -D inim.depth_min_mm={self.low_mm:.6g} -D "
                f"inim.depth_max_mm={math.ceil(ends[1])}"
            )
        if self.near < self.far:
            warning += "; depths grow away from the viewer, so far points are shown in front"
        return (warning,)

    def z_mm(self, depth: np.ndarray) -> np.ndarray:
        """Clipped display depths of d, float64; NaN where d is NaN."""
        d = np.clip(
            np.asarray(depth, np.float64), min(self.near, self.far), max(self.near, self.far)
        )
        z = self.offset_mm + self.slope * (1 / d if self.is_reciprocal else d)
        z_mm: np.ndarray = np.clip(z, self.low_mm, self.high_mm)
        return z_mm


def depth_range(
    values: DepthValues, near: float | None = None, far: float | None = None
) -> tuple[float, float]:
    """Nearest and farthest depth to map, in the unit of `values`.

    The user may set either end; by default they are the 0.5 % and 99.5 % quantiles. Raises
    `UsageError` if near is not in front of far, or if all of the picture is beyond one end.
    """
    ends = np.quantile(sample(values.depth), (_STRAY, 1 - _STRAY), method="nearest")
    nearest, farthest = (float(v) for v in (ends[::-1] if values.near_is_large else ends))
    first, last = (nearest if near is None else near, farthest if far is None else far)
    is_ordered = first >= last if values.near_is_large else first <= last
    if not is_ordered or (near is not None and far is not None and near == far):
        if near is None or far is None:
            option, opposite, side = (
                (f"--near {near:g}", "--far", "behind")
                if near is not None
                else (f"--far {far:g}", "--near", "in front of")
            )
            raise UsageError(
                f"{option}: the picture has no depth {side} it (its depths extend from "
                f"{nearest:g} to {farthest:g}); change it, or give {opposite} too"
            )
        trend = "fall" if values.near_is_large else "grow"
        raise UsageError(
            f"--near {first:g} --far {last:g}: wrong order, as these depths {trend} away from the "
            f"viewer (from {nearest:g} to {farthest:g}); swap or correct the two"
        )
    if values.has_unit and not values.near_is_large and first <= 0:
        raise UsageError(f"--near {first:g}: a distance from the camera must be above 0")
    return first, last


def map_depth(
    name: DepthMapName, values: DepthValues, ends: tuple[float, float], to: Display
) -> DepthMap:
    """Map a depth range onto a display's.

    * `values`: supplies the direction of the depths.
    * `ends`, (near, far): see `depth_range`.

    Raises `UsageError`: `reciprocal` for depths that are not distances, or for a display whose CDP
    is behind the array; `printed` for a flat picture or a focused display.
    """
    low, high = to.depth_range_mm
    near, far = ends
    if name == "reciprocal":
        _check_reciprocal(values, ends, to)
        factor = to.central_depth_mm * (near + far) / 2
        return DepthMap(name, near, far, 0.0, factor, low, high)
    if name == "printed":
        return _map_as_printed(ends, to)
    if near == far:
        centre = to.central_depth_mm
        flat = centre if low <= centre <= high else (low + high) / 2
        return DepthMap(name, near, far, flat, 0.0, low, high)
    slope = (high - low) / (near - far)
    return DepthMap(name, near, far, low - far * slope, slope, low, high)


def _map_as_printed(ends: tuple[float, float], to: Display) -> DepthMap:
    """Eq. 4 as printed, clipped to the display's depth range."""
    least, most = sorted(ends)
    if math.isinf(to.central_depth_mm) or least == most:
        reason = f"display {to.name} is focused" if least < most else "the picture is flat"
        raise UsageError(
            f"--depth-map printed: Eq. 4 is undefined because {reason}; use --depth-map linear"
        )
    z_min, z_max = to.replace(depth_min_mm=None, depth_max_mm=None).depth_range_mm
    slope = (z_max - z_min) / (most - least)
    return DepthMap("printed", *ends, z_max - least * slope, slope, *to.depth_range_mm)


def _check_reciprocal(values: DepthValues, ends: tuple[float, float], to: Display) -> None:
    if values.near_is_large or min(ends) <= 0:
        raise UsageError(
            "--depth-map reciprocal: needs distances from the camera, and these depths are "
            f"{ends[0]:g} (near) to {ends[1]:g} (far); use --depth-map linear"
        )
    if not 0 < to.central_depth_mm < math.inf:
        raise UsageError(
            f"--depth-map reciprocal: needs a central depth plane in front of the array, and that "
            f"of display {to.name} is at {to.central_depth_mm:g} mm; use --depth-map linear"
        )


_FITS = {"contain": min, "cover": max}
# Angles of view from a telescope's to a fisheye's; others indicate a mistake.
_WIDEST_DEG = 160.0
_NARROWEST_DEG = 1.0


@dataclass(frozen=True)
class Pinhole:
    """Focal lengths and principal point of a pinhole camera, in pixels.

    The centre of pixel (row i, column j) is at (j, i), as in OpenCV and Open3D: the centre of a
    picture of 640 x 480 pixels is (319.5, 239.5).
    """

    fx: float
    fy: float
    cx: float
    cy: float
    source: str = "--intrinsics"  #: Place of the numbers, for messages.


def parse_intrinsics(text: str, source: str = "--intrinsics") -> Pinhole:
    """Parse ``fx,fy,cx,cy`` in pixels; raises `UsageError` for invalid numbers.

    * `source`: place of the text, for messages.
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 4 or not all(map(math.isfinite, numbers)) or min(numbers[:2]) <= 0:
        raise UsageError(
            f"{source} {text}: give fx,fy,cx,cy in pixels of the colour picture, such as "
            "525,525,319.5,239.5"
        )
    fx, fy, cx, cy = numbers
    return Pinhole(fx, fy, cx, cy, source)


def check_pinhole(camera: Pinhole, shape: tuple[int, int]) -> None:
    """Raise `UsageError` for intrinsics that do not match a picture of this shape."""
    rows, columns = shape
    if not (-0.5 <= camera.cx <= columns - 0.5 and -0.5 <= camera.cy <= rows - 0.5):
        raise UsageError(
            f"{camera.source}: principal point ({camera.cx:g}, {camera.cy:g}) is outside the "
            f"colour picture of {columns} x {rows} pixels; scale fx,fy,cx,cy to that size"
        )
    for name, focal, pixels in (("fx", camera.fx, columns), ("fy", camera.fy, rows)):
        angle = math.degrees(2 * math.atan(pixels / (2 * focal)))
        if not _NARROWEST_DEG <= angle <= _WIDEST_DEG:
            raise UsageError(
                f"{camera.source}: {name} = {focal:g} pixels over {pixels} pixels is an angle of "
                f"view of {angle:.3g} degrees; give fx,fy,cx,cy in pixels of the colour "
                "picture, not in millimetres"
            )


@dataclass(frozen=True)
class PictureFit:
    """A picture in the display frame."""

    rgbd: RGBD
    clipped: float  #: Share of the samples with depth that are out of range.
    empty: float  #: Share of the lens array's area without any surface in front of or behind it.
    #: Distance at which the picture fits the array, in the unit of the depth; None if orthographic.
    frame_at: float | None
    #: Display millimetres per unit of length in x and y, or per picture pixel if orthographic.
    scale: float
    framing: dict[str, str] | None = None  #: Notes of the automatic framing, if used.


def fit_picture(
    color: np.ndarray,
    values: DepthValues,
    depth_map: DepthMap,
    display: Display,
    *,
    camera: Pinhole | None,
    pixels_per_pitch: float = 5,
    fit: str = "contain",
    frame_at: float | None = None,
    max_slope: float = 10.0,
    coarseness: float = 1.0,
    drop: bool = False,
    as_shown: bool = False,
) -> PictureFit:
    """Fit a colour and depth picture to a display.

    * `color`, (H, W, 3) uint8 sRGB, or float32 linear RGB
    * `values`: same rows and columns as `color`.
    * `camera`: None for an orthographic picture.
    * `pixels_per_pitch`: cells of the result per lens pitch.
    * `fit`, {"contain", "cover"}: show the whole picture, or fill the whole array.
    * `frame_at`: distance at which the picture fits the array; by default the median. Perspective
      only.
    * `max_slope`: maximum slope (depth over width) between neighbouring samples of one surface: 10
      is 84 degrees. Measured in the scene, or on the display for orthographic pictures.
    * `coarseness`: width of a depth sample in colour pixels, at least 1.
    * `drop`: omit samples out of range instead of clipping them.
    * `as_shown`: give 8-bit sRGB with alpha, as a player sends it to the panel, instead of linear
      RGB.

    Raises `UsageError`: the depths cannot be unprojected, or no part of the picture is on the
    display.
    """
    rows, columns = values.depth.shape
    if camera is None:
        frame_at = None
        scale = _FITS[fit](display.width_mm / columns, display.height_mm / rows)
        mapping = {"ax": scale, "ay": scale, "cx": (columns - 1) / 2, "cy": (rows - 1) / 2}
        mapping |= {"ox": 0.0, "oy": 0.0}
        tolerance, share = _tolerance(values, depth_map, max_slope * coarseness * scale), 0.0
    else:
        scale, (ox, oy), frame_at = unprojection(values, camera, display, fit, frame_at)
        mapping = {"ax": scale / camera.fx, "ay": scale / camera.fy}
        mapping |= {"cx": camera.cx, "cy": camera.cy, "ox": ox, "oy": oy}
        share = max_slope * coarseness / min(camera.fx, camera.fy)
        tolerance, share = 0.0, max(share, 1.5 * values.inverse_step * depth_map.far)
    inverse = camera is not None or depth_map.is_reciprocal
    with np.errstate(divide="ignore"):
        q: NDArray[np.float32] = np.float32(1) / values.depth if inverse else values.depth
    ends = [1 / d if inverse else d for d in (depth_map.near, depth_map.far)]
    shape = display.capture_shape(pixels_per_pitch)
    cell = display.capture_pixel_mm(pixels_per_pitch)
    frame = TileFrame(
        **mapping,
        perspective=camera is not None,
        over_q=camera is not None and not depth_map.is_reciprocal,
        offset_mm=depth_map.offset_mm,
        slope=depth_map.slope,
        low_mm=depth_map.low_mm,
        high_mm=depth_map.high_mm,
        cell_mm=cell,
        q_low=min(ends),
        q_high=max(ends),
        tolerance=tolerance,
        tolerance_share=share,
        drop=drop,
    )
    image = draw_tiles(q, color, frame, shape, max_slope * cell, as_shown=as_shown)
    if not image.covered.any():
        raise UsageError(
            "no part of the picture is on the display: check --intrinsics, --frame-at, --near "
            "and --far"
        )
    return PictureFit(
        RGBD(image.color, image.depth_mm, image.covered, cell),
        image.clipped / max(1, int(np.count_nonzero(~np.isnan(values.depth)))),
        empty_share(image.covered, display, cell),
        frame_at,
        scale,
    )


def unprojection(
    values: DepthValues, camera: Pinhole, display: Display, fit: str, frame_at: float | None
) -> tuple[float, tuple[float, float], float]:
    """Affine map of a pinhole camera's space to the display, in x and y.

    Returns `scale`: display millimetres per unit of length; `offset`, (right, up): position of the
    camera's axis, in mm; `frame_at`: distance at which the picture fits the array.

    Raises `UsageError`: the depths are not distances.
    """
    _check_distances(values, camera.source)
    rows, columns = values.depth.shape
    frame_at = float(np.median(sample(values.depth))) if frame_at is None else frame_at
    scale = _FITS[fit](
        display.width_mm * camera.fx / (columns * frame_at),
        display.height_mm * camera.fy / (rows * frame_at),
    )
    ox = -(scale / camera.fx) * ((columns - 1) / 2 - camera.cx) * frame_at
    oy = scale / camera.fy * ((rows - 1) / 2 - camera.cy) * frame_at
    return scale, (ox, oy), frame_at


def _check_distances(values: DepthValues, source: str) -> None:
    if values.near_is_large:
        raise UsageError(
            f"{source}: unprojection needs distances that grow away from the camera, and this "
            "depth grows towards it; use --orthographic, or --far-is-large if that is wrong"
        )
    least = float(np.fmin.reduce(values.depth, axis=None))  # NaN if all are missing
    if least <= 0:
        raise UsageError(
            f"{source}: unprojection needs distances above 0, and there is a depth of "
            f"{least:g}; use --orthographic, or --missing {least:g} if it means no depth"
        )


def _tolerance(values: DepthValues, depth_map: DepthMap, step_mm: float) -> float:
    """Difference of numbers for a depth step of `step_mm` on the display.

    At least 1.5 quantisation steps of the file, which must not split a surface.
    """
    d = np.array([depth_map.near, depth_map.far])
    if depth_map.slope == 0:
        return math.inf
    least = step_mm / abs(depth_map.slope)
    if depth_map.is_reciprocal:
        return max(least, 1.5 * values.step / float(d.min() ** 2), 1.5 * values.inverse_step)
    return max(least, 1.5 * values.step, 1.5 * values.inverse_step * float(d.max() ** 2))
