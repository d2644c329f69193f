"""Panel points that the rays of a camera reach through the mesh of the lens sheet.

The renderer intersects the mesh of `inim.lens.full` and refracts by the laws of its `dielectric`.
This module shares only the mesh's description of the display with the fit. It uses no formula of
`inim.lens.thick` and no camera of `inim.calibration`.

Rays are traced once for each position. Their panel points determine the photograph of any picture.
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

#: Rays per camera pixel, two by two.
SAMPLES = 4
# Fixed-point steps from a distorted radius to the true one.
_UNDISTORT_STEPS = 10
# A refracted ray starts at this distance along its direction, clear of the facet it left.
_START_OFFSET_MM = 1e-3


@dataclass(frozen=True)
class Camera:
    """A camera with focus and distortion in OpenCV's frame: x right, y down, z forward.

    Attributes
    ----------
    columns, rows : int
        Size of the sensor in pixels.
    focal_length_px, centre_x_px, centre_y_px, k1, k2 : float
        OpenCV's model with pixel centres at half-integers.
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
    """Pose of a camera: ``turn @ (point - eye_mm)`` is a point in the camera's frame.

    Attributes
    ----------
    turn : (3, 3) array
        Rotation from the display frame to the camera frame.
    eye_mm : (3,) array
        Centre of the pupil in the display frame.
    focus_mm : float
        Focus distance along the optical axis.
    """

    turn: np.ndarray
    eye_mm: np.ndarray
    focus_mm: float


def look_at(eye_mm: np.ndarray, target_mm: np.ndarray, roll_deg: float, focus: float) -> Pose:
    """Pose of a camera that looks at a point; `focus` is relative to the point's distance."""
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
    """Panel points of rays, (rows * columns * SAMPLES,) float32 each; a pixel's rays are adjacent.

    Attributes
    ----------
    column, row :
        Panel coordinates in pixels, from its left and top edge.
    weight :
        Share of the light that passes both faces; 0 if the ray does not reach the panel.
    """

    column: np.ndarray
    row: np.ndarray
    weight: np.ndarray


class Sheet:
    """Mesh of a display's lens sheet in a renderer's scene; sets the renderer's variant.

    Parameters
    ----------
    display : Display
        The display with its misalignment; `inim.lens.full` lists the supported sheets.
    facets : int, optional
        See `inim.lens.full.sheet_mesh`.
    """

    def __init__(self, display: Display, facets: int | None = None) -> None:
        variant.use()
        self.mesh: SheetMesh = sheet_mesh(display, facets)
        self._display = display
        face_masks = {"glass": self.mesh.is_glass, "mount": ~self.mesh.is_glass}
        self._scene = mi.load_dict(
            {
                "type": "scene",
                "embree_use_robust_intersections": True,
                **{
                    name: mesh_shape(name, self.mesh, faces, {"type": "diffuse"})
                    for name, faces in face_masks.items()
                },
            }
        )
        (glass,) = (shape for shape in self._scene.shapes() if shape.id() == "glass")
        self._glass = mi.ShapePtr(glass)

    def trace(self, camera: Camera, pose: Pose, seed: int) -> Landing:
        """Trace `SAMPLES` rays per camera pixel, spread over the pixel and the pupil."""
        lane = dr.arange(mi.UInt32, camera.rows * camera.columns * SAMPLES)
        pixel, sample = lane // SAMPLES, lane % SAMPLES
        sampler = mi.load_dict({"type": PLUGIN})
        sampler.start(seed, pixel, sample)
        pixel_point = sampler.next_2d()
        pupil = mi.warp.square_to_uniform_disk_concentric(sampler.next_2d())
        x = (mi.Float(pixel % camera.columns) + pixel_point.x - camera.centre_x_px) / (
            camera.focal_length_px
        )
        y = (mi.Float(pixel // camera.columns) + pixel_point.y - camera.centre_y_px) / (
            camera.focal_length_px
        )
        origin, direction = self._display_ray(camera, pose, _undistorted(camera, x, y), pupil)
        return _landing(self._land(origin, direction))

    def land(self, x_mm: Any, y_mm: Any, slope_x: Any, slope_y: Any) -> Landing:
        """Trace viewing rays in the lens models' form: crossing of z = 0 and slopes.

        Parameters
        ----------
        x_mm, y_mm, slope_x, slope_y : (n,) arrays
            Slopes are sideways travel per millimetre away from the viewer.
        """
        start = self.mesh.front_mm + self._display.pitch_mm
        origin_x, origin_y = (
            mi.Float(np.asarray(crossing - start * slope, np.float32))
            for crossing, slope in ((x_mm, slope_x), (y_mm, slope_y))
        )
        along_x, along_y = (mi.Float(np.asarray(s, np.float32)) for s in (slope_x, slope_y))
        direction = dr.normalize(mi.Vector3f(along_x, along_y, -1))
        return _landing(self._land(mi.Point3f(origin_x, origin_y, start), direction))

    def _display_ray(
        self, camera: Camera, pose: Pose, tangents: Any, pupil: Any
    ) -> tuple[Any, Any]:
        """Origin and direction of a ray in the display frame, just in front of the sheet."""
        radius = camera.pupil_mm / 2
        pupil_point = mi.Vector3f(radius * pupil.x, radius * pupil.y, 0)
        focus_point = pose.focus_mm * mi.Vector3f(tangents[0], tangents[1], 1)
        to_display = mi.Matrix3f(pose.turn.T)
        direction = dr.normalize(to_display @ (focus_point - pupil_point))
        start = to_display @ pupil_point
        height = self.mesh.front_mm + self._display.pitch_mm
        path = (height - float(pose.eye_mm[2]) - start.z) / direction.z
        x, y = (float(pose.eye_mm[k]) + start[k] + path * direction[k] for k in (0, 1))
        return mi.Point3f(x, y, height), direction

    def _land(self, origin: Any, direction: Any) -> tuple[Any, Any, Any]:
        """Panel column, panel row and weight of rays."""
        active, weight = mi.Bool(True), mi.Float(1)
        for _ in range(2):  # entry into the glass, exit from it
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
            origin = hit.p + _START_OFFSET_MM * direction
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
        """Point where a ray meets the panel, which tilts about the point behind the origin."""
        array = lens_array(self._display)
        level = self.mesh.rear_principal_mm - self._display.gap_mm
        normal = mi.Vector3f(array.tilt_x, array.tilt_y, 1)
        descent = dr.dot(direction, normal)
        path = (level - dr.dot(mi.Vector3f(origin), normal)) / descent
        return origin.x + path * direction.x, origin.y + path * direction.y, descent < 0


def _landing(traced: tuple[Any, Any, Any]) -> Landing:
    dr.eval(traced)
    return Landing(*(np.asarray(values, np.float32) for values in traced))


def _undistorted(camera: Camera, x: Any, y: Any) -> tuple[Any, Any]:
    """Tangents of the ray that distortion moves to (x, y)."""
    u, v = x, y
    for _ in range(_UNDISTORT_STEPS):
        square = u * u + v * v
        stretch = 1 + square * (camera.k1 + camera.k2 * square)
        u, v = x / stretch, y / stretch
    return u, v
