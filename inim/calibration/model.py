"""Model of the observations: a display, a camera and its poses, with residuals.

There are two kinds of residuals. A pixel well inside a lens sees a point of the panel: its ray,
refracted by the lens, ends at a distance from that point. A lens's outline has an observed centre,
and the projected outline of its cell has another. The first kind hardly depends on the ray's
position in the lens, because a lens with g near f makes all its rays parallel. The second kind
determines it.

A camera pixel shows the mean over its blur. Within an aberrated lens this mean is nearer
to the lens's axis than the ray of the pixel's centre, as if the lens magnified a few tenths
of a per cent less. `Observations.without_blur` corrects the observations for this.

Seams between lens surfaces are below z = 0, by the sag of the curved face there. Behind a flat face
they are t - sag deep in the glass. By Snell's law a depth d seen at a slope s appears as d /
sqrt(n^2 (1 + s^2) - s^2), which is d / n on the axis.

The camera is a pinhole with radial and tangential distortion, OpenCV's model. Its frame has x to
the right, y down and z away from the camera. Pixel centres are at half-integers: OpenCV's principal
point is half a pixel less. Refocusing changes the focal length from position to position, and a
rolling shutter skews and stretches a photograph.

A real sheet deviates from the design in its refractive index and thickness, in the glass over the
panel, and in a bow, which is a smooth map of the gap (Hwang and Chang, Optics Express 25, 19817,
2017, fit such maps). `Deviations` has these. They are fitted, too, with priors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from inim.calibration.lattice import Lenses
from inim.display import Display
from inim.lens import lens_model
from inim.lens.array import (
    NUMPY_OPS,
    LensArray,
    LensTraits,
    lens_array,
    lens_traits,
    to_array,
    to_panel,
)
from inim.lens.model import sag
from inim.lens.thick import curved_face

# Fixed-point steps of a distortion's inverse; distortions of photographs are small.
_UNDISTORT_STEPS = 8


class Intrinsics(NamedTuple):
    """Intrinsics, in pixels, and OpenCV's distortion of the tangents: radial ``1 + k1 r^2 + k2
    r^4``, tangential p1 and p2.
    """

    focal_px: float
    centre_x_px: float
    centre_y_px: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0


class Deviations(NamedTuple):
    """Deviations of a sheet from its design that are not reported."""

    refractive_index: float = 0.0  #: Added to the index, with unchanged focal length.
    thickness: float = 0.0  #: Added to the thickness, as a share.
    glass_mm: float = 0.0  #: Glass over the panel, within the unchanged gap in air.
    #: Gap at the array's left and right edge, upper and lower edge, and corners, less that in the
    #: middle.
    bow_x_mm: float = 0.0
    bow_y_mm: float = 0.0
    bow_xy_mm: float = 0.0


_NONE = Deviations()


class Pose(NamedTuple):
    """Pose of a camera: display frame to camera frame is ``turn @ (point - eye_mm)``."""

    turn: np.ndarray
    eye_mm: np.ndarray
    zoom: float = 0.0  #: Focal length, relative to the camera's, minus 1.
    skew: float = 0.0  #: Pixels to the right per pixel down.
    stretch: float = 0.0  #: Pixels down per pixel down, minus 1.

    @property
    def image_map(self) -> np.ndarray:
        """Linear map of the photograph about the principal point, (2, 2)."""
        scale = 1 + self.zoom
        return np.array([[scale, self.skew], [0.0, scale + self.stretch]])


def rotation(vector: Any) -> np.ndarray:
    """Rotation matrix of an axis times its angle, radians."""
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def _distort(camera: Intrinsics, tangents: np.ndarray) -> np.ndarray:
    x, y = np.moveaxis(tangents, -1, 0)
    square = x * x + y * y
    radial = 1 + square * (camera.k1 + camera.k2 * square)
    p1, p2 = camera.p1, camera.p2
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
            y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )


def directions(camera: Intrinsics, pixels: np.ndarray) -> np.ndarray:
    """Tangents x / z and y / z of the rays of pixels, (..., 2)."""
    distorted = (pixels - [camera.centre_x_px, camera.centre_y_px]) / camera.focal_px
    tangents: np.ndarray = distorted
    for _ in range(_UNDISTORT_STEPS):
        tangents = tangents + distorted - _distort(camera, tangents)
    return tangents


def project(camera: Intrinsics, pose: Pose, points_mm: np.ndarray) -> np.ndarray:
    """Pixels of points of the display frame, (..., 3) to (..., 2)."""
    camera_mm = (points_mm - pose.eye_mm) @ pose.turn.T
    distorted = _distort(camera, camera_mm[..., :2] / camera_mm[..., 2:])
    from_centre = camera.focal_px * distorted @ pose.image_map.T
    pixels: np.ndarray = from_centre + np.array([camera.centre_x_px, camera.centre_y_px])
    return pixels


def rays(camera: Intrinsics, pose: Pose, pixels: np.ndarray) -> np.ndarray:
    """Rays of pixels as the lens models take them: x, y at z = 0 and slopes, (4, ...).

    Slopes are sideways travel per millimetre away from the viewer.
    """
    centre = np.array([camera.centre_x_px, camera.centre_y_px])
    tangents = directions(camera, centre + (pixels - centre) @ np.linalg.inv(pose.image_map).T)
    along = tangents @ pose.turn[:2] + pose.turn[2]  # display frame
    slope_x, slope_y = along[..., 0] / -along[..., 2], along[..., 1] / -along[..., 2]
    x, y, z = pose.eye_mm
    return np.stack([x + z * slope_x, y + z * slope_y, slope_x, slope_y])


#: Of the display, in the order in which they are fitted.
PARAMETERS = (
    "pitch_mm",
    "rotation_deg",
    "shift_x_mm",
    "shift_y_mm",
    "gap_mm",
    "tilt_x_deg",
    "tilt_y_deg",
    "focal_length_mm",
)
#: All that is the same for all positions.
SHARED = (*PARAMETERS, *Intrinsics._fields, *Deviations._fields)
#: What each position has: a turn and an eye, and its changes of the photograph.
CHANGES = Pose._fields[2:]
POSE = 6 + len(CHANGES)
#: Sizes of a change that shows, for the steps of differences and of the search; a pose's are its
#: turn in radians and its eye in millimetres.
STEPS = dict(zip(PARAMETERS, (0.01, 0.2, 0.1, 0.1, 0.1, 0.2, 0.2, 0.1), strict=True)) | {
    "focal_px": 100.0,
    "centre_x_px": 20.0,
    "centre_y_px": 20.0,
    "k1": 0.1,
    "k2": 0.5,
    "p1": 0.01,
    "p2": 0.01,
    "refractive_index": 0.1,
    "thickness": 0.2,
    "glass_mm": 1.0,
    "bow_x_mm": 0.1,
    "bow_y_mm": 0.1,
    "bow_xy_mm": 0.1,
}
_POSE_STEPS = (0.01, 0.01, 0.01, 10.0, 10.0, 10.0, 0.01, 0.01, 0.01)
# Differences are taken over this share of a step.
_DIFFERENCE = 1e-4
# A mean over a blur is, to the third order, that of these places about its centre: for a variance
# of 1 pixel^2 along each axis.
_AROUND = np.sqrt(2) * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
# Index of glass over a panel.
_GLASS_INDEX = 1.52
# What is seen of a lens ends so far from its seams, where pixels see two: without its corners.
_SEAM_PX = 0.4
# Of the integral along a side of a cell.
_NODES = 6
_MODEL = "thick"
# How far off the model is, in the units of `Observations.imperfections`: standard deviations, 2 µm
# in 1 mm, 2 µm, and 2 µm in 1 mm, of simulated photographs by cameras of different blur
# (`reports/calibration`).
_IMPERFECT = (0.002, 0.02, 0.002)
# Standard deviation of a blur's variance, square pixels: for a usual camera, and as a share of the
# difference from it. Sharpened or unsharp photographs have responses of other shapes.
_BLUR_ERROR_PX2, _USUAL_BLUR_PX2, _UNUSUAL_SHARE = 0.08, 0.4, 0.4
# Lenses of a position that is not photographed yet, across and down, and its rays from their
# centres, in pitches. Of the lenses, it must see this share.
_LENSES, _LEAST_SEEN = 24, 1 / 8
_OFF_CENTRE = 0.25 * np.array([(x, y) for x in (-1, 1) for y in (-1, 1)])


class Guess(NamedTuple):
    """Values of all unknown parameters, with one pose for each position."""

    display: Display
    camera: Intrinsics
    poses: tuple[Pose, ...]
    deviations: Deviations = _NONE

    def with_changes(self, by: np.ndarray) -> Guess:
        """Guess with changes to `SHARED`, followed by the rotation and eye of each pose."""
        changed = {
            name: getattr(self.display, name) + float(step)
            for name, step in zip(PARAMETERS, by, strict=False)
            if step
        }
        if "pitch_mm" in changed and self.display.pitch_y_mm is not None:
            ratio = changed["pitch_mm"] / self.display.pitch_mm
            changed["pitch_y_mm"] = self.display.pitch_y_mm * ratio
        if "gap_mm" in changed and self.display.layout.of_cylinders:  # they focus on the panel
            ratio = changed["gap_mm"] / self.display.gap_mm
            changed["focal_length_mm"] = self.display.focal_length_mm * ratio
        of_camera, of_sheet = np.split(by[len(PARAMETERS) : len(SHARED)], [len(Intrinsics._fields)])
        return Guess(
            self.display.replace(**changed) if changed else self.display,
            Intrinsics(*np.add(self.camera, of_camera).tolist()),
            tuple(
                Pose(
                    rotation(change[:3]) @ pose.turn,
                    pose.eye_mm + change[3:6],
                    *np.add(pose[2:], change[6:]).tolist(),
                )
                for pose, change in zip(
                    self.poses, by[len(SHARED) :].reshape(-1, POSE), strict=True
                )
            ),
            Deviations(*np.add(self.deviations, of_sheet).tolist()),
        )

    @property
    def sheet(self) -> Display:
        """Display with the deviations that `Display` has."""
        array = lens_array(self.display)
        return self.display.replace(
            refractive_index=self.display.refractive_index + self.deviations.refractive_index,
            lens_thickness_mm=array.thickness * (1 + self.deviations.thickness),
        )

    @property
    def steps(self) -> np.ndarray:
        """`STEPS` in the order of `with_changes`."""
        return np.array([*STEPS.values(), *_POSE_STEPS * len(self.poses)])


def panel_mm(display: Display, panel_px: np.ndarray) -> np.ndarray:
    """Points of the display frame of panel columns and rows, (..., 2)."""
    rows, columns = display.eia_shape
    centred = (panel_px - [columns / 2, rows / 2]) * [1.0, -1.0]
    points: np.ndarray = centred * display.pixel_pitch_mm
    return points


def first_lens_mm(display: Display) -> np.ndarray:
    """Centre of the array's top left lens, (2,), array frame."""
    return _lens_centres(lens_array(display), np.zeros(2))


