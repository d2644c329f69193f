"""Where the rays of a camera land on the panel behind a lens sheet, through the sheet's mesh.

The renderer finds the faces of the mesh of `inim.lens.full` and refracts by its own `dielectric`'s
laws. Nothing here is shared with the fit but the mesh's description of the display: no formula of
`inim.lens.thick`, no camera of `inim.calibrate`.

Rays are traced once for each position: what each picture looks like follows from where they land.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from inim.display import Display
from inim.lens import lens_array
from inim.lens.full import sheet_mesh
from inim.lens.model import SheetMesh
from inim.render import variant
from inim.render.counter_sampler import PLUGIN
from inim.render.reconstruct import mesh_shape

#: Rays a camera pixel, two by two.
SAMPLES = 4
# Fixed-point steps from a distorted radius to the true one.
_UNDISTORT_STEPS = 10
# A refracted ray starts this far along itself: clear of the facet it left, and no way aside.
_CLEAR_MM = 1e-3


@dataclass(frozen=True)
class Camera:
    """A camera with focus and distortion; OpenCV's frame: x right, y down, z forward.

    Attributes
    ----------
    columns, rows : int
        Of the sensor.
    focal_length_px, centre_x_px, centre_y_px, k1, k2 : float
        OpenCV's model, but pixel centres are at half-integers.
    pupil_mm : float
        Diameter of the pupil.
    """

    columns: int
    rows: int
    focal_length_px: float
    centre_x_px: float
    centre_y_px: float
    k1: float
    k2: float
    pupil_mm: float


class Pose(NamedTuple):
    """Where a camera stands: ``turn @ (point - eye_mm)`` is a point in its frame.

    Attributes
    ----------
    turn : (3, 3) array
    eye_mm : (3,) array
        Display frame.
    focus_mm : float
        Distance along the optical axis at which it is sharp.
    """

    turn: np.ndarray
    eye_mm: np.ndarray
    focus_mm: float


def look_at(eye_mm: np.ndarray, target_mm: np.ndarray, roll_deg: float, focus: float) -> Pose:
    """A camera that looks at a point, upright but for its roll; `focus` in distances to it."""
    forward = target_mm - eye_mm
    distance = float(np.linalg.norm(forward))
    forward = forward / distance
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(np.radians(roll_deg)), np.sin(np.radians(roll_deg))
    turn = np.stack([c * right + s * down, c * down - s * right, forward])
    return Pose(turn, np.asarray(eye_mm, float), focus * distance)


class Landing(NamedTuple):
    """Where rays land, (rows * columns * SAMPLES,) float32 each; a pixel's rays are neighbours.

    Attributes
    ----------
    column, row :
        Panel coordinates in pixels, from its left and top edge.
    weight :
        Share of the light that gets through both faces; 0 where a ray does not reach the panel.
    """

    column: np.ndarray
    row: np.ndarray
    weight: np.ndarray


class Sheet:
    """The lens sheet of a display, ready for cameras; sets the renderer's variant.

    Parameters
    ----------
    display : Display
        As it is, misalignments and all; see `inim.lens.full` for what a sheet can be.
    facets : int, optional
        See `inim.lens.full.sheet_mesh`.
    """

    def __init__(self, display: Display, facets: int | None = None) -> None:
        variant.use()
        self.mesh: SheetMesh = sheet_mesh(display, facets)
        self._display = display
        ends = {"glass": self.mesh.is_glass, "mount": ~self.mesh.is_glass}
        self._scene = mi.load_dict(
            {
                "type": "scene",
                "embree_use_robust_intersections": True,
                **{
                    name: mesh_shape(name, self.mesh, chosen, {"type": "diffuse"})
                    for name, chosen in ends.items()
                },
            }
        )
        (glass,) = (shape for shape in self._scene.shapes() if shape.id() == "glass")
        self._glass = mi.ShapePtr(glass)

    def trace(self, camera: Camera, pose: Pose, seed: int) -> Landing:
        """Trace all rays of a camera: `SAMPLES` a pixel, over its area and the pupil's."""
        lane = dr.arange(mi.UInt32, camera.rows * camera.columns * SAMPLES)
        pixel, sample = lane // SAMPLES, lane % SAMPLES
        sampler = mi.load_dict({"type": PLUGIN})
        sampler.start(seed, pixel, sample)
        within = sampler.next_2d()
        pupil = mi.warp.square_to_uniform_disk_concentric(sampler.next_2d())
        x = (mi.Float(pixel % camera.columns) + within.x - camera.centre_x_px) / (
            camera.focal_length_px
        )
        y = (mi.Float(pixel // camera.columns) + within.y - camera.centre_y_px) / (
            camera.focal_length_px
        )
        origin, direction = self._display_ray(camera, pose, _undistorted(camera, x, y), pupil)
        return _landing(self._land(origin, direction))

    def land(self, x_mm: Any, y_mm: Any, slope_x: Any, slope_y: Any) -> Landing:
        """Trace viewer's rays as lens models take them: where they cross z = 0, and their slopes.

        Parameters
        ----------
        x_mm, y_mm, slope_x, slope_y : (n,) arrays
            Slopes are sideways travel per millimetre away from the viewer.
        """
        start = self.mesh.front_mm + self._display.pitch_mm
        at = [
            mi.Float(np.asarray(place - start * slope, np.float32))
            for place, slope in ((x_mm, slope_x), (y_mm, slope_y))
        ]
        along = [mi.Float(np.asarray(slope, np.float32)) for slope in (slope_x, slope_y)]
        direction = dr.normalize(mi.Vector3f(along[0], along[1], -1))
        return _landing(self._land(mi.Point3f(at[0], at[1], start), direction))

    def _display_ray(self, camera: Camera, pose: Pose, at: Any, pupil: Any) -> tuple[Any, Any]:
        """A ray in the display frame from just before the sheet, where coordinates are small."""
        radius = camera.pupil_mm / 2
        lens = mi.Vector3f(radius * pupil.x, radius * pupil.y, 0)
        sharp = pose.focus_mm * mi.Vector3f(at[0], at[1], 1)
        to_display = mi.Matrix3f(pose.turn.T)
        direction = dr.normalize(to_display @ (sharp - lens))
        start = to_display @ lens
        height = self.mesh.front_mm + self._display.pitch_mm
        path = (height - float(pose.eye_mm[2]) - start.z) / direction.z
        x, y = (float(pose.eye_mm[k]) + start[k] + path * direction[k] for k in (0, 1))
        return mi.Point3f(x, y, height), direction

    def _land(self, origin: Any, direction: Any) -> tuple[Any, Any, Any]:
        active, weight = mi.Bool(True), mi.Float(1)
        for _ in range(2):  # into the glass, and out of it
            hit = self._scene.ray_intersect(
                mi.Ray3f(origin, direction),
                ray_flags=mi.RayFlags.ShadingFrame,
                coherent=True,
                active=active,
            )
            active &= hit.is_valid() & (hit.shape == self._glass)
            normal = hit.sh_frame.n
            reflected, cosine, _, ratio = mi.fresnel(
                -dr.dot(direction, normal), self._display.refractive_index
            )
            direction = mi.refract(-direction, normal, cosine, ratio)
            origin = hit.p + _CLEAR_MM * direction
            weight *= 1 - reflected
        x, y, downwards = self._on_panel(origin, direction)
        rows, columns = self._display.eia_shape
        pixel = self._display.pixel_pitch_mm
        column, row = x / pixel + columns / 2, rows / 2 - y / pixel
        active &= downwards & (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        return (
            dr.select(active, column, 0),
            dr.select(active, row, 0),
            dr.select(active, weight, 0),
        )

    def _on_panel(self, origin: Any, direction: Any) -> tuple[Any, Any, Any]:
        """Where a ray meets the panel, which tilts about the point behind the origin."""
        array = lens_array(self._display)
        level = self.mesh.rear_principal_mm - self._display.gap_mm
        steep = mi.Vector3f(array.tilt_x, array.tilt_y, 1)
        falls = dr.dot(direction, steep)
        path = (level - dr.dot(mi.Vector3f(origin), steep)) / falls
        return origin.x + path * direction.x, origin.y + path * direction.y, falls < 0


def _landing(traced: tuple[Any, Any, Any]) -> Landing:
    dr.eval(traced)
    return Landing(*(np.asarray(values, np.float32) for values in traced))


def _undistorted(camera: Camera, x: Any, y: Any) -> tuple[Any, Any]:
    """Tangents of the ray that distortion brings to (x, y)."""
    u, v = x, y
    for _ in range(_UNDISTORT_STEPS):
        square = u * u + v * v
        stretch = 1 + square * (camera.k1 + camera.k2 * square)
        u, v = x / stretch, y / stretch
    return u, v
