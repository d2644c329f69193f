"""What to photograph next: the standard errors that one more position would leave."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from inim.calibrate.camera import Camera, Pose
from inim.calibrate.fit import Calibration
from inim.calibrate.model import PARAMETERS, SHARED, Guess, Seen, centres
from inim.display import Display

# Directions to look from: right and up, in shares of the angle at which views flip.
_ASIDE = {
    "straight on": (0.0, 0.0),
    "the left": (-0.8, 0.0),
    "the right": (0.8, 0.0),
    "above": (0.0, 0.8),
    "below": (0.0, -0.8),
}
# Distances, in those that there are: nearer, as near, as far, farther.
_NEARER, _FARTHER = 0.75, 1.5
# Lenses tried, across and down, and how far from their centres rays pass, in pitches.
_LENSES = 24
_OFF_CENTRE = 0.25


class Advice(NamedTuple):
    """A position to photograph from.

    Attributes
    ----------
    where : str
        In words.
    eye_mm : (3,) tuple of float
    errors : dict of str to float
        Standard errors of the display's parameters, with one more position there.
    """

    where: str
    eye_mm: tuple[float, float, float]
    errors: dict[str, float]


def next_positions(found: Calibration) -> list[Advice]:
    """Positions worth adding, the best one first.

    Each is one of some directions and distances; the best leaves the least product of standard
    errors. Residuals there are taken to be those of the positions there are.
    """
    display, camera, poses = found.guess
    distances = sorted(float(pose.eye_mm[2]) for pose in poses)
    steps = found.guess.steps[: len(SHARED)]
    free = np.diag(found.covariance)[: len(SHARED)] > 0
    own = found.covariance[: len(SHARED), : len(SHARED)] / np.outer(steps, steps)
    known = np.linalg.inv(own[np.ix_(free, free)])
    half_angle = math.radians(display.viewing_half_angle_deg)
    advised = []
    for distance in sorted(
        {_NEARER * distances[0], distances[0], distances[-1], _FARTHER * distances[-1]}
    ):
        for words, (right, up) in _ASIDE.items():
            eye = distance * np.array(
                [math.tan(right * half_angle), math.tan(up * half_angle), 1.0]
            )
            more = _information(display, camera, _facing(eye), found, free)
            if more is None:
                continue
            errors = np.sqrt(np.diag(np.linalg.inv(known + more))) * steps[free]
            named = dict(zip(PARAMETERS, map(float, errors), strict=False))
            off = math.degrees(math.hypot(right, up) * half_angle)
            aside = f", {off:.0f}° off straight" if off else ""
            place = f"{words}{aside}, {distance:.0f} mm away"
            advised.append(Advice(place, (float(eye[0]), float(eye[1]), float(eye[2])), named))
    return sorted(advised, key=lambda one: sum(map(math.log, one.errors.values())))


def _facing(eye: np.ndarray) -> Pose:
    """A camera that looks at the display's middle, upright."""
    z = -eye / np.linalg.norm(eye)
    x = np.cross([0.0, -1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return Pose(np.stack([x, np.cross(z, x), z]), eye)


def _information(
    display: Display, camera: Camera, pose: Pose, found: Calibration, free: np.ndarray
) -> np.ndarray | None:
    """What a position tells of `SHARED`, its pose being unknown; None where it sees too little."""
    column, row = np.meshgrid(
        np.unique(np.linspace(0, display.lens_columns - 1, _LENSES).astype(int)),
        np.unique(np.linspace(0, display.lens_rows - 1, _LENSES).astype(int)),
    )
    index = np.stack([column.ravel(), row.ravel()], axis=-1)
    centre = centres(display, camera, pose, index)
    height, width = found.lenses[0].shape
    inside = ((centre > 0) & (centre < [width, height])).all(axis=-1)
    if inside.sum() < index.size / 8:
        return None
    index, centre = index[inside], centre[inside]
    lens_px = camera.focal_px * display.pitch_mm / pose.eye_mm[2]
    places = np.array([(x, y) for x in (-1, 1) for y in (-1, 1)]) * _OFF_CENTRE * lens_px
    each = np.repeat(index, len(places), axis=0)
    pixel = (centre[:, None] + places).reshape(-1, 2)
    nothing = np.zeros_like(pixel)
    seen = Seen((each,), (pixel,), (nothing,), (index,), (centre,))
    guess = Guess(display, camera, (pose,))
    fitted = np.append(free, np.ones(6, bool))
    slopes = seen.slopes(guess, np.zeros(fitted.size), fitted) * guess.steps[fitted][:, None]
    ray_mm, outline_px = found.sizes.mean(axis=0)
    # The rays of a lens count as one: they see the same few pixels of the panel.
    sizes = np.repeat(
        [ray_mm * math.sqrt(len(places)), outline_px], [2 * len(each), 2 * len(index)]
    )
    slopes = slopes / sizes
    whole = slopes @ slopes.T
    a, b, d = whole[:-6, :-6], whole[:-6, -6:], whole[-6:, -6:]
    information: np.ndarray = a - b @ np.linalg.solve(d, b.T)
    return information