def _lens_centres(array: LensArray, index: np.ndarray) -> np.ndarray:
    """Centres of lenses given by column and row from the top left, (..., 2), array frame."""
    x = (index[..., 0] + 0.5 - array.half_columns) * array.pitch_x
    y = (array.half_rows - 0.5 - index[..., 1]) * array.pitch_y
    return np.stack([x, y], axis=-1)


def bow_mm(array: LensArray, deviations: Deviations, x: np.ndarray, y: np.ndarray) -> Any:
    """Height of the sheet above the plane through its middle, mm; array frame."""
    x = x / (array.half_columns * array.pitch_x)
    y = y / (array.half_rows * array.pitch_y)
    return deviations.bow_x_mm * x * x + deviations.bow_y_mm * y * y + deviations.bow_xy_mm * x * y


def farther_in_glass(slope_x: np.ndarray, slope_y: np.ndarray) -> np.ndarray:
    """Additional displacement of a ray in glass over air of the same optical thickness.

    Per millimetre of glass and unit of the slopes, which are those in air; below 0.
    """
    square = slope_x**2 + slope_y**2
    share: np.ndarray = 1 / np.sqrt(_GLASS_INDEX**2 * (1 + square) - square) - 1 / _GLASS_INDEX
    return share


def panel_points(
    display: Display, index: np.ndarray, arriving: np.ndarray, deviations: Deviations = _NONE
) -> np.ndarray:
    """Panel points reached by rays through given lenses.

    * `display`: for deviations, `Guess.sheet`.
    * `index`, (n, 2) int: the lenses, column and row.
    * `arriving`, (4, n): see `inim.calibration.model.rays`.

    Returns (n, 2) array, display frame, mm.
    """
    array, traits = lens_array(display), lens_traits(display)
    x, y, sx, sy = to_array(array, traits, *arriving)
    centre = _lens_centres(array, index)
    centre_x, centre_y = centre.T
    height = bow_mm(array, deviations, *centre.T)
    x, y = x - height * sx, y - height * sy
    # One lens about its own axis, in a cell so wide that none of its rays is a neighbour's.
    alone = array._replace(
        pitch_x=2 * array.pitch_x, pitch_y=2 * array.pitch_y, half_columns=0.5, half_rows=0.5,
        gap=array.gap + height,
    )  # fmt: skip
    trace = lens_model(_MODEL).function
    with np.errstate(invalid="ignore"):
        ray = trace(
            alone, traits, NUMPY_OPS, x - centre_x, y - centre_y, sx, sy, display.refractive_index
        )
        farther = deviations.glass_mm * farther_in_glass(ray.sx, ray.sy)
    ray = ray._replace(x=ray.x + centre_x + farther * ray.sx, y=ray.y + centre_y + farther * ray.sy)
    panel_x, panel_y, _ = to_panel(array, traits, ray)
    return np.stack([panel_x, panel_y], axis=-1)


