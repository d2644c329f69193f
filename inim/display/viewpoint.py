"""Viewpoints: eye positions and their viewing zone."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from numbers import Real

import numpy as np

from inim.display.declaration import stated_repr
from inim.display.display import Display
from inim.system.errors import UsageError, ViewpointError, suggest_words

#: Direction of each named viewpoint, in shares of the side step below.
DEFAULT_VIEWPOINTS = {
    "centre": (0, 0),
    "left": (-1, 0),
    "right": (1, 0),
    "up": (0, 1),
    "down": (0, -1),
}
# Named viewpoints stand at twice the nearest usable distance, where half of the viewing zone is
# left for moving, and step aside by three quarters of what is left: well inside the zone.
_DISTANCE_IN_NEAREST = 2.0
_SIDE_STEP = 0.75
# Elemental images that aim farther are wider by accident: the sheet's pitch is not the nominal one.
_FARTHEST_AIM_IN_NEAREST = 20.0
_NAME = re.compile(r"[\w.+-]{1,64}")


@dataclass(frozen=True, repr=False)
class Viewpoint:
    """An eye in the display frame, looking at the lens array through an off-axis frustum.

    Parameters
    ----------
    name : str
        Used in file names and reports: letters, digits, ``. _ + -``.
    x_mm, y_mm, z_mm : float
        Position of the pupil's centre; z is the viewing distance and must be positive.
    pupil_mm : float
        Diameter of the pupil, a disc parallel to the array; 0 is a pinhole, to which all is sharp.
    focus_mm : float, optional
        Distance from the eye to the plane it is focused on; see `focus_distance_mm`.
    """

    name: str
    x_mm: float
    y_mm: float
    z_mm: float
    pupil_mm: float = 0.0
    focus_mm: float | None = None

    __repr__ = stated_repr

    def __post_init__(self) -> None:
        if not is_file_safe(self.name):
            raise ViewpointError(
                f"viewpoint name {self.name!r}: use 1 to 64 letters, digits or . _ + -"
            )
        if not all(map(math.isfinite, self.position_mm)) or self.z_mm <= 0:
            raise ViewpointError(
                f"viewpoint {self.name}: position {self.position_mm} mm must be finite with z > 0 "
                "(in front of the display)"
            )
        if not (math.isfinite(self.pupil_mm) and self.pupil_mm >= 0):
            raise ViewpointError(
                f"viewpoint {self.name}: pupil_mm = {self.pupil_mm}: a diameter, 0 for a pinhole"
            )
        if self.focus_mm is not None and not (math.isfinite(self.focus_mm) and self.focus_mm > 0):
            raise ViewpointError(
                f"viewpoint {self.name}: focus_mm = {self.focus_mm}: must be a positive distance "
                "from the eye"
            )

    @property
    def position_mm(self) -> tuple[float, float, float]:
        """(x, y, z) in the display frame."""
        return self.x_mm, self.y_mm, self.z_mm


def is_file_safe(name: str) -> bool:
    """True if a name is a valid file name: 1 to 64 letters, digits or ``. _ + -``."""
    return bool(_NAME.fullmatch(name)) and not name.startswith(".")


def check_viewpoint(viewpoint: Viewpoint, display: Display, *, allow_flips: bool = False) -> None:
    """Raise `ViewpointError` if the eye sees flipped (repeated) views or is inside the picture.

    The limit is |e - x_lens| <= V P / 2g for every lens (see `Display.flip_limit_mm`), and holds
    for the pupil's edge too. With `allow_flips` the eye may see flipped views.
    """
    x, y, distance = viewpoint.position_mm
    if distance <= max(display.depth_range_mm[1], 0.0):
        raise ViewpointError(
            f"viewpoint {viewpoint.name}: distance {distance:g} mm is inside the picture, which "
            f"reaches {display.depth_range_mm[1]:g} mm in front of the lens array; move back"
        )
    if allow_flips:
        return
    half_pupil = viewpoint.pupil_mm / 2
    edge = f" with a pupil of {viewpoint.pupil_mm:g} mm" if half_pupil else ""
    limit_x, limit_y = display.flip_limit_mm(distance)
    across, along = display.layout.eye_offset(x, y)
    for axis, offset, limit in (("x", across, limit_x), ("y", along, limit_y)):
        if abs(offset) + half_pupil > limit:
            way_out = (
                f"keep |{axis}| <= {limit - half_pupil:.4g} mm at this distance"
                if limit >= half_pupil
                else f"take a pupil_mm of at most {2 * limit:.4g}, or move back"
                if limit > 0
                else f"move back to at least {display.nearest_viewing_distance_mm:.4g} mm"
            )
            raise ViewpointError(
                f"viewpoint {viewpoint.name}: {axis} = {offset:g} mm at {distance:g} mm{edge} is "
                f"outside the viewing zone (flipped views); {way_out}"
            )


def focus_distance_mm(viewpoint: Viewpoint, display: Display) -> float:
    """Distance from the eye to the plane it is focused on.

    Default: the display's central depth plane, where its image is sharpest, or the array itself if
    that plane is at infinity (a focused display). A pinhole eye is focused at all distances,
    represented by the array.

    Raises `ViewpointError`: the central depth plane is not in front of an eye with a pupil.
    """
    if viewpoint.focus_mm is not None:
        return viewpoint.focus_mm
    if viewpoint.pupil_mm == 0 or math.isinf(display.central_depth_mm):
        return viewpoint.z_mm
    distance = viewpoint.z_mm - display.central_depth_mm
    if distance <= 0:
        raise ViewpointError(
            f"viewpoint {viewpoint.name}: the central depth plane z = "
            f"{display.central_depth_mm:g} mm is behind the eye at {viewpoint.z_mm:g} mm, which "
            "cannot focus on it; set focus_mm"
        )
    return distance


def default_distance_mm(display: Display) -> float:
    """Default eye distance: that of the design, if the rays of pixels are made for one, or that
    at which wider elemental images aim; otherwise twice the nearest distance without flips, outside
    the picture.
    """
    design = display.layout.design_distance_mm
    if design is not None and math.isfinite(design):
        return design
    in_front = 2 * max(display.depth_range_mm[1], 0.0)
    nearest, pitch = display.nearest_viewing_distance_mm, display.pitch_mm
    wider = display.elemental_image_pitch_mm - pitch
    if wider * _FARTHEST_AIM_IN_NEAREST * nearest >= display.gap_mm * pitch:
        return max(display.gap_mm * pitch / wider, in_front)
    return max(_DISTANCE_IN_NEAREST * nearest, in_front)


def named_viewpoint(name: str, display: Display, distance_mm: float) -> Viewpoint:
    """One of `DEFAULT_VIEWPOINTS` placed inside this display's viewing zone."""
    if name not in DEFAULT_VIEWPOINTS:
        raise ViewpointError(
            f"viewpoint {name!r}: {suggest_words(name, DEFAULT_VIEWPOINTS)}, or give a position as "
            "'name=x y' or 'name=x y z' (mm)"
        )
    across, up = DEFAULT_VIEWPOINTS[name]
    half_x, half_y = zone_half_mm(display, distance_mm)
    return Viewpoint(name, across * _SIDE_STEP * half_x, up * _SIDE_STEP * half_y, distance_mm)


