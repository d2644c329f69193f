"""Lens models: where a viewer's ray that meets the lens array lands on the panel.

A lens model is one pure function, one file and one line in `LENS_MODELS`::

    trace(array, ops, x, y, sx, sy) -> (panel_x, panel_y, weight)

`(x, y)` is where the ray crosses the principal plane z = 0 and `(sx, sy)` how far it travels
sideways per millimetre away from the viewer. What comes back is the point of the panel plane and
the share of light that gets through: 0 where nothing does. A ray may land under a neighbour's
elemental image; that is crosstalk, and stays. The arithmetic comes in as `ops`, so the same code
runs in float64 NumPy and in a Dr.Jit kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from inim.display import Display
from inim.errors import UsageError
from inim.lens import pinhole, thick
from inim.lens.array import NUMPY_OPS, LensArray, lens_array

__all__ = [
    "LENS_MODELS",
    "LensArray",
    "check_lens_model",
    "lens_array",
    "trace_to_panel",
    "white_exposure",
]

LensModel = Callable[[LensArray, Any, Any, Any, Any, Any], tuple[Any, Any, Any]]

LENS_MODELS: dict[str, LensModel] = {
    "pinhole": pinhole.trace,
    "thick": thick.trace,
}


def check_lens_model(name: str, display: Display) -> None:
    """Raise unless the model exists and the display's lenses can be what it describes.

    Raises
    ------
    UsageError
        Unknown model.
    DisplayError
        A prescription that cannot be ground or does not fit the gap.
    """
    if name not in LENS_MODELS:
        raise UsageError(f"lens model {name!r}: use {' or '.join(LENS_MODELS)}")
    if name == "thick":
        thick.check(display)


def white_exposure(display: Display, model: str) -> np.float32:
    """What a view is multiplied by so that the panel's white looks white on the axis.

    No viewer compares a display with its scene side by side: the loss at a lens's two faces is set
    right with the panel's brightness.
    """
    return np.float32(1 / thick.on_axis_transmittance(display) if model == "thick" else 1.0)


def trace_to_panel(
    display: Display, model: str, x_mm: Any, y_mm: Any, slope_x: Any, slope_y: Any
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Trace viewer's rays to the panel in float64.

    Parameters
    ----------
    display : Display
    model : str
        A key of `LENS_MODELS`.
    x_mm, y_mm : (...) array
        Where the rays cross the array plane z = 0.
    slope_x, slope_y : (...) array
        Sideways travel per millimetre away from the viewer.

    Returns
    -------
    panel_x_mm, panel_y_mm, weight : (...) float64 arrays
    """
    check_lens_model(model, display)
    inputs = [np.asarray(v, np.float64) for v in (x_mm, y_mm, slope_x, slope_y)]
    with np.errstate(invalid="ignore"):  # lanes of total reflection carry weight 0
        x, y, weight = LENS_MODELS[model](
            lens_array(display), NUMPY_OPS, *np.broadcast_arrays(*inputs)
        )
    return x, y, weight