def centres(
    display: Display,
    camera: Intrinsics,
    pose: Pose,
    index: np.ndarray,
    deviations: Deviations = _NONE,
    deeper_mm: float = 0.0,
) -> np.ndarray:
    """Centres of gravity of lens outlines in a photograph, (n, 2) pixels, including deeper seams.

    A side of an outline moves with its mean depth: the whole outline moves as its centre does at
    that depth. The additional perspective over a lens, P^2 s / 12 V for a slope s, is below a ten-
    thousandth of it.
    """
    array, traits = lens_array(display), lens_traits(display)
    at = _vertices(array, index)
    lens_px = camera.focal_px * array.pitch_x / float(np.linalg.norm(pose.eye_mm))
    depth = _seam_depth(array, traits, 1 - 2 * _SEAM_PX / lens_px)
    height = np.full(len(at), -depth)
    if not traits.bulges_to_viewer:  # depths are negative: the seams rise from the vertices
        slope = ((at - pose.eye_mm[:2]) ** 2).sum(axis=-1) / pose.eye_mm[2] ** 2
        steeper = np.sqrt(array.design_index**2 * (1 + slope) - slope)
        height = array.thickness / array.design_index - (array.thickness + depth) / steeper
    height = height + bow_mm(array, deviations, *_lens_centres(array, index).T)
    return project(camera, pose, np.column_stack([at, height - deeper_mm]))


