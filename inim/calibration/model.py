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

The camera is a pinhole with radial distortion, OpenCV's model. Its frame has x to the right, y down
and z away from the camera. Pixel centres are at half-integers: OpenCV's principal point is half a
pixel less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

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

# Newton's method on a radius; distortions of photographs are small.
_NEWTON_STEPS = 4


class Intrinsics(NamedTuple):
    """Intrinsics, in pixels; radial distortion ``1 + k1 r^2 + k2 r^4`` of the radius r = tan."""

    focal_px: float
    centre_x_px: float
    centre_y_px: float
    k1: float = 0.0
    k2: float = 0.0


class Pose(NamedTuple):
    """Pose of a camera: display frame to camera frame is ``turn @ (point - eye_mm)``."""

    turn: np.ndarray
    eye_mm: np.ndarray


def rotation(vector: Any) -> np.ndarray:
    """Rotation matrix of an axis times its angle, radians."""
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def directions(camera: Intrinsics, pixels: np.ndarray) -> np.ndarray:
    """Tangents x / z and y / z of the rays of pixels, (..., 2)."""
    distorted = (pixels - [camera.centre_x_px, camera.centre_y_px]) / camera.focal_px
    distorted_radius = np.sqrt((distorted**2).sum(axis=-1))
    radius = distorted_radius
    for _ in range(_NEWTON_STEPS):
        square = radius * radius
        value = radius * (1 + square * (camera.k1 + camera.k2 * square))
        slope = 1 + square * (3 * camera.k1 + 5 * camera.k2 * square)
        radius = radius - (value - distorted_radius) / slope
    scale = np.divide(
        radius, distorted_radius, out=np.ones_like(distorted_radius), where=distorted_radius > 0
    )
    tangents: np.ndarray = distorted * scale[..., None]
    return tangents


def project(camera: Intrinsics, pose: Pose, points_mm: np.ndarray) -> np.ndarray:
    """Pixels of points of the display frame, (..., 3) to (..., 2)."""
    camera_mm = (points_mm - pose.eye_mm) @ pose.turn.T
    tangents = camera_mm[..., :2] / camera_mm[..., 2:]
    square = (tangents**2).sum(axis=-1, keepdims=True)
    distorted = tangents * (1 + square * (camera.k1 + camera.k2 * square))
    pixels: np.ndarray = distorted * camera.focal_px + [camera.centre_x_px, camera.centre_y_px]
    return pixels


def rays(camera: Intrinsics, pose: Pose, pixels: np.ndarray) -> np.ndarray:
    """Rays of pixels as the lens models take them: x, y at z = 0 and slopes, (4, ...).

    Slopes are sideways travel per millimetre away from the viewer.
    """
    tangents = directions(camera, pixels)
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
SHARED = (*PARAMETERS, *Intrinsics._fields)
_POSE = 6
#: Sizes of a change that shows, for the steps of differences and of the search; a pose's are its
#: turn in radians and its eye in millimetres.
STEPS = dict(zip(PARAMETERS, (0.01, 0.2, 0.1, 0.1, 0.1, 0.2, 0.2, 0.1), strict=True)) | {
    "focal_px": 100.0,
    "centre_x_px": 20.0,
    "centre_y_px": 20.0,
    "k1": 0.1,
    "k2": 0.5,
}
_POSE_STEPS = (0.01, 0.01, 0.01, 10.0, 10.0, 10.0)
# Differences are taken over this share of a step.
_DIFFERENCE = 1e-4
#: Standard deviation of what a camera's pixel covers, along an axis: its own box, 1 / sqrt(12), and
#: a Gaussian of optics and demosaicing, of which 0.4 to 0.8 pixels are usual.
BLUR_PX = 0.65
# A mean over a blur is, to the third order, that of these places about its centre.
_AROUND = BLUR_PX * np.sqrt(2) * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
# What is seen of a lens ends so far from its seams, where pixels see two: without its corners.
_SEAM_PX = 0.4
# Of the integral along a side of a cell.
_NODES = 6
_MODEL = "thick"


class Guess(NamedTuple):
    """Values of all unknown parameters, with one pose for each position."""

    display: Display
    camera: Intrinsics
    poses: tuple[Pose, ...]

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
        of_camera = by[len(PARAMETERS) : len(SHARED)]
        of_poses = by[len(SHARED) :].reshape(-1, _POSE)
        return Guess(
            self.display.replace(**changed) if changed else self.display,
            Intrinsics(*(float(a + b) for a, b in zip(self.camera, of_camera, strict=True))),
            tuple(
                Pose(rotation(pose_change[:3]) @ pose.turn, pose.eye_mm + pose_change[3:])
                for pose, pose_change in zip(self.poses, of_poses, strict=True)
            ),
        )

    @property
    def steps(self) -> np.ndarray:
        """`STEPS` in the order of `moved`."""
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


def panel_points(display: Display, index: np.ndarray, arriving: np.ndarray) -> np.ndarray:
    """Panel points reached by rays through given lenses.

    * `index`, (n, 2) int: the lenses, column and row.
    * `arriving`, (4, n): see `inim.calibration.model.rays`.

    Returns (n, 2) array, display frame, mm.
    """
    array, traits = lens_array(display), lens_traits(display)
    x, y, sx, sy = to_array(array, traits, *arriving)
    centre_x, centre_y = _lens_centres(array, index).T
    # One lens about its own axis, in a cell so wide that none of its rays is a neighbour's.
    alone = array._replace(
        pitch_x=2 * array.pitch_x, pitch_y=2 * array.pitch_y, half_columns=0.5, half_rows=0.5
    )
    trace = lens_model(_MODEL).function
    with np.errstate(invalid="ignore"):
        ray = trace(
            alone, traits, NUMPY_OPS, x - centre_x, y - centre_y, sx, sy, display.refractive_index
        )
    ray = ray._replace(x=ray.x + centre_x, y=ray.y + centre_y)
    panel_x, panel_y, _ = to_panel(array, traits, ray)
    return np.stack([panel_x, panel_y], axis=-1)


