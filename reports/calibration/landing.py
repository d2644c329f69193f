"""Panel points that the rays of a camera reach through a lens sheet, by Snell's law for vectors.

The simulator of the calibration's photographs traces every ray with formulas of its own. It reads
the parameters of `inim.display` and uses neither the lens models of `inim.lens` nor the camera of
`inim.calibration`.

The display frame has x right, y up and z towards the viewer. A ray meets, in this order:

* spherical caps of radius f (n - 1), or cylinders along the array's columns, whose vertices are at
  z = 0 if the sheet is flat. The caps form one solid. Each lens of a bowed sheet is moved and
  tilted as a rigid body.
* the flat face at the thickness t behind the vertices
* a cover glass on the panel, optional
* the panel, a plane that tilts about the point behind the origin. The rotation has its axis in the
  sheet's plane. Pixels are counted in the panel's own plane, where their pitch holds.

The display's gap is the air-equivalent distance from the rear principal plane, t - t/n behind the
vertices, to the panel. A glass of thickness d and index m counts as d/m.

Rays are traced once for each position. Their panel points determine the photograph of any picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from inim.backend.kernels import compiled, share_rows
from inim.display import Display

#: Rays per camera pixel, two by two: each represents a quarter of the pixel.
SAMPLES = 4
#: Camera pixels around the sensor whose rays are traced too; a moving camera shows them.
MARGIN_PX = 12
# Steps from a distorted point to the true one; each reduces the error to a quarter or less.
_UNDISTORT_STEPS = 12
# Smallest width of a ray's footprint on the panel, in panel pixels.
_MIN_FOOTPRINT = 0.1


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
    p1, p2 : float
        Tangential distortion (Brown, Photogrammetric Engineering 32, 444, 1966).
    """

    columns: int
    rows: int
    focal_length_px: float
    centre_x_px: float
    centre_y_px: float
    k1: float
    k2: float
    pupil_mm: float
    p1: float = 0.0
    p2: float = 0.0

    @property
    def lens(self) -> Distortion:
        """Focal length, centre and distortion for the kernels."""
        return Distortion(
            self.focal_length_px,
            self.centre_x_px,
            self.centre_y_px,
            self.k1,
            self.k2,
            self.p1,
            self.p2,
        )


class Distortion(NamedTuple):
    """Map from tangents to pixels; see `Camera`."""

    focal: float
    centre_x: float
    centre_y: float
    k1: float
    k2: float
    p1: float
    p2: float


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


def off_axis(angle: float, azimuth: float) -> np.ndarray:
    """Direction off the display's axis by an angle, towards an azimuth, radians."""
    sine = math.sin(angle)
    return np.array([sine * math.cos(azimuth), sine * math.sin(azimuth), math.cos(angle)])


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
    """Panel points of rays, (n,) each.

    Attributes
    ----------
    column, row :
        Panel coordinates in pixels, from its left and top edge.
    weight :
        Share of the light that passes all faces; 0 if the ray does not reach the panel.
    """

    column: np.ndarray
    row: np.ndarray
    weight: np.ndarray


class CameraRays(NamedTuple):
    """Rays of a camera and their panel points.

    Attributes
    ----------
    landing : Landing
        Arrays of (2 (rows + 2 MARGIN_PX), 2 (columns + 2 MARGIN_PX)) float32, one ray per quarter
        of a pixel.
    tangent_x, tangent_y : array
        Undistorted directions of the quarters' centres, shaped like the landing.
    footprint : float
        Width of the panel area that a ray represents, in panel pixels.
    """

    landing: Landing
    tangent_x: np.ndarray
    tangent_y: np.ndarray
    footprint: float


@dataclass(frozen=True)
class Assembly:
    """Cover glass and bow of a lens sheet on a panel, absent from its design.

    Attributes
    ----------
    glass_mm, glass_index : float
        Thickness and refractive index of a glass on the panel.
    bow_mm : (float, float, float)
        Coefficients a, b, c of the height a (X^2 - 1/3) + b (Y^2 - 1/3) + c X Y of the sheet. X
        and Y are -1 .. 1 over the array. The mean height and the mean slopes are 0.
    """

    glass_mm: float = 0.0
    glass_index: float = 1.52
    bow_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)


class _Optics(NamedTuple):
    """Lengths (mm), indices and directions of the sheet and the panel for the kernels."""

    pitch_x: float
    pitch_y: float
    columns: float
    rows: float
    shift_x: float
    shift_y: float
    cosine: float
    sine: float
    radius: float
    thickness: float
    refractive_index: float
    bow_xx: float
    bow_yy: float
    bow_xy: float
    max_bow: float
    foot: float
    panel_z: float
    normal_x: float
    normal_y: float
    normal_z: float
    glass: float
    glass_index: float
    pixel: float
    panel_columns: float
    panel_rows: float
    along: float  #: 1: the faces are spheres; 0: cylinders, whose heights do not count.