def _vertices(array: LensArray, index: np.ndarray) -> np.ndarray:
    """Vertices of lenses, (n, 2), display frame."""
    c, s = array.cosine, array.sine
    shift = np.array([array.shift_x, array.shift_y])
    vertices: np.ndarray = _lens_centres(array, index) @ [[c, s], [-s, c]] + shift
    return vertices


def _seam_depth(array: LensArray, traits: LensTraits, share: float) -> float:
    """Mean sag along the sides of a lens's cell, which is next to square; along a share of each."""
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    node = share * node
    half_x, half_y = array.pitch_x / 2, array.pitch_y / 2
    squares = [half_x**2 + (node * half_y) ** 2, half_y**2 + (node * half_x) ** 2]
    depth = sag(NUMPY_OPS, curved_face(array, traits), np.stack(squares))
    return float((depth @ weight).mean() / 2)


class Kind(NamedTuple):
    """Kind of residuals."""

    title: str  #: Title of its maps.
    axes: tuple[str, ...]  #: Names of its components.
    unit: str  #: Unit in reports.
    scale: float  #: Residuals times this are in that unit.
    usual: float  #: Typical size at the start; rays: panel pixels.
    least: float  #: Typical size without noise; rays: panel pixels.
    least_misfit: float  #: Least root mean square of a low-order component.
    #: The model fails above this root mean square of a low-order component; rays: panel pixels.
    most_smooth: float