def centres(
    display: Display, camera: Intrinsics, pose: Pose, index: np.ndarray, deeper_mm: float = 0.0
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


@dataclass(frozen=True)
class Observations:
    """Observations in the photographs, by position."""

    #: (rays, 2) int each: the lens that a ray goes through, column and row of the array.
    lens: tuple[np.ndarray, ...]
    #: (rays, 2) float each: its pixel; where on the panel it was found to end, mm, display frame.
    pixel: tuple[np.ndarray, ...]
    panel: tuple[np.ndarray, ...]
    outlined: tuple[np.ndarray, ...]  #: (lenses, 2) int each: lenses whose outline is seen.
    centre: tuple[np.ndarray, ...]  #: (lenses, 2) float each: the pixels around which it is.

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
                )
            )
        return cls(*zip(*observed, strict=True))

    def without_blur(self, guess: Guess) -> Observations:
        """Observations corrected to those of a camera without blur.

        How far blur moves them hardly depends on the guess.
        """
        display, camera, poses = guess
        panel = []
        for lens, pixel, panel_mm, pose in zip(
            self.lens, self.pixel, self.panel, poses, strict=True
        ):
            places = np.concatenate([pixel, *(pixel + off for off in _AROUND)])
            all_lenses = np.tile(lens, (1 + len(_AROUND), 1))
            landed = panel_points(display, all_lenses, rays(camera, pose, places))
            through_centre, *others = np.split(landed, 1 + len(_AROUND))
            panel.append(panel_mm + through_centre - np.mean(others, axis=0))
        return replace(self, panel=tuple(panel))

    @property
    def counts(self) -> list[tuple[int, int]]:
        """Rays and outlines of each position."""
        return [(len(a), len(b)) for a, b in zip(self.lens, self.outlined, strict=True)]

    def residuals(self, guess: Guess) -> list[tuple[np.ndarray, np.ndarray]]:
        """Residuals by position: of rays, (n, 2) mm on the panel; of outlines, (m, 2) pixels."""
        display, camera, poses = guess
        arriving = [
            rays(camera, p, px).reshape(4, -1) for p, px in zip(poses, self.pixel, strict=True)
        ]
        landed = panel_points(display, np.concatenate(self.lens), np.concatenate(arriving, axis=1))
        ends = np.cumsum([len(lens) for lens in self.lens])[:-1]
        return [
            (ray_mm - panel_mm, centres(display, camera, pose, outlined) - centre)
            for ray_mm, panel_mm, pose, outlined, centre in zip(
                np.split(landed, ends), self.panel, poses, self.outlined, self.centre, strict=True
            )
        ]

    def flat(self, guess: Guess) -> np.ndarray:
        """The residuals in one row: position by position, rays before outlines."""
        parts = [part.ravel() for pair in self.residuals(guess) for part in pair]
        return np.concatenate(parts)

    def imperfections(self, guess: Guess) -> np.ndarray:
        """Change of `flat` caused by typical deviations of sheets from the model, (2, all).

        If a lens magnified by one panel millimetre in a millimetre more; if seams were a tenth of a
        millimetre deeper.
        """
        display, camera, poses = guess
        array, parts = lens_array(display), []
        for lens, pixel, pose, outlined in zip(
            self.lens, self.pixel, poses, self.outlined, strict=True
        ):
            x, y, *_ = rays(camera, pose, pixel)
            within = (np.column_stack([x, y]) - _vertices(array, lens)).ravel()
            flat, deep = (centres(display, camera, pose, outlined, by) for by in (0.0, 0.1))
            parts += [
                np.stack([within, 0 * within]),
                np.stack([0 * flat, deep - flat]).reshape(2, -1),
            ]
        return np.concatenate(parts, axis=1)

    def slopes(self, guess: Guess, by: np.ndarray, free: np.ndarray) -> np.ndarray:
        """Derivatives of `flat` by the changes of `Guess.with_changes` that are free, a row each.

        Poses do not share residuals: one difference serves all of them.
        """
        steps = guess.steps * _DIFFERENCE
        at = self.flat(guess.with_changes(by))
        ends = np.cumsum([0] + [2 * (rays + outlines) for rays, outlines in self.counts])
        slopes = np.zeros((steps.size, at.size))
        for n in np.flatnonzero(free[: len(SHARED)]).tolist():
            more = by.copy()
            more[n] += steps[n]
            slopes[n] = (self.flat(guess.with_changes(more)) - at) / steps[n]
        for n in range(_POSE):
            of_poses = np.arange(len(SHARED) + n, steps.size, _POSE)
            more = by.copy()
            more[of_poses] += steps[of_poses]
            change = (self.flat(guess.with_changes(more)) - at) / steps[of_poses[0]]
            for row, begin, end in zip(of_poses, ends, ends[1:], strict=False):
                slopes[row, begin:end] = change[begin:end]
        chosen: np.ndarray = slopes[free]
        return chosen