def zone_half_mm(display: Display, distance_mm: float) -> tuple[float, float]:
    """Half the width and height of the viewing zone at a distance; 0 where it has none.

    Where flips do not limit it, it is as high as the display.
    """
    limits = display.flip_limit_mm(distance_mm)
    sizes = display.width_mm, display.height_mm
    half_x, half_y = (
        max(limit, 0.0) if math.isfinite(limit) else size / 2
        for limit, size in zip(limits, sizes, strict=True)
    )
    return half_x, half_y


def viewpoint_items(viewpoints: object) -> tuple[str | Viewpoint, ...]:
    """Viewpoints one by one, each a `Viewpoint` or its text.

    * `viewpoints`: texts are separated at their commas; see `parse_viewpoints`. Three numbers are a
      position in millimetres, which also names the viewpoint.

    Raises `UsageError`: another type, or no viewpoint at all.
    """
    if isinstance(viewpoints, Viewpoint):
        return (viewpoints,)
    if isinstance(viewpoints, str):
        items: tuple[str | Viewpoint, ...] = tuple(
            item.strip() for item in viewpoints.split(",") if item.strip()
        )
    elif isinstance(viewpoints, list | tuple):
        if len(viewpoints) == 3 and all(isinstance(item, Real) for item in viewpoints):
            x, y, z = map(float, viewpoints)
            return (Viewpoint(f"{x:g}_{y:g}_{z:g}", x, y, z),)
        items = tuple(item for part in viewpoints for item in viewpoint_items(part))
    else:
        raise UsageError(
            f"viewpoints: {viewpoints!r} is a {type(viewpoints).__name__}; give a Viewpoint, a "
            "name such as 'centre', 'name=x y z' or (x, y, z) in mm, or a list of these"
        )
    if not items:
        raise ViewpointError("viewpoints: none given; name at least one, such as 'centre'")
    return items


