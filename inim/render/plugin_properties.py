"""What a scene tells inim's plugins: a display by its parameters, and where in the world it is.

A display stands in a scene as a stock `rectangle`, whose square [-1, 1]^2 is the lens array as it
lies. So one `to_world` says all: where the display is, how it is turned, and how long a millimetre
is in the scene's unit. Emitter and sensors read it alike.
"""

from __future__ import annotations

import difflib
from typing import Any

import mitsuba as mi
import numpy as np

from inim.display import DISPLAYS, Display
from inim.display.misalignment import mounted
from inim.errors import DisplayError, SceneError
from inim.lens import lens_array
from inim.settings import DISPLAY_KEYS, Settings

_DISPLAY = ("preset", *DISPLAY_KEYS, "misalign")
_OBJECTS = (mi.Properties.Type.Object, mi.Properties.Type.ResolvedReference)
# A rectangle's sides may be rounded to three digits; more, and the picture is stretched.
_ASPECT = 1e-3
# Sides that are square to each other in float32, turned and moved.
_SQUARE = 1e-5


def refusing(plugin: str, base: type) -> type:
    """The plugin in a variant that it does not work in: it says so in one line."""

    def refuse(*_: Any) -> None:
        raise SceneError(
            f"{plugin}: works in the variants llvm_ad_rgb and cuda_ad_rgb, not in {mi.variant()}; "
            "set one of them with mi.set_variant"
        )

    return type("Refusing", (base,), {"__init__": refuse})


def read_properties(
    plugin: str, props: Any, own: tuple[str, ...], stock: tuple[str, ...]
) -> dict[str, Any]:
    """The values of a plugin's parameters, of a display's, and of its own.

    Parameters
    ----------
    plugin : str
    props : mi.Properties
    own : tuple of str
        The plugin's, beside a display's parameters.
    stock : tuple of str
        Those that its base class reads; objects beside the plugin's own are left to it, too.

    Raises
    ------
    SceneError
        An unknown parameter, with the nearest known one.
    """
    known = (*own, *_DISPLAY)
    values = {}
    for name in props:
        if name in stock or (name not in known and props.type(name) in _OBJECTS):
            continue
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"use {', '.join(known)}"
            raise SceneError(f"{plugin}: unknown parameter {name!r}; {hint}")
        values[name] = props[name]
    return values


def display_of(plugin: str, values: dict[str, Any]) -> Display:
    """The display that a plugin's parameters describe, as it is mounted.

    Parameters
    ----------
    plugin : str
    values : dict
        `preset` (nominal), `misalign`, and what differs from the preset, by the names of `Display`.

    Raises
    ------
    InimError
        They describe no possible display.
    """
    preset = values.get("preset", "nominal")
    if preset not in DISPLAYS:
        raise SceneError(f"{plugin}: preset = {preset!r}; use {' or '.join(DISPLAYS)}")
    given = {name: values[name] for name in DISPLAY_KEYS if name in values}
    display = Settings(display=preset, **given).make_display(plugin)
    try:
        return mounted(display, str(values.get("misalign", "")))
    except DisplayError as error:
        raise DisplayError(f"{plugin}: {error}") from None


def half_extent_mm(display: Display) -> tuple[float, float]:
    """Half the width and height, about the panel's centre, that hold the array as it lies."""
    array = lens_array(display)
    c, s = abs(array.cosine), abs(array.sine)
    half_x, half_y = display.width_mm / 2, display.height_mm / 2
    return c * half_x + s * half_y + abs(array.shift_x), c * half_y + s * half_x + abs(
        array.shift_y
    )


def display_place(plugin: str, to_world: np.ndarray, display: Display) -> np.ndarray:
    """The map from the display frame, in millimetres, to the world.

    Parameters
    ----------
    plugin : str
    to_world : (4, 4) float64
        Of the rectangle [-1, 1]^2 that is the array as it lies. How it stretches the rectangle's
        normal does not matter.
    display : Display

    Returns
    -------
    (4, 4) float64
        Rotation, one scale, translation.

    Raises
    ------
    SceneError
        The rectangle is skewed or mirrored, or its sides are not in the array's proportion.
    """
    half_x, half_y = half_extent_mm(display)
    sides = np.linalg.norm(to_world[:3, :2], axis=0)
    if not (np.isfinite(to_world).all() and sides.min() > 0):
        raise SceneError(f"{plugin}: to_world makes no rectangle of [-1, 1]^2; scale its sides")
    right, up = (to_world[:3, :2] / sides).T
    if abs(right @ up) > _SQUARE:
        raise SceneError(f"{plugin}: to_world skews the display; move, turn and scale it only")
    front = np.cross(right, up)
    if front @ to_world[:3, 2] < 0:
        raise SceneError(
            f"{plugin}: to_world mirrors the display; turn it with a rotation, not a negative scale"
        )
    unit = sides / (half_x, half_y)
    if abs(unit[0] / unit[1] - 1) > _ASPECT:
        raise SceneError(
            f"{plugin}: a rectangle of {2 * sides[0]:.6g} x {2 * sides[1]:.6g} has not the "
            f"proportion of the array, {2 * half_x:.6g} x {2 * half_y:.6g} mm; "
            f"scale it by {half_x:.6g} and {half_y:.6g} times the length of a millimetre"
        )
    place = np.eye(4)
    place[:3, :3] = np.stack([right, up, front], axis=1) * unit.mean()
    place[:3, 3] = to_world[:3, 3]
    return place
