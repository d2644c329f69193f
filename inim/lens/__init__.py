"""Lens models: where a viewer's ray that meets the lens array lands on the panel.

A lens model is one pure function, one file and one line in `LENS_MODELS`::

    trace(array, traits, ops, x, y, sx, sy, index) -> PanelRay

In the array frame (`inim.lens.array`), `(x, y)` is where the ray crosses the principal plane z = 0
and `(sx, sy)` how far it travels sideways per millimetre away from the viewer; `index` is the
material's refractive index for the ray's colour. What comes back is the ray at z = -gap, behind the
lens, and the share of light that gets through: 0 where nothing does. A ray may land under a
neighbour's elemental image; that is crosstalk, and stays. The arithmetic comes in as `ops`, so the
same code runs in float64 NumPy and in a Dr.Jit kernel.

One model is no function: `FULL` is the array as a mesh (`inim.lens.sheet_mesh`) that the renderer
traces rays through, the independent check of `thick`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from inim.display import Display
from inim.errors import UsageError
from inim.lens import pinhole, sheet_mesh, thick, thin
from inim.lens.array import NUMPY_OPS, LensArray, LensTraits, Ops, lens_array, lens_traits
from inim.lens.dispersion import channel_indices
from inim.lens.ray import PanelRay, to_array, to_panel

__all__ = [
    "FULL",
    "LENS_MODELS",
    "LensArray",
    "LensTraits",
    "channel_indices",
    "check_lens_model",
    "lens_array",
    "lens_traits",
    "through_array",
    "trace_to_panel",
    "white_exposure",
]

LensModel = Callable[[LensArray, LensTraits, Ops, Any, Any, Any, Any, Any], PanelRay]

LENS_MODELS: dict[str, LensModel] = {
    "pinhole": pinhole.trace,
    "thin": thin.trace,
    "thick": thick.trace,
}


#: The model that is a mesh; there is no tracing it here.
FULL = "full"


def through_array(
    model: str,
    array: LensArray,
    traits: LensTraits,
    ops: Ops,
    x: Any,
    y: Any,
    sx: Any,
    sy: Any,
    index: Any,
) -> tuple[Any, Any, Any]:
    """Panel point and weight of a display-frame ray that crosses z = 0 at (x, y)."""
    ray = LENS_MODELS[model](array, traits, ops, *to_array(array, traits, x, y, sx, sy), index)
    return to_panel(array, traits, ray)


def check_lens_model(name: str, display: Display) -> None:
    """Raise unless the model exists and the display's lenses can be what it describes.

    Raises
    ------
    UsageError
        Unknown model.
    DisplayError
        A prescription that cannot be ground or does not fit the gap.
    """
    if name not in (*LENS_MODELS, FULL):
        raise UsageError(f"lens model {name!r}: use {' or '.join((*LENS_MODELS, FULL))}")
    if name == "thick":
        thick.check(display)
    if name == FULL:
        sheet_mesh.check(display)


def white_exposure(display: Display, model: str) -> np.float32:
    """What a view is multiplied by so that the panel's white looks white on the axis.

    No viewer compares a display with its scene side by side: the loss at a lens's two faces is set
    right with the panel's brightness.
    """
    return np.float32(1 / thick.on_axis_transmittance(display) if model in ("thick", FULL) else 1.0)


def trace_to_panel(
    display: Display,
    model: str,
    x_mm: Any,
    y_mm: Any,
    slope_x: Any,
    slope_y: Any,
    *,
    index: float | None = None,
    dtype: type = np.float64,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Trace viewer's rays to the panel, in NumPy.

    Parameters
    ----------
    display : Display
    model : str
        A key of `LENS_MODELS`.
    x_mm, y_mm : (...) array
        Where the rays cross the array plane z = 0, display frame.
    slope_x, slope_y : (...) array
        Sideways travel per millimetre away from the viewer.
    index : float, optional
        Refractive index, where it is not the display's own.
    dtype : float type
        What to compute in.

    Returns
    -------
    panel_x_mm, panel_y_mm, weight : (...) arrays of `dtype`
    """
    if model == FULL:
        raise UsageError(f"lens model {FULL!r} is traced by the renderer only; use 'thick' here")
    check_lens_model(model, display)
    x, y, sx, sy = np.broadcast_arrays(
        *(np.asarray(value, dtype) for value in (x_mm, y_mm, slope_x, slope_y))
    )
    array = LensArray(*(dtype(value) for value in lens_array(display)))
    n = dtype(display.refractive_index if index is None else index)
    with np.errstate(invalid="ignore"):  # lanes of total reflection carry weight 0
        panel_x, panel_y, weight = through_array(
            model, array, lens_traits(display), NUMPY_OPS, x, y, sx, sy, n
        )
    return panel_x, panel_y, np.asarray(weight, dtype)
