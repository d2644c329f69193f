"""Start of the fit: cameras from homographies, one number per lens, the array from its edges."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from inim.calibration.lattice import Lenses
from inim.calibration.model import Intrinsics, Pose, panel_mm, rotation
from inim.display import Display
from inim.errors import FileError

# Focal lengths tried, in widths of the photograph: a wide lens to a long one.
_FOCAL_WIDTHS = np.geomspace(0.5, 8.0, 41)
# What they are like without a word from the photographs (logarithms), how far lattices seem to be
# from square by the camera's distortion alone, and pitches off the nominal: standard deviations.
_USUAL_WIDTHS, _FOCAL_SPREAD = 1.2, 1.0
_SKEW_SPREAD = 2e-3
_PITCH_SPREAD = 0.015
# A sheet of which the pitch is so far off is another display's.
_PITCH_OFF = 0.04


def _lattice_mm(display: Display, index: np.ndarray) -> np.ndarray:
    """Places of lenses in the array, y upwards, the first at the origin."""
    points: np.ndarray = index * [display.pitch_mm, -display.row_pitch_mm]
    return points


def homography(points_mm: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Homography from a plane to the photograph (Hartley, Zisserman, algorithm 4.2).

    * `points_mm`, `pixels`, (n, 2): points of the plane, y upwards, and in the photograph.
    """
    flat = [points_mm, pixels]
    scaled, norms = [], []
    for points in flat:
        middle = points.mean(axis=0)
        size = math.sqrt(((points - middle) ** 2).sum(axis=1).mean() / 2)
        scaled.append((points - middle) / size)
        norms.append(
            np.array(
                [[1 / size, 0, -middle[0] / size], [0, 1 / size, -middle[1] / size], [0, 0, 1]]
            )
        )
    a, b = scaled
    ones, zeros = np.ones((len(a), 1)), np.zeros((len(a), 3))
    a1 = np.hstack([a, ones])
    rows = np.concatenate(
        [np.hstack([a1, zeros, -b[:, :1] * a1]), np.hstack([zeros, a1, -b[:, 1:] * a1])]
    )
    solution = np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 3)
    plane_map: np.ndarray = np.linalg.inv(norms[1]) @ solution @ norms[0]
    return plane_map


def lattice_map(display: Display, lenses: Lenses) -> np.ndarray:
    """Homography from the array's plane, with the lens 0, 0 at its origin."""
    return homography(_lattice_mm(display, lenses.index), lenses.centre_px)


def _columns(plane_map: np.ndarray, camera: Intrinsics) -> np.ndarray:
    """Directions of the display's axes and its origin, in the camera's frame, one scale for all."""
    x, y, f = camera.centre_x_px, camera.centre_y_px, camera.focal_px
    into = np.array([[1 / f, 0, -x / f], [0, 1 / f, -y / f], [0, 0, 1]]) @ plane_map
    scale = 2 / (np.linalg.norm(into[:, 0]) + np.linalg.norm(into[:, 1]))
    scaled: np.ndarray = into * math.copysign(scale, into[2, 2])
    return scaled


def focal_guess(
    maps: Sequence[np.ndarray],
    shape: tuple[int, int],
    stated_px: float | None = None,
    enlarged: Callable[[int, float], float] = lambda number, distance_mm: 1.0,  # noqa: ARG005
) -> Intrinsics:
    """Camera whose axis passes through the centre of the photographs.

    Its focal length is the one in the photographs, if given. Otherwise it is the one under which
    all planes are most nearly undistorted, at distances that agree with the magnification.

    * `maps`: homographies of the positions; `shape`: height and width of the photographs.
    * `enlarged`: size of a position's lattice relative to the design, for an eye at a distance.
    """
    height, width = shape
    if stated_px is not None:
        return Intrinsics(stated_px, width / 2, height / 2)

    def unlikeness(camera: Intrinsics) -> float:
        total = (math.log(camera.focal_px / width / _USUAL_WIDTHS) / _FOCAL_SPREAD) ** 2
        for number, plane_map in enumerate(maps):
            a, b, _ = _columns(plane_map, camera).T
            away = float(_pose(plane_map, camera).eye_mm[2])
            total += (float(a @ b) ** 2 + float(a @ a - b @ b) ** 2 / 4) / _SKEW_SPREAD**2
            total += ((enlarged(number, away) - 1) / _PITCH_SPREAD) ** 2
        return total

    tried = [Intrinsics(float(width * share), width / 2, height / 2) for share in _FOCAL_WIDTHS]
    return min(tried, key=unlikeness)


def pose_of_plane(plane_map: np.ndarray, camera: Intrinsics, name: str) -> Pose:
    """Pose of a camera in a plane's own frame.

    Raises `FileError`: it stands behind the display: the photographs are mirrored.
    """
    pose = _pose(plane_map, camera)
    if pose.eye_mm[2] <= 0:
        raise FileError(f"{name}: the photographs are mirrored; save them as the camera saw them")
    return pose


def _pose(plane_map: np.ndarray, camera: Intrinsics) -> Pose:
    a, b, origin = _columns(plane_map, camera).T
    u, _, v = np.linalg.svd(np.stack([a, b, np.cross(a, b)], axis=1))
    turn = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    return Pose(turn, -turn.T @ origin)