class Sheet:
    """Lens sheet on a panel, as photographed.

    Parameters
    ----------
    display : Display
        The display with its misalignment; square lattice or cylinders, circular sections that fill
        their cells, bulges to the viewer. Cylinders are not limited by the panel.
    assembly : Assembly, optional

    Raises
    ------
    ValueError
        Another kind of sheet, or no air between the sheet and the panel or its glass.
    """

    def __init__(self, display: Display, assembly: Assembly | None = None) -> None:
        assembly = assembly or Assembly()
        supported = {
            "lattice": "lenticular" if display.lattice == "lenticular" else "square",
            "aperture": "square",
            "fill_factor": 1.0,
            "curved_side": "viewer",
            "conic": 0.0,
            "asphere_a4": 0.0,
            "asphere_a6": 0.0,
            "abbe_number": None,
        }
        for name, value in supported.items():
            if getattr(display, name) != value:
                raise ValueError(
                    f"{name} = {getattr(display, name)!r}: only {value!r} is simulated"
                )
        self._display = display
        self._optics = _optics(display, assembly)
        reach = math.hypot(*display.eia_shape) * display.pixel_pitch_mm / 2
        tilt = math.hypot(self._optics.normal_x, self._optics.normal_y)
        glass_top = self._optics.panel_z + assembly.glass_mm
        air = -self._optics.thickness - self._optics.max_bow - glass_top - tilt * reach
        if air <= 0:
            raise ValueError(f"{air:.3g} mm of air between the sheet and the panel or its glass")

    def trace(self, camera: Camera, pose: Pose, seed: int) -> CameraRays:
        """Trace a ray through a random point of each quarter of a pixel and of the pupil.

        The quarters of a pixel take different quarters of the pupil's area, in random order.
        """
        shape = (2 * (camera.rows + 2 * MARGIN_PX), 2 * (camera.columns + 2 * MARGIN_PX))
        arrays = [np.zeros(shape, np.float32) for _ in range(5)]
        share_rows(
            _trace_camera,
            shape[0] // 2,
            self._optics,
            camera.lens,
            camera.pupil_mm / 2,
            np.ascontiguousarray(pose.turn, float),
            np.ascontiguousarray(pose.eye_mm, float),
            float(pose.focus_mm),
            np.uint64(seed),
            *arrays,
        )
        # Half the pupil, seen from the panel through the lenses.
        spread = camera.pupil_mm / 2 / pose.focus_mm * self._display.gap_mm
        footprint = min(max(spread / self._display.pixel_pitch_mm, _MIN_FOOTPRINT), 1.0)
        return CameraRays(Landing(*arrays[:3]), arrays[3], arrays[4], footprint)

    def land(
        self, x_mm: np.ndarray, y_mm: np.ndarray, slope_x: np.ndarray, slope_y: np.ndarray
    ) -> Landing:
        """Trace viewing rays that cross z = 0 at given points with given slopes.

        Parameters
        ----------
        x_mm, y_mm, slope_x, slope_y : (n,) arrays
            Slopes are sideways travel per millimetre away from the viewer.

        Returns
        -------
        Landing
            float64
        """
        rays = np.stack([np.asarray(a, float) for a in (x_mm, y_mm, slope_x, slope_y)])
        landing = np.zeros((3, rays.shape[1]))
        _trace_rays(self._optics, rays, landing)
        return Landing(*landing)