class Residuals(ABC):
    """Observations in the photographs, by position, as residuals of two kinds.

    The first kind is that of rays, on the panel, mm.
    """

    kinds: ClassVar[tuple[Kind, Kind]]
    #: Rays of the first kind that share their panel pixels.
    rays_at_a_place: ClassVar[int] = 1
    #: Residuals of a whole column, or row, have a common error: panel pixels beat with lenses.
    is_striped: ClassVar[bool] = True

    @property
    @abstractmethod
    def places(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Column and row on `grid` of each observation of both kinds, (n, 2) int, by position."""

    @abstractmethod
    def grid(self, guess: Guess) -> tuple[int, int]:
        """Columns and rows over which residuals may vary smoothly."""

    @abstractmethod
    def residuals(self, guess: Guess) -> list[tuple[np.ndarray, np.ndarray]]:
        """Residuals of both kinds, (n, components), by position."""

    @abstractmethod
    def imperfections(self, guess: Guess) -> np.ndarray:
        """Change of `flat` by deviations that are not fitted, one unit each, (deviations, all)."""

    @property
    @abstractmethod
    def imperfection_sizes(self) -> np.ndarray:
        """Standard deviations of `imperfections`, in their units."""

    @abstractmethod
    def seen_from(self, guess: Guess, shape: tuple[int, int]) -> Residuals | None:
        """Observations that the only pose of a guess would add; None if it sees too little.

        * `shape`: height and width of its photographs.
        """

    @property
    def counts(self) -> np.ndarray:
        """Numbers of residuals of each position and kind, (positions, 2) int."""
        components = [len(kind.axes) for kind in self.kinds]
        return np.array([[len(a), len(b)] for a, b in self.places]) * components

    def flat(self, guess: Guess) -> np.ndarray:
        """The residuals in one row: position by position, rays first."""
        parts = [part.ravel() for pair in self.residuals(guess) for part in pair]
        return np.concatenate(parts)

    def slopes(self, guess: Guess, by: np.ndarray, free: np.ndarray) -> np.ndarray:
        """Derivatives of `flat` by the changes of `Guess.with_changes` that are free, a row each.

        Positions do not share residuals: one difference serves all of them.
        """
        steps = guess.steps * _DIFFERENCE
        at = self.flat(guess.with_changes(by))
        ends = np.cumsum([0, *self.counts.sum(axis=1)])
        slopes = np.zeros((steps.size, at.size))
        for n in np.flatnonzero(free[: len(SHARED)]).tolist():
            more = by.copy()
            more[n] += steps[n]
            slopes[n] = (self.flat(guess.with_changes(more)) - at) / steps[n]
        for n in range(POSE):
            of_poses = np.arange(len(SHARED) + n, steps.size, POSE)
            more = by.copy()
            more[of_poses] += steps[of_poses]
            change = (self.flat(guess.with_changes(more)) - at) / steps[of_poses[0]]
            for row, begin, end in zip(of_poses, ends, ends[1:], strict=False):
                slopes[row, begin:end] = change[begin:end]
        chosen: np.ndarray = slopes[free]
        return chosen


@dataclass(frozen=True)
class Observations(Residuals):
    """Observations of lenses that are seen one by one."""

    kinds = (
        Kind("panel", ("across", "up"), "µm", 1e3, 0.3, 0.1, 0.0004, 0.03),
        Kind("outline", ("across", "down"), "px", 1.0, 0.2, 0.1, 0.015, 0.05),
    )
    rays_at_a_place = len(_OFF_CENTRE)

    #: (rays, 2) int each: the lens that a ray goes through, column and row of the array.
    lens: tuple[np.ndarray, ...]
    #: (rays, 2) float each: its pixel; where on the panel it was found to end, mm, display frame.
    pixel: tuple[np.ndarray, ...]
    panel: tuple[np.ndarray, ...]
    outlined: tuple[np.ndarray, ...]  #: (lenses, 2) int each: lenses whose outline is seen.
    centre: tuple[np.ndarray, ...]  #: (lenses, 2) float each: the pixels around which it is.
    blur_px2: tuple[float, ...]  #: Variance of the blur.
    square_px2: tuple[float, ...]  #: Variance of the squares that the rays are means of.

    @classmethod
    def of(
        cls, lenses: Sequence[Lenses], display: Display, *, outlines_only: bool = False
    ) -> Observations:
        """Observations of lenses counted from the array's top left."""
        observed = []
        for position in lenses:
            inside = np.isfinite(position.panel_px).all(axis=-1) & (not outlines_only)
            index = np.broadcast_to(position.index[:, None], position.panel_px.shape)[inside]
            observed.append(
                (
                    index,
                    position.pixel[inside],
                    panel_mm(display, position.panel_px[inside]),
                    position.index[position.is_whole],
                    position.centre_px[position.is_whole],
                    position.blur_px2,
                    position.square_px2,
                )
            )
        return cls(*zip(*observed, strict=True))

    def blurs(self, guess: Guess) -> list[np.ndarray]:
        """Displacement of panel points by a blur with a variance of 1 pixel^2, (rays, 2) mm each.

        It hardly depends on the guess.
        """
        sheet, displacements = guess.sheet, []
        for lens, pixel, pose in zip(self.lens, self.pixel, guess.poses, strict=True):
            places = np.concatenate([pixel, *(pixel + off for off in _AROUND)])
            all_lenses = np.tile(lens, (1 + len(_AROUND), 1))
            landed = panel_points(
                sheet, all_lenses, rays(guess.camera, pose, places), guess.deviations
            )
            through_centre, *others = np.split(landed, 1 + len(_AROUND))
            displacements.append(np.mean(others, axis=0) - through_centre)
        return displacements

    def without_blur(self, guess: Guess) -> Observations:
        """Observations corrected to those of a camera without blur."""
        panel = tuple(
            panel_mm - (blur_px2 + square_px2) * displacement
            for panel_mm, blur_px2, square_px2, displacement in zip(
                self.panel, self.blur_px2, self.square_px2, self.blurs(guess), strict=True
            )
        )
        return replace(self, panel=panel)

    @property
    def places(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """See `Residuals.places`: lenses of rays, and outlined lenses."""
        return list(zip(self.lens, self.outlined, strict=True))

    def grid(self, guess: Guess) -> tuple[int, int]:
        """See `Residuals.grid`: the lenses."""
        return guess.display.lens_columns, guess.display.lens_rows

    def residuals(self, guess: Guess) -> list[tuple[np.ndarray, np.ndarray]]:
        """Residuals by position: of rays, (n, 2) mm on the panel; of outlines, (m, 2) pixels."""
        sheet, camera, poses, deviations = guess.sheet, *guess[1:]
        arriving = [
            rays(camera, p, px).reshape(4, -1) for p, px in zip(poses, self.pixel, strict=True)
        ]
        landed = panel_points(
            sheet, np.concatenate(self.lens), np.concatenate(arriving, axis=1), deviations
        )
        ends = np.cumsum([len(lens) for lens in self.lens])[:-1]
        return [
            (ray_mm - panel_mm, centres(sheet, camera, pose, outlined, deviations) - centre)
            for ray_mm, panel_mm, pose, outlined, centre in zip(
                np.split(landed, ends), self.panel, poses, self.outlined, self.centre, strict=True
            )
        ]

    def imperfections(self, guess: Guess) -> np.ndarray:
        """Change of `flat` by typical deviations that are not fitted, (3 + positions, all).

        If a lens magnified by one panel millimetre in a millimetre more; if seams were a tenth of a
        millimetre deeper; if rays ended farther from the lens's centre, by a millimetre in a
        millimetre at a distance of half a pitch and in proportion to its cube; if the variance of a
        position's blur were one square pixel smaller.
        """
        sheet, camera, poses, deviations = guess.sheet, *guess[1:]
        array, parts = lens_array(sheet), []
        blurs = self.blurs(guess)
        for n, (lens, pixel, pose, outlined) in enumerate(
            zip(self.lens, self.pixel, poses, self.outlined, strict=True)
        ):
            x, y, *_ = rays(camera, pose, pixel)
            from_centre = np.column_stack([x, y]) - _vertices(array, lens)
            square = (from_centre**2).sum(axis=-1, keepdims=True) / (array.pitch_x / 2) ** 2
            within, cubic = from_centre.ravel(), (from_centre * square).ravel()
            flat, deep = (
                centres(sheet, camera, pose, outlined, deviations, by) for by in (0.0, 0.1)
            )
            own, zeros = np.eye(len(poses))[n][:, None], np.zeros(flat.size)
            parts += [
                np.concatenate([[within, 0 * within, cubic], own * blurs[n].ravel()]),
                np.concatenate([[zeros, (deep - flat).ravel(), zeros], own * zeros]),
            ]
        return np.concatenate(parts, axis=1)

    @property
    def imperfection_sizes(self) -> np.ndarray:
        """See `Residuals.imperfection_sizes`."""
        unusual = np.abs(np.array(self.blur_px2) - _USUAL_BLUR_PX2)
        return np.array([*_IMPERFECT, *(_BLUR_ERROR_PX2 + _UNUSUAL_SHARE * unusual)])

    def seen_from(self, guess: Guess, shape: tuple[int, int]) -> Observations | None:
        """See `Residuals.seen_from`."""
        display, camera, (pose,), _ = guess
        column, row = np.meshgrid(
            *(
                np.unique(np.linspace(0, n - 1, _LENSES).astype(int))
                for n in display.layout.grid[::-1]
            )
        )
        index = np.stack([column.ravel(), row.ravel()], axis=-1)
        centre = centres(display, camera, pose, index)
        inside = ((centre > 0) & (centre < shape[::-1])).all(axis=-1)
        if inside.mean() < _LEAST_SEEN:
            return None
        index, centre = index[inside], centre[inside]
        lens_px = camera.focal_px * display.pitch_mm / pose.eye_mm[2]
        lens_of_ray = np.repeat(index, len(_OFF_CENTRE), axis=0)
        pixel = (centre[:, None] + lens_px * _OFF_CENTRE).reshape(-1, 2)
        zeros = np.zeros_like(pixel)
        return Observations((lens_of_ray,), (pixel,), (zeros,), (index,), (centre,), (0.0,), (0.0,))
