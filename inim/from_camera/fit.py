"""Fitting a camera's picture to a display: where it lies, how large it is, how deep.

Depths are mapped in one of three ways. `linear`: the camera's range onto the display's, the paper's
Eq. 4 corrected: ``z = z_min + (far - d) / (far - near) (z_max - z_min)``, turned round where
numbers grow towards the viewer. A flat picture, near = far, goes to the central depth plane.

`reciprocal`: ``z = D (near + far) / 2 d``, Li et al. (2012) as the paper cites it: depths keep
their proportions, but what comes out beyond the display's range is clipped, as soon as
far / near > 1 + span / D.

`printed`: Eq. 4 to the letter, for reproduction, ``z = z_max + (d - d_min) / (d_max - d_min)
(z_max - z_min)``. It maps onto [z_max, 2 z_max - z_min], in front of the displayable depth, and
numbers that grow away from the viewer inside out. z_min and z_max are those of the displayable
depth, D -+ span / 2; what lies beyond the display's depth range is clipped, all but d_min unless
depth_min_mm and depth_max_mm state a larger one.

An unprojected picture stays true under `linear`, which is then an affine map of the scene; one
taken as orthographic stays true under `reciprocal`, which is then a projective one: planes stay
planes. The other two combinations bend them.

A perspective picture is unprojected: each sample goes to its place in space, and one affine map
takes that space to the display, with one scale for x and y, and its own for z where depths are
mapped linearly. At one distance, the frame's (`frame_at`, by default the median depth), the
camera's picture then fits the lens array, and its middle lies on the display's axis; nearer the
camera sees less than the array's width, farther more. A picture taken as orthographic fits the
array at every depth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inim.display import Display
from inim.errors import UsageError
from inim.from_camera.depth_values import DepthValues, sample
from inim.from_camera.tiles import CameraTiles, draw_tiles
from inim.image.rgbd import RGBD

DEPTH_MAPS = ("linear", "reciprocal", "printed")
# Stray pixels at the rims of objects must not set the range.
_STRAY = 0.005


@dataclass(frozen=True)
class DepthMap:
    """A map from depth d to display depth: ``z = offset_mm + slope d``, or ``+ slope / d``.

    Attributes
    ----------
    name : {"linear", "reciprocal", "printed"}
    near, far : float
        Range of d that is mapped; what lies beyond is taken to its end.
    offset_mm, slope : float
    low_mm, high_mm : float
        Display depths are kept between these.
    """

    name: str
    near: float
    far: float
    offset_mm: float
    slope: float
    low_mm: float
    high_mm: float

    @property
    def over_depth(self) -> bool:
        """Whether z goes with 1 / d."""
        return self.name == "reciprocal"

    def warnings(self, clipped: float) -> tuple[str, ...]:
        """What to say of it, with the share of the samples beyond the range."""
        if self.name != "printed":
            return ()
        ends = sorted(self.offset_mm + self.slope * d for d in (self.near, self.far))
        said = (
            f"--depth-map printed: Eq. 4 as printed maps onto {ends[0]:.6g} .. {ends[1]:.6g} mm; "
            f"{clipped:.1%} of the samples lie beyond the display's range, {self.low_mm:.6g} .. "
            f"{self.high_mm:.6g} mm"
        )
        if clipped and self.low_mm > 0:
            said += (
                f"; to show them there: -D inim.depth_min_mm={self.low_mm:.6g} -D "
                f"inim.depth_max_mm={math.ceil(ends[1])}"
            )
        if self.near < self.far:
            said += "; depths grow away from the viewer, so what is far is shown in front"
        return (said,)

    def z_mm(self, depth: np.ndarray) -> np.ndarray:
        """Display depths of d, clipped: float64, NaN where d is."""
        d = np.clip(
            np.asarray(depth, np.float64), min(self.near, self.far), max(self.near, self.far)
        )
        z = self.offset_mm + self.slope * (1 / d if self.over_depth else d)
        clipped: np.ndarray = np.clip(z, self.low_mm, self.high_mm)
        return clipped


def depth_range(
    values: DepthValues, near: float | None = None, far: float | None = None
) -> tuple[float, float]:
    """Nearest and farthest depth to map, in the unit of `values`.

    Parameters
    ----------
    values : DepthValues
    near, far : float, optional
        Stated ends; otherwise the 0.5 % and 99.5 % quantiles.

    Raises
    ------
    UsageError
        A stated near that is not in front of far, or an end that all of the picture lies beyond.
    """
    known = sample(values.depth)
    ends = np.quantile(known, (_STRAY, 1 - _STRAY), method="nearest")
    first, last = (float(v) for v in (ends[::-1] if values.near_is_large else ends))
    found = (first if near is None else near, last if far is None else far)
    if not all(map(math.isfinite, found)):
        raise UsageError(f"--near {found[0]:g} --far {found[1]:g}: must be finite")
    in_front = found[0] >= found[1] if values.near_is_large else found[0] <= found[1]
    if not in_front or (near is not None and far is not None and near == far):
        if near is None or far is None:
            stated, other, beyond = (
                (f"--near {near:g}", "--far", "behind")
                if near is not None
                else (f"--far {far:g}", "--near", "in front of")
            )
            raise UsageError(
                f"{stated}: the picture has no depth {beyond} that (its depths run from {first:g} "
                f"to {last:g}); give another, or {other} too"
            )
        grow = "fall" if values.near_is_large else "grow"
        raise UsageError(
            f"--near {found[0]:g} --far {found[1]:g}: depths {grow} away from the viewer here (the "
            f"picture's run from {first:g} to {last:g}); swap the two, or correct them"
        )
    if values.has_unit and not values.near_is_large and found[0] <= 0:
        raise UsageError(f"--near {found[0]:g}: a distance from the camera is above 0")
    return found


def map_depth(name: str, values: DepthValues, ends: tuple[float, float], to: Display) -> DepthMap:
    """The map of a depth range onto a display's.

    Parameters
    ----------
    name : {"linear", "reciprocal", "printed"}
    values : DepthValues
        For what its numbers mean.
    ends : (near, far)
        See `depth_range`.
    to : Display

    Raises
    ------
    UsageError
        `reciprocal` of what is no distance, or onto a display that shows behind its array;
        `printed` of a flat picture, or onto a focused display.
    """
    if name not in DEPTH_MAPS:
        raise UsageError(f"--depth-map {name}: use {' or '.join(DEPTH_MAPS)}")
    low, high = to.depth_range_mm
    near, far = ends
    if name == "reciprocal":
        _check_reciprocal(values, ends, to)
        factor = to.central_depth_mm * (near + far) / 2
        return DepthMap(name, near, far, 0.0, factor, low, high)
    if name == "printed":
        return _as_printed(ends, to)
    if near == far:
        centre = to.central_depth_mm
        flat = centre if low <= centre <= high else (low + high) / 2
        return DepthMap(name, near, far, flat, 0.0, low, high)
    slope = (high - low) / (near - far)
    return DepthMap(name, near, far, low - far * slope, slope, low, high)


def _as_printed(ends: tuple[float, float], to: Display) -> DepthMap:
    """Eq. 4 to the letter, clipped to the display's depth range."""
    least, most = sorted(ends)
    if math.isinf(to.central_depth_mm) or least == most:
        why = f"display {to.name} is focused" if least < most else "the picture is flat"
        raise UsageError(
            f"--depth-map printed: Eq. 4 has no value where {why}; use --depth-map linear"
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
            f"--depth-map reciprocal: display {to.name} has its central depth plane at "
            f"{to.central_depth_mm:g} mm, and D (near + far) / 2d is for one in front of the "
            "array; use --depth-map linear"
        )