def _optics(display: Display, assembly: Assembly) -> _Optics:
    pitch_x, pitch_y = display.pitch_mm, display.row_pitch_mm
    thickness = display.pitch_mm if display.lens_thickness_mm is None else display.lens_thickness_mm
    index, glass_index = display.refractive_index, assembly.glass_index
    radius = display.focal_length_mm * (index - 1)
    angle = math.radians(display.rotation_deg)
    tilt = [math.tan(math.radians(d)) for d in (display.tilt_x_deg, display.tilt_y_deg)]
    length = math.sqrt(tilt[0] ** 2 + tilt[1] ** 2 + 1)
    rows, columns = display.eia_shape
    bow = assembly.bow_mm
    rear_principal = thickness / index - thickness
    lens_columns, lens_rows, along = display.lens_columns, display.lens_rows, 1.0
    if display.lattice == "lenticular":  # one row that is as high as the array is wide
        half = math.hypot(rows, columns) * display.pixel_pitch_mm
        lens_columns, lens_rows, pitch_y, along = (
            2 * math.ceil(half / pitch_x) + 1,
            1,
            4 * half,
            0.0,
        )
    return _Optics(
        pitch_x=float(pitch_x),
        pitch_y=float(pitch_y),
        columns=float(lens_columns),
        rows=float(lens_rows),
        shift_x=float(display.shift_x_mm),
        shift_y=float(display.shift_y_mm),
        cosine=math.cos(angle),
        sine=math.sin(angle),
        radius=radius,
        thickness=float(thickness),
        refractive_index=float(index),
        bow_xx=float(bow[0]),
        bow_yy=float(bow[1]),
        bow_xy=float(bow[2]),
        max_bow=float(sum(map(abs, bow))),
        foot=radius - math.sqrt(radius**2 - (pitch_x**2 + along * pitch_y**2) / 4),
        panel_z=rear_principal - display.gap_mm - assembly.glass_mm * (1 - 1 / glass_index),
        normal_x=tilt[0] / length,
        normal_y=tilt[1] / length,
        normal_z=1 / length,
        glass=float(assembly.glass_mm),
        glass_index=float(glass_index),
        pixel=float(display.pixel_pitch_mm),
        panel_columns=float(columns),
        panel_rows=float(rows),
        along=along,
    )


@compiled
def _refract(
    x: float, y: float, z: float, nx: float, ny: float, nz: float, ratio: float
) -> tuple[float, float, float, float]:
    """Refracted unit vector and Fresnel's transmittance for unpolarised light.

    The unit normal points against the ray; `ratio` is the index in front of the face over the
    index behind it. The transmittance is 0 under total reflection.
    """
    cos_in = -(x * nx + y * ny + z * nz)
    squared = 1.0 - ratio * ratio * (1.0 - cos_in * cos_in)
    if cos_in <= 0.0 or squared <= 0.0:
        return x, y, z, 0.0
    cos_out = math.sqrt(squared)
    along = ratio * cos_in - cos_out
    perpendicular = (ratio * cos_in - cos_out) / (ratio * cos_in + cos_out)
    parallel = (cos_in - ratio * cos_out) / (cos_in + ratio * cos_out)
    passed = 1.0 - (perpendicular * perpendicular + parallel * parallel) / 2.0
    return ratio * x + along * nx, ratio * y + along * ny, ratio * z + along * nz, passed


@compiled
def _to_frame(
    x: float, y: float, z: float, nx: float, ny: float, nz: float
) -> tuple[float, float, float]:
    """Components of a vector in the frame that the shortest rotation of z to a normal defines."""
    bend = (nx * x + ny * y) / (1.0 + nz)
    return x - nx * (bend + z), y - ny * (bend + z), nx * x + ny * y + nz * z


@compiled
def _from_frame(
    x: float, y: float, z: float, nx: float, ny: float, nz: float
) -> tuple[float, float, float]:
    """The inverse of `_to_frame`."""
    bend = (nx * x + ny * y) / (1.0 + nz)
    return x - nx * (bend - z), y - ny * (bend - z), nz * z - nx * x - ny * y


@compiled
def _lens_frame(
    optics: _Optics, column: float, row: float
) -> tuple[float, float, float, float, float, float]:
    """Vertex and unit axis of a lens in the frame of the array."""
    half_x, half_y = optics.columns * optics.pitch_x / 2, optics.rows * optics.pitch_y / 2
    x = (column + 0.5) * optics.pitch_x - half_x
    y = (row + 0.5) * optics.pitch_y - half_y
    u, v = x / half_x, y / half_y
    height = (
        optics.bow_xx * (u * u - 1 / 3) + optics.bow_yy * (v * v - 1 / 3) + optics.bow_xy * u * v
    )
    slope_x = (2 * optics.bow_xx * u + optics.bow_xy * v) / half_x
    slope_y = (2 * optics.bow_yy * v + optics.bow_xy * u) / half_y
    length = math.sqrt(slope_x * slope_x + slope_y * slope_y + 1)
    return x, y, height, -slope_x / length, -slope_y / length, 1 / length


