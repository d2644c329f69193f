"""Where the eye of a film goes."""

from __future__ import annotations

import math

import numpy as np

from inim.display.display import Display
from inim.display.viewpoint import Viewpoint, check_viewpoint, default_distance_mm
from inim.errors import UsageError

__all__ = ["eye_path"]

# The eye circles at this share of where views flip, as the named viewpoints stand.
_SHARE_OF_ZONE = 0.75


def eye_path(text: str, display: Display, count: int) -> list[Viewpoint]:
    """Eye positions of a film, which ends where it begins.

    Parameters
    ----------
    text : str
        ``"circle"`` (an ellipse well inside the viewing zone, at the usual distance), or two or
        more positions ``"x y [z], x y [z]"`` in millimetres, to be walked at even steps and back.
    display : Display
    count : int
        Frames.

    Raises
    ------
    UsageError
        A path that cannot be read.
    ViewpointError
        A position outside the viewing zone.
    """
    distance = default_distance_mm(display)
    if text.strip() == "circle":
        across, along = (_SHARE_OF_ZONE * max(v, 0.0) for v in display.flip_limit_mm(distance))
        turns = np.arange(count) / count * 2 * math.pi
        places = np.stack(
            [across * np.sin(turns), along * np.cos(turns), np.full(count, distance)], axis=1
        )
    else:
        places = _there_and_back(_waypoints(text, distance), count)
    eyes = [Viewpoint(f"frame-{i}", *map(float, place)) for i, place in enumerate(places)]
    for eye in eyes:
        check_viewpoint(eye, display)
    return eyes


def _waypoints(text: str, distance_mm: float) -> np.ndarray:
    """(points, 3) positions from their text."""
    points = []
    for item in text.split(","):
        try:
            numbers = [float(word) for word in item.split()]
        except ValueError:
            numbers = []
        if len(numbers) not in (2, 3):
            raise UsageError(
                f"--path {text!r}: write 'circle', or positions 'x y [z], x y [z]' in millimetres"
            )
        points.append([*numbers, distance_mm][:3])
    if len(points) < 2:
        raise UsageError(f"--path {text!r}: a path needs two positions at least")
    return np.array(points)


def _there_and_back(points: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) places at even steps along the way to the last point and back."""
    loop = np.concatenate([points, points[-2::-1]])
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(loop, axis=0), axis=1))])
    at = np.arange(count) / count * way[-1]
    return np.stack([np.interp(at, way, loop[:, axis]) for axis in range(3)], axis=1)
