"""Light of a real panel: black level, white point, reflected room light, veiling glare.

::

    emitted = white * (black + (1 - black) * drive)
    seen = (1 - glare) * view + glare * mean(view) + ambient

`drive` is the ideal panel's light, `view` the emitted light through the lenses, its mean that of
each colour over the view (ISO 9358). All are linear RGB, 1 being the white of an ideal panel.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from inim.display.display import Display

#: Range of the formula of the daylight locus (CIE 15).
COLDEST_K, HOTTEST_K = 4000.0, 25000.0
_KNEE_K = 7000.0
_RGB_FROM_XYZ = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)


def has_own_black(display: Display) -> bool:
    """True if the darkest light of a view follows from the display's parameters."""
    return display.black_level > 0 or display.ambient_reflection > 0


def white_of(display: Display) -> tuple[float, float, float]:
    """Red, green and blue of the panel's white, the largest 1.

    Daylight locus of CIE 15, from 4000 to 25000 K, in the primaries of sRGB.
    """
    kelvin = display.white_point_k
    if kelvin is None:
        return 1.0, 1.0, 1.0
    terms = (
        (-4.6070e9, 2.9678e6, 0.09911e3, 0.244063)
        if kelvin <= _KNEE_K
        else (-2.0064e9, 1.9018e6, 0.24748e3, 0.237040)
    )
    x = float(np.polyval(terms, 1 / kelvin))
    y = -3.0 * x * x + 2.870 * x - 0.275
    white = _RGB_FROM_XYZ @ (x / y, 1.0, (1 - x - y) / y)
    red, green, blue = (float(value) for value in white / white.max())
    return red, green, blue


def emits_as_driven(display: Display) -> bool:
    """True if the panel emits the light of its drive exactly."""
    return display.black_level == 0 and display.white_point_k is None


def emitted_light(drive: Any, black: Any, white: Any) -> Any:
    """Light that a panel emits, in NumPy or in Dr.Jit.

    * `drive`: linear RGB, or a channel of it.
    * `black`: `Display.black_level`.
    * `white`: `white_of`, or the channel's part of it.
    """
    return white * (black + (1.0 - black) * drive)


def emitted_picture(eia: np.ndarray, display: Display) -> np.ndarray:
    """Light that a panel emits when it shows an EIA, (rows, columns, 3) float32, linear RGB."""
    if emits_as_driven(display):
        return eia
    white = np.array(white_of(display), np.float32)
    light: np.ndarray = emitted_light(eia, np.float32(display.black_level), white)
    return light


def seen_light(view: np.ndarray, display: Display) -> np.ndarray:
    """View with the light that does not come from its own panel pixels.

    * `view`, (rows, columns, 3) float32: linear RGB, exposed for the panel's white.
    """
    glare, ambient = np.float32(display.veiling_glare), np.float32(display.ambient_reflection)
    if glare:
        mean = view.mean(axis=(0, 1), dtype=np.float64).astype(view.dtype)
        view = (1 - glare) * view + glare * mean
    return view + ambient if ambient else view


def panel_words(display: Display) -> list[str]:
    """Sentence on the panel's light, empty for an ideal panel."""
    shares = {
        "black level": display.black_level,
        "reflected room light": display.ambient_reflection,
        "veiling glare": display.veiling_glare,
    }
    parts = [f"{name} {100 * share:.4g} %" for name, share in shares.items() if share]
    if display.white_point_k is not None:
        parts.append(f"white point {display.white_point_k:g} K")
    return [f"Views include the panel's light: {', '.join(parts)}."] if parts else []