@compiled
def _land(
    optics: _Optics, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> tuple[float, float, float]:
    """Panel column, panel row and weight of a ray of the display frame, above the sheet."""
    c, s = optics.cosine, optics.sine
    x, y = x - optics.shift_x, y - optics.shift_y
    x, y, dx, dy = c * x + s * y, c * y - s * x, c * dx + s * dy, c * dy - s * dx
    # The ray enters the solid of all caps where it first enters a cap of the cells on its way.
    top = (optics.max_bow - z) / dz
    bottom = (-optics.foot - optics.max_bow - z) / dz
    half_columns, half_rows = optics.columns / 2, optics.rows / 2
    first_column = math.floor((x + top * dx) / optics.pitch_x + half_columns)
    first_row = math.floor((y + top * dy) / optics.pitch_y + half_rows)
    last_column = math.floor((x + bottom * dx) / optics.pitch_x + half_columns)
    last_row = math.floor((y + bottom * dy) / optics.pitch_y + half_rows)
    shortest, lens_column, lens_row = math.inf, -1.0, -1.0
    for i in range(2):
        column = last_column if i else first_column
        if column < 0 or column >= optics.columns or (i and last_column == first_column):
            continue
        for j in range(2):
            row = last_row if j else first_row
            if row < 0 or row >= optics.rows or (j and last_row == first_row):
                continue
            vx, vy, vz, ax, ay, az = _lens_frame(optics, column, row)
            # From the centre of the sphere, at a radius behind the vertex, or the cylinder's axis.
            px = x - vx + optics.radius * ax
            py = optics.along * (y - vy + optics.radius * ay)
            pz = z - vz + optics.radius * az
            speed = dx * dx + optics.along * dy * dy + dz * dz
            approach = px * dx + py * dy + pz * dz
            squared = approach * approach - speed * (px * px + py * py + pz * pz - optics.radius**2)
            if squared > 0.0:
                path = (-approach - math.sqrt(squared)) / speed
                if path < shortest:
                    shortest, lens_column, lens_row = path, float(column), float(row)
    if lens_column < 0:
        return 0.0, 0.0, 0.0
    x, y, z = x + shortest * dx, y + shortest * dy, z + shortest * dz
    if abs(x) > half_columns * optics.pitch_x or abs(y) > half_rows * optics.pitch_y:
        return 0.0, 0.0, 0.0  # the mount around the lenses
    vx, vy, vz, ax, ay, az = _lens_frame(optics, lens_column, lens_row)
    x, y, z = _to_frame(x - vx, y - vy, z - vz, ax, ay, az)
    dx, dy, dz = _to_frame(dx, dy, dz, ax, ay, az)
    radius = optics.radius
    dx, dy, dz, weight = _refract(
        dx,
        dy,
        dz,
        x / radius,
        optics.along * y / radius,
        (z + radius) / radius,
        1.0 / optics.refractive_index,
    )
    path = (-optics.thickness - z) / dz
    x, y, z = x + path * dx, y + path * dy, -optics.thickness
    dx, dy, dz, passed = _refract(dx, dy, dz, 0.0, 0.0, 1.0, optics.refractive_index)
    weight *= passed
    if weight == 0.0:
        return 0.0, 0.0, 0.0
    x, y, z = _from_frame(x, y, z, ax, ay, az)
    dx, dy, dz = _from_frame(dx, dy, dz, ax, ay, az)
    x, y, z = x + vx, y + vy, z + vz
    x, y, dx, dy = c * x - s * y, s * x + c * y, c * dx - s * dy, s * dx + c * dy
    # From here on in the frame of the panel.
    nx, ny, nz = optics.normal_x, optics.normal_y, optics.normal_z
    x, y, z = _to_frame(x + optics.shift_x, y + optics.shift_y, z - optics.panel_z, nx, ny, nz)
    dx, dy, dz = _to_frame(dx, dy, dz, nx, ny, nz)
    if optics.glass > 0.0:
        path = (optics.glass - z) / dz
        x, y, z = x + path * dx, y + path * dy, optics.glass
        dx, dy, dz, passed = _refract(dx, dy, dz, 0.0, 0.0, 1.0, 1.0 / optics.glass_index)
        weight *= passed
    if dz >= 0.0:
        return 0.0, 0.0, 0.0
    x, y = x - z / dz * dx, y - z / dz * dy
    u = x / optics.pixel + optics.panel_columns / 2
    v = optics.panel_rows / 2 - y / optics.pixel
    if not (0.0 <= u < optics.panel_columns and 0.0 <= v < optics.panel_rows):
        return 0.0, 0.0, 0.0
    return u, v, weight


@compiled
def _trace_rays(optics: _Optics, rays: np.ndarray, landing: np.ndarray) -> None:
    start = optics.max_bow + optics.pitch_x
    for i in range(rays.shape[1]):
        x, y, slope_x, slope_y = rays[0, i], rays[1, i], rays[2, i], rays[3, i]
        length = math.sqrt(slope_x * slope_x + slope_y * slope_y + 1)
        landing[0, i], landing[1, i], landing[2, i] = _land(
            optics,
            x - start * slope_x,
            y - start * slope_y,
            start,
            slope_x / length,
            slope_y / length,
            -1 / length,
        )


@compiled
def _mix(state: Any) -> Any:
    """Next state of a random sequence (splitmix64; Steele et al., OOPSLA 2014)."""
    state = np.uint64(state + np.uint64(0x9E3779B97F4A7C15))
    bits = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))


