"""From what a camera measured to depths of the display: two maps, and what they keep.

`linear`: the camera's range onto the display's, the paper's Eq. 4 corrected:
``z = z_min + (far - d) / (far - near) (z_max - z_min)``. As printed, Eq. 4 maps onto
[z_max, 2 z_max - z_min], beyond the range; and it is turned round where numbers grow towards the
viewer. A flat picture, near = far, goes to the central depth plane.

`reciprocal`: ``z = D (near + far) / 2 d``, Li et al. (2012) as the paper cites it: depths keep
their proportions, but what comes out beyond the display's range is clipped, as soon as
far / near > 1 + span / D.

An unprojected picture stays true under `linear`, which is then an affine map of the scene; one
taken as orthographic stays true under `reciprocal`, which is then a projective one: planes stay
planes. The other two combinations bend them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from inim.display import Display
from inim.errors import UsageError
from inim.from_camera.depth_values import DepthValues, sample

__all__ = ["DEPTH_MAPS", "DepthMap", "depth_range", "map_depth"]

DEPTH_MAPS = ("linear", "reciprocal")
# Stray pixels at the rims of objects must not set the range.
_STRAY = 0.005


@dataclass(frozen=True)
class DepthMap:
    """A map from depth d to display depth: ``z = offset_mm + slope d``, or ``+ slope / d``.

    Attributes
    ----------
    name : {"linear", "reciprocal"}
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

    def z_mm(self, depth: np.ndarray) -> np.ndarray:
        """Display depths of d, clipped: float64, NaN where d is."""
        d = np.clip(
            np.asarray(depth, np.float64), min(self.near, self.far), max(self.near, self.far)
        )
        z = self.offset_mm + self.slope * (d if self.name == "linear" else 1 / d)
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
        A stated near that is not in front of far.
    """
    known = sample(values.depth)
    ends = np.quantile(known, (_STRAY, 1 - _STRAY), method="nearest")
    first, last = (float(v) for v in (ends[::-1] if values.near_is_large else ends))
    found = (first if near is None else near, last if far is None else far)
    if not all(map(math.isfinite, found)):
        raise UsageError(f"--near {found[0]:g} --far {found[1]:g}: must be finite")
    in_front = found[0] >= found[1] if values.near_is_large else found[0] <= found[1]
    if not in_front or (near is not None and far is not None and near == far):
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
    name : {"linear", "reciprocal"}
    values : DepthValues
        For what its numbers mean.
    ends : (near, far)
        See `depth_range`.
    to : Display

    Raises
    ------
    UsageError
        `reciprocal` of what is no distance, or onto a display that shows behind its array.
    """
    if name not in DEPTH_MAPS:
        raise UsageError(f"--depth-map {name}: use {' or '.join(DEPTH_MAPS)}")
    low, high = to.depth_range_mm
    near, far = ends
    if name == "reciprocal":
        _check_reciprocal(values, ends, to)
        factor = to.central_depth_mm * (near + far) / 2
        return DepthMap(name, near, far, 0.0, factor, low, high)
    if near == far:
        centre = to.central_depth_mm
        flat = centre if low <= centre <= high else (low + high) / 2
        return DepthMap(name, near, far, flat, 0.0, low, high)
    slope = (high - low) / (near - far)
    return DepthMap(name, near, far, low - far * slope, slope, low, high)


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