FITS = ("contain", "cover")
# Wider than a fisheye's middle, narrower than a telescope's: a slip, or another picture's numbers.
_WIDEST_DEG = 160.0
_NARROWEST_DEG = 1.0


@dataclass(frozen=True)
class Pinhole:
    """Focal lengths and principal point, pixels.

    The centre of pixel (row i, column j) is at (j, i), as OpenCV and Open3D count: a camera of
    640 x 480 pixels that looks straight ahead has its principal point at (319.5, 239.5).
    """

    fx: float
    fy: float
    cx: float
    cy: float


def parse_intrinsics(text: str) -> Pinhole:
    """``fx,fy,cx,cy`` in pixels.

    Raises
    ------
    UsageError
        Not four finite numbers, or a focal length that is not positive.
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 4 or not all(map(math.isfinite, numbers)) or min(numbers[:2]) <= 0:
        raise UsageError(
            f"--intrinsics {text}: write fx,fy,cx,cy in pixels of the colour picture, such as "
            "525,525,319.5,239.5"
        )
    return Pinhole(*numbers)


def check_pinhole(camera: Pinhole, shape: tuple[int, int]) -> None:
    """Raise `UsageError` for intrinsics that cannot be those of a picture of this shape."""
    rows, columns = shape
    if not (-0.5 <= camera.cx <= columns - 0.5 and -0.5 <= camera.cy <= rows - 0.5):
        raise UsageError(
            f"--intrinsics: principal point ({camera.cx:g}, {camera.cy:g}) lies outside the colour "
            f"picture of {columns} x {rows} pixels; scale fx,fy,cx,cy to that size"
        )
    for name, focal, pixels in (("fx", camera.fx, columns), ("fy", camera.fy, rows)):
        angle = math.degrees(2 * math.atan(pixels / (2 * focal)))
        if not _NARROWEST_DEG <= angle <= _WIDEST_DEG:
            raise UsageError(
                f"--intrinsics: {name} = {focal:g} pixels over {pixels} pixels sees {angle:.3g} "
                "degrees; give fx,fy,cx,cy in pixels of the colour picture, not in millimetres"
            )


@dataclass(frozen=True)
class PictureFit:
    """A picture in the display frame.

    Attributes
    ----------
    rgbd : RGBD
    clipped : float
        Share of the samples with depth that lie beyond the range.
    empty : float
        Share of the lens array's area without any surface in front of or behind it.
    frame_at : float or None
        Distance at which the picture fits the array, in the unit of the depth; None where it is
        taken as orthographic.
    scale : float
        Display millimetres per unit of depth across, or per picture pixel where orthographic.
    framing : str or None
        How range, place and size were chosen, where they were.
    """

    rgbd: RGBD
    clipped: float
    empty: float
    frame_at: float | None
    scale: float
    framing: str | None = None


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
) -> PictureFit:
    """Bring a colour and depth picture into a display's frame.

    Parameters
    ----------
    color : (H, W, 3) uint8 sRGB, or float32 linear RGB
    values : DepthValues
        Of the same rows and columns.
    depth_map : DepthMap
    display : Display
    camera : Pinhole or None
        None takes the picture as orthographic.
    pixels_per_pitch : float
        Cells of the result per lens pitch.
    fit : {"contain", "cover"}
        Whether all of the picture's frame lies on the array, or all of the array in the frame.
    frame_at : float, optional
        Distance at which it does; the median otherwise. Perspective only.
    steepest : float
        Neighbouring samples are one surface up to this slope, depth over width: 10 is 84 degrees.
        Of the scene where it is unprojected, of the display's picture where orthographic.
    coarseness : float
        Width of a sample of the depth picture in pixels of the colour picture, at least 1.
    drop : bool
        Leave out what lies beyond the depth range instead of taking it to its end.

    Raises
    ------
    UsageError
        Depths that cannot be unprojected, or nothing of the picture lies on the display.
    """
    rows, columns = values.depth.shape
    size = display.width_mm, display.height_mm
    larger = {"contain": min, "cover": max}.get(fit)
    if larger is None:
        raise UsageError(f"--fit {fit}: use {' or '.join(FITS)}")
    if camera is None:
        frame_at = None
        scale = larger(size[0] / columns, size[1] / rows)
        place = {"ax": scale, "ay": scale, "cx": (columns - 1) / 2, "cy": (rows - 1) / 2}
        place |= {"ox": 0.0, "oy": 0.0}
        apart, share = _apart(values, depth_map, max_slope * coarseness * scale), 0.0
    else:
        _check_distances(values)
        frame_at = float(np.median(sample(values.depth))) if frame_at is None else frame_at
        if not 0 < frame_at < math.inf:
            raise UsageError(f"--frame-at {frame_at:g}: must be a distance above 0")
        scale = larger(
            size[0] * camera.fx / (columns * frame_at), size[1] * camera.fy / (rows * frame_at)
        )
        place = {"ax": scale / camera.fx, "ay": scale / camera.fy, "cx": camera.cx, "cy": camera.cy}
        place["ox"] = -place["ax"] * ((columns - 1) / 2 - camera.cx) * frame_at
        place["oy"] = place["ay"] * ((rows - 1) / 2 - camera.cy) * frame_at
        share = max_slope * coarseness / min(camera.fx, camera.fy)
        apart, share = 0.0, max(share, 1.5 * values.inverse_step * depth_map.far)
    inverse = camera is not None or depth_map.over_depth
    ends = [1 / d if inverse else d for d in (depth_map.near, depth_map.far)]
    tiles = CameraTiles(
        q=_inverse(values.depth) if inverse else values.depth,
        q_low=min(ends),
        q_high=max(ends),
        perspective=camera is not None,
        over_q=camera is not None and not depth_map.over_depth,
        depth_map=depth_map,
        apart=apart,
        apart_share=share,
        drop=drop,
        **place,
    )
    shape = display.capture_shape(pixels_per_pitch)
    cell = display.capture_pixel_mm(pixels_per_pitch)
    drawn = draw_tiles(tiles, color, shape, cell, max_slope * cell)
    if not drawn.covered.any():
        raise UsageError(
            "nothing of the picture lies on the display: check --intrinsics, --frame-at, --near "
            "and --far"
        )
    return PictureFit(
        RGBD(drawn.color, drawn.depth_mm, drawn.covered, cell),
        drawn.clipped / max(1, int(np.count_nonzero(~np.isnan(values.depth)))),
        empty_share(drawn.covered, display, cell),
        frame_at,
        scale,
    )


def _check_distances(values: DepthValues) -> None:
    if values.near_is_large:
        raise UsageError(
            "--intrinsics: unprojection needs distances that grow away from the camera, and this "
            "depth grows towards it; say --far-is-large if it does not, or use --orthographic"
        )
    least = float(np.nanmin(values.depth))
    if least <= 0:
        raise UsageError(
            f"--intrinsics: unprojection needs distances above 0, and there is a depth of "
            f"{least:g}; say --missing {least:g} if it means none, or use --orthographic"
        )


def _inverse(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    with np.errstate(divide="ignore"):
        inverse: NDArray[np.float32] = np.float32(1) / depth
    return inverse


def _apart(values: DepthValues, depth_map: DepthMap, apart_mm: float) -> float:
    """How far numbers of one surface differ that is `apart_mm` apart on the display.

    At least one and a half steps of the file: its own coarseness tears nothing.
    """
    d = np.array([depth_map.near, depth_map.far])
    if depth_map.slope == 0:
        return math.inf
    least = apart_mm / abs(depth_map.slope)
    if depth_map.over_depth:
        return max(least, 1.5 * values.step / float(d.min() ** 2), 1.5 * values.inverse_step)
    return max(least, 1.5 * values.step, 1.5 * values.inverse_step * float(d.max() ** 2))


def empty_share(covered: np.ndarray, display: Display, cell_mm: float) -> float:
    """Share of a fitted picture's cells on the lens array that nothing covers.

    Parameters
    ----------
    covered : (rows, columns) bool
    display : Display
    cell_mm : float
    """
    rows, columns = covered.shape
    x = np.abs((np.arange(columns) + 0.5) * cell_mm - columns * cell_mm / 2)
    y = np.abs((np.arange(rows) + 0.5) * cell_mm - rows * cell_mm / 2)
    on_array = np.ix_(y < display.height_mm / 2, x < display.width_mm / 2)
    return float(1 - covered[on_array].mean())