@compiled
def _unit(bits: Any) -> Any:
    """Number in [0, 1) from random bits."""
    return (bits >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@compiled
def distort(lens: Distortion, x: float, y: float) -> tuple[float, float]:
    """Pixel coordinates of undistorted tangents."""
    square = x * x + y * y
    radial = 1.0 + square * (lens.k1 + lens.k2 * square)
    u = x * radial + 2.0 * lens.p1 * x * y + lens.p2 * (square + 2.0 * x * x)
    v = y * radial + lens.p1 * (square + 2.0 * y * y) + 2.0 * lens.p2 * x * y
    return lens.focal * u + lens.centre_x, lens.focal * v + lens.centre_y


@compiled
def undistort(lens: Distortion, pixel_x: float, pixel_y: float) -> tuple[float, float]:
    """Tangents whose distorted point has these pixel coordinates."""
    target_x = (pixel_x - lens.centre_x) / lens.focal
    target_y = (pixel_y - lens.centre_y) / lens.focal
    x, y = target_x, target_y
    for _ in range(_UNDISTORT_STEPS):
        u, v = distort(lens, x, y)
        x += (pixel_x - u) / lens.focal
        y += (pixel_y - v) / lens.focal
    return x, y


@compiled
def _trace_camera(
    begin: int,
    end: int,
    optics: _Optics,
    lens: Distortion,
    pupil_radius: float,
    turn: np.ndarray,
    eye: np.ndarray,
    focus: float,
    seed: int,
    columns: np.ndarray,
    rows: np.ndarray,
    weights: np.ndarray,
    tangents_x: np.ndarray,
    tangents_y: np.ndarray,
) -> None:
    """Trace the rays of some rows of camera pixels, counted with the margin."""
    start = optics.max_bow + optics.pitch_x
    pixels = columns.shape[1] // 2
    for pixel_row in range(begin, end):
        for pixel_column in range(pixels):
            bits = _mix(
                np.uint64(seed) * np.uint64(0x2545F4914F6CDD1D)
                + np.uint64(pixel_row * pixels + pixel_column)
            )
            order = int(bits & np.uint64(3))
            for quarter in range(4):
                i, j = 2 * pixel_row + quarter // 2, 2 * pixel_column + quarter % 2
                tangent_x, tangent_y = undistort(
                    lens, (j + 0.5) / 2 - MARGIN_PX, (i + 0.5) / 2 - MARGIN_PX
                )
                tangents_x[i, j], tangents_y[i, j] = tangent_x, tangent_y
                bits = _mix(bits)
                tangent_x += (_unit(bits) - 0.5) / (2 * lens.focal)
                bits = _mix(bits)
                tangent_y += (_unit(bits) - 0.5) / (2 * lens.focal)
                part = quarter ^ order
                bits = _mix(bits)
                radius = pupil_radius * math.sqrt((part // 2 + _unit(bits)) / 2)
                bits = _mix(bits)
                angle = math.pi * (part % 2 + _unit(bits))
                pupil_x, pupil_y = radius * math.cos(angle), radius * math.sin(angle)
                ax, ay, az = focus * tangent_x - pupil_x, focus * tangent_y - pupil_y, focus
                length = math.sqrt(ax * ax + ay * ay + az * az)
                ax, ay, az = ax / length, ay / length, az / length
                dx = turn[0, 0] * ax + turn[1, 0] * ay + turn[2, 0] * az
                dy = turn[0, 1] * ax + turn[1, 1] * ay + turn[2, 1] * az
                dz = turn[0, 2] * ax + turn[1, 2] * ay + turn[2, 2] * az
                if dz >= 0.0:
                    continue
                x = eye[0] + turn[0, 0] * pupil_x + turn[1, 0] * pupil_y
                y = eye[1] + turn[0, 1] * pupil_x + turn[1, 1] * pupil_y
                z = eye[2] + turn[0, 2] * pupil_x + turn[1, 2] * pupil_y
                path = (start - z) / dz
                columns[i, j], rows[i, j], weights[i, j] = _land(
                    optics, x + path * dx, y + path * dy, start, dx, dy, dz
                )