def viewpoints_text(viewpoints: Iterable[str | Viewpoint]) -> str:
    """Text of viewpoints as `parse_viewpoints` reads it; without pupil and focus."""
    return ",".join(
        item
        if isinstance(item, str)
        else f"{item.name}={' '.join(repr(float(x)) for x in item.position_mm)}"
        for item in viewpoints
    )


def parse_viewpoints(
    viewpoints: str | Viewpoint | Sequence[str | Viewpoint | Sequence[float]],
    display: Display,
    distance_mm: float | None = None,
    pupil_mm: float = 0.0,
    focus_mm: float | None = None,
) -> tuple[Viewpoint, ...]:
    """Checked viewpoints from values or from text: ``"centre, mine=10 -5, far=0 0 900"``.

    * `viewpoints`: names of `DEFAULT_VIEWPOINTS`, or ``name=x y [z]`` in millimetres, separated by
      commas.
    * `display`: display whose viewing zone must contain them.
    * `distance_mm`: viewing distance for text without z; default: `default_distance_mm`.
    * `pupil_mm`, `focus_mm`: for every eye given as text; see `Viewpoint`. Eyes with a pupil are
      returned with explicit focus, because they may later see a misaligned display.

    Raises `UsageError`: see `viewpoint_items`. `ViewpointError`: unknown or doubled name,
    unreadable position, or outside the viewing zone.
    """
    distance = default_distance_mm(display) if distance_mm is None else distance_mm
    eyes = [
        item
        if isinstance(item, Viewpoint)
        else replace(
            _parse_viewpoint(item, display, distance), pupil_mm=pupil_mm, focus_mm=focus_mm
        )
        for item in viewpoint_items(viewpoints)
    ]
    names = {"eia"}  # the ground-truth EIA lies beside the views
    for eye in eyes:
        # Case apart, two names may be one file.
        if eye.name.lower() in names:
            raise ViewpointError(
                f"viewpoint {eye.name!r} is given twice, or its name is taken; rename it"
            )
        names.add(eye.name.lower())
        check_viewpoint(eye, display)
    return tuple(
        replace(eye, focus_mm=focus_distance_mm(eye, display)) if eye.pupil_mm else eye
        for eye in eyes
    )


def single_viewpoint(viewpoint: object) -> str | Viewpoint:
    """The only one of `viewpoint_items`; raises `ViewpointError` for several."""
    item, *others = viewpoint_items(viewpoint)
    if others:
        raise ViewpointError(f"viewpoint {viewpoint!r}: names several; give one")
    return item


def viewpoint_of(viewpoint: Viewpoint | str | Sequence[float], display: Display) -> Viewpoint:
    """A viewpoint from a value, or from its text as `parse_viewpoints` reads it; not checked.

    Raises `UsageError` or `ViewpointError`: another type, several viewpoints, or text that cannot
    be read.
    """
    item = single_viewpoint(viewpoint)
    if isinstance(item, Viewpoint):
        return item
    return _parse_viewpoint(item, display, default_distance_mm(display))


def _parse_viewpoint(item: str, display: Display, distance_mm: float) -> Viewpoint:
    name, equals, text = item.partition("=")
    if not equals:
        return named_viewpoint(name, display, distance_mm)
    position = _parse_position(text, distance_mm)
    if position is None:
        raise ViewpointError(f"viewpoint {item!r}: give 'name=x y' or 'name=x y z' in millimetres")
    return Viewpoint(name.strip(), *position)


def _parse_position(text: str, distance_mm: float) -> list[float] | None:
    """Position x, y, z from "x y [z]"; None if it cannot be read."""
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        return None
    return [*numbers, distance_mm][:3] if len(numbers) in (2, 3) else None


def zone_eyes(
    display: Display, count: int, distance_mm: float | None = None, *, rows: int = 1
) -> list[Viewpoint]:
    """Eyes at even steps across the viewing zone, from left to right in each row, upwards.

    Each stands in the middle of its share of the zone.

    * `count`: eyes of a row.
    * `distance_mm`: `default_distance_mm` otherwise.

    Raises `ViewpointError`: too close for a viewing zone.
    """
    distance = default_distance_mm(display) if distance_mm is None else distance_mm
    check_viewpoint(Viewpoint("middle", 0.0, 0.0, distance), display)
    across, up = (
        ((2 * np.arange(steps) + 1) / steps - 1) * limit
        for steps, limit in zip((count, rows), zone_half_mm(display, distance), strict=True)
    )
    eyes = [
        Viewpoint(f"view-{k}", float(x), float(y), distance)
        for k, (y, x) in enumerate(product(up, across))
    ]
    for eye in eyes:
        check_viewpoint(eye, display)
    return eyes