def _array_to_panel(display: Display, lenses: Lenses) -> tuple[np.ndarray, np.ndarray]:
    """Affine map from places in the array to panel points seen through lenses: matrix, offset."""
    points = _lattice_mm(display, lenses.index)
    homogeneous = np.hstack([points, np.ones((len(points), 1))])
    fit = np.linalg.lstsq(homogeneous, panel_mm(display, lenses.middle_px), rcond=None)[0]
    return fit[:2].T, fit[2]


def panel_step(display: Display, lenses: Lenses) -> float:
    """Step between adjacent lenses on the panel, P (1 + g / V), in nominal pitches."""
    return math.sqrt(abs(float(np.linalg.det(_array_to_panel(display, lenses)[0]))))


def check_pitch(display: Display, size: float, name: str) -> None:
    """Raise `FileError` unless lenses lie about as far apart as designed, `size` times as far."""
    if abs(size - 1) > _PITCH_OFF:
        lens = display.pitch_mm / display.pixel_pitch_mm
        raise FileError(
            f"{name}: the lenses are {size * lens:.4g} panel pixels apart, those of display "
            f"{display.name} {lens:.4g}; give the photographed display with --display, and show "
            "the patterns in the browser pixel for pixel"
        )


class ArrayPlacement(NamedTuple):
    """Placement of the array over the panel, from one position's photographs."""

    #: Rotation, and the approximate pitch of the array in nominal pitches.
    rotation_deg: float
    size: float
    origin_mm: np.ndarray  #: (2,) array: position of the lens 0, 0 of its numbering, display frame.


def find_placement(display: Display, lenses: Lenses, pose: Pose, name: str) -> ArrayPlacement:
    """Rotation, and where the lens of index 0 is: through a lens's centre rays go straight.

    Raises `FileError`: the photographs are of another display.
    """
    ((a, b), (c, d)), at_origin = _array_to_panel(display, lenses)
    x, y, z = pose.eye_mm
    size = panel_step(display, lenses) / (1 + display.gap_mm / z)
    check_pitch(display, size, name)
    angle = math.atan2(c - b, a + d)
    turn = rotation([0.0, 0.0, angle])[:2, :2]
    return ArrayPlacement(math.degrees(angle), size, at_origin + turn @ [x, y] * display.gap_mm / z)


def _number_periods(
    display: Display,
    lenses: Lenses,
    placement: ArrayPlacement,
    turn: np.ndarray,
    step: np.ndarray,
    name: str,
) -> ArrayPlacement:
    """Placement with the periods nearest to the design, if no marks number them.

    Raises `FileError`: the array's edges are not seen either.
    """
    if not lenses.period_px.any():
        return placement
    there = np.array([display.lens_columns, display.lens_rows])
    low, high = lenses.index.min(axis=0), lenses.index.max(axis=0)
    if (high - low + 1 < there).any():
        raise FileError(
            f"{name}: no marks of the white pattern are recognised, and not all edges of the sheet "
            "are visible; photograph the patterns in order, white first, or the whole sheet"
        )
    designed = np.array([display.shift_x_mm, display.shift_y_mm])
    first = designed - turn @ (step * (low + (there - 1) / 2))
    period = lenses.period_px * display.pixel_pitch_mm
    origin = placement.origin_mm
    return placement._replace(origin_mm=origin + period * np.rint((first - origin) / period))


class LensNumbering(NamedTuple):
    """Common numbering of lenses for all positions, from the array's top left."""

    shift_mm: np.ndarray  #: (2,) array: position of the array's centre, display frame.
    offsets: list[np.ndarray]  #: (2,) int each: offsets to add to each position's indices.
    #: True if all columns, or rows, of the array are visible: the numbering is unambiguous.
    #: Otherwise it is the one with the smallest shift of the array.
    edges_seen: tuple[bool, bool]


def number_lenses(
    display: Display, lenses: Mapping[str, Lenses], placements: Sequence[ArrayPlacement]
) -> LensNumbering:
    """Count the lenses of all positions together.

    Raises `FileError`: more lenses are seen than there are.
    """
    angle = math.radians(placements[0].rotation_deg)
    turn = rotation([0.0, 0.0, angle])[:2, :2]
    step = np.array([display.pitch_mm, -display.row_pitch_mm]) * placements[0].size
    placements = [
        _number_periods(display, position, placement, turn, step, name)
        for (name, position), placement in zip(lenses.items(), placements, strict=True)
    ]
    origin = placements[0].origin_mm
    offsets = [
        np.rint((placement.origin_mm - origin) @ turn / step).astype(int)
        for placement in placements
    ]
    index = [position.index + by for position, by in zip(lenses.values(), offsets, strict=True)]
    low = np.min([position_index.min(axis=0) for position_index in index], axis=0)
    high = np.max([position_index.max(axis=0) for position_index in index], axis=0)
    there = np.array(display.layout.grid[::-1])
    for visible_count, most, axis_name in zip(
        high - low + 1, there, ("columns", "rows"), strict=True
    ):
        if visible_count > most:
            raise FileError(
                f"{', '.join(lenses)}: {visible_count} {axis_name} of lenses are visible, but "
                "display "
                f"{display.name} has {most}; give the photographed display with --display"
            )
    designed = np.array([display.shift_x_mm, display.shift_y_mm])
    first = np.rint((designed - origin) @ turn / step - (there - 1) / 2).astype(int)
    first = np.clip(first, high - there + 1, low)
    columns_seen, rows_seen = (high - low + 1 == there).tolist()
    shift = origin + turn @ (step * (first + (there - 1) / 2))
    return LensNumbering(shift, [by - first for by in offsets], (columns_seen, rows_seen))
