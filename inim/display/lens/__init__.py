"""Lens models: the panel point that a viewer's ray through the lens array reaches.

A lens model is one file with one value, a `LensModel`, most of which is a pure function::

    trace(array, traits, ops, x, y, sx, sy, index) -> PanelRay

In the array frame (`inim.display.lens.array`), `(x, y)` is the ray's intersection with the
principal plane z = 0 and `(sx, sy)` its sideways travel per millimetre away from the viewer;
`index` is the material's refractive index for the ray's colour. The result is the ray at z = -gap,
behind the lens, and its share of transmitted light, 0 for a blocked ray. A ray may end under a
neighbour's elemental image; this crosstalk is kept. The arithmetic is passed as `ops`, so the same
code runs in float64 NumPy and in a Dr.Jit kernel. Other packages register models in the entry-point
group ``inim.lens_models``, under the model's name: docs/how-to/own-lens-model.md.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache, wraps
from typing import Any, Literal

import numpy as np

from inim.display import Display
from inim.display.lens import full, pinhole, thick, thin
from inim.display.lens.array import (
    NUMPY_OPS,
    LensArray,
    LensTraits,
    Ops,
    PanelRay,
    channel_indices,
    in_aperture,
    lens_array,
    lens_centre,
    lens_traits,
    pass_straight,
    to_array,
    to_panel,
)
from inim.display.lens.model import LensModel, SheetMesh, Trace
from inim.system.errors import UsageError, suggest_words
from inim.system.plugins import announced_names, attribute_errors, identity, load

__all__ = [
    "FULL",
    "LensArray",
    "LensModel",
    "LensModelName",
    "LensTraits",
    "Ops",
    "PanelRay",
    "SheetMesh",
    "channel_indices",
    "check_lens_model",
    "drawn_model",
    "foreign_identity",
    "in_aperture",
    "lens_array",
    "lens_centre",
    "lens_model",
    "lens_model_name",
    "lens_models",
    "lens_traits",
    "models_drawn_live",
    "pass_straight",
    "through_array",
    "trace_to_panel",
    "white_exposure",
]

#: Names of the built-in lens models.
LensModelName = Literal["pinhole", "thin", "thick", "full"]

_OWN = {model.name: model for model in (pinhole.MODEL, thin.MODEL, thick.MODEL, full.MODEL)}
_ENTRY_POINTS = "inim.lens_models"
#: The model that is a mesh.
FULL = full.MODEL.name


def lens_models() -> list[str]:
    """Names of all registered models: the built-in models, then those of other packages."""
    return [*_OWN, *(name for name in announced_names(_ENTRY_POINTS) if name not in _OWN)]


def lens_model_name(model: LensModelName | LensModel) -> str:
    """Name of a built-in or a registered lens model."""
    return model.name if isinstance(model, LensModel) else model


@cache
def lens_model(name: str) -> LensModel:
    """The model of a name.

    Raises `UsageError`: unknown, or another package's that cannot be loaded or is no `LensModel`.
    """
    if name in _OWN:
        return _OWN[name]
    if name not in lens_models():
        raise UsageError(f"lens model {name!r}: {suggest_words(name, lens_models())}")
    label, model = f"lens model {name!r}", load(_ENTRY_POINTS, name, "lens model")
    if not isinstance(model, LensModel):
        raise UsageError(
            f"{label} is a {type(model).__name__}; register an inim.display.lens.LensModel"
        )
    if model.name != name:
        raise UsageError(f"{label} has the name {model.name!r}; make the names equal")
    if model.stand_in not in _OWN:
        raise UsageError(f"{label}: its stand_in is {model.stand_in!r}; use {' or '.join(_OWN)}")
    return replace(
        model,
        trace=model.trace and _name_model_in_errors(name, _broadcast_result(model.trace)),
        mesh=model.mesh and _name_model_in_errors(name, model.mesh),
        check=_name_model_in_errors(name, model.check),
        transmittance=_name_model_in_errors(name, _check_transmittance(model.transmittance)),
    )


def _name_model_in_errors(name: str, function: Any) -> Any:
    """Return another package's function, with the model named in its errors."""

    @wraps(function)
    def attributed(*values: Any) -> Any:
        with attribute_errors(_ENTRY_POINTS, "lens model", name):
            return function(*values)

    return attributed


def _broadcast_result(trace: Trace) -> Trace:
    """Let a trace return one value for all rays, such as a constant weight."""

    def full_sized(
        array: LensArray, traits: LensTraits, ops: Ops, x: Any, y: Any, sx: Any, sy: Any, index: Any
    ) -> PanelRay:
        ray = trace(array, traits, ops, x, y, sx, sy, index)
        return PanelRay(*(value + 0.0 * x for value in ray))

    return full_sized


def _check_transmittance(transmittance: Callable[[Display], float]) -> Callable[[Display], float]:
    def checked(display: Display) -> float:
        share = float(transmittance(display))
        if not (math.isfinite(share) and share > 0):
            raise ValueError(f"its transmittance is {share:g}; return a share above 0")
        return share

    return checked


def foreign_identity(name: str) -> dict[str, str]:
    """Identity of another package's model, for cache keys; empty for inim's own."""
    return {} if name in _OWN else identity(_ENTRY_POINTS, name)


def models_drawn_live() -> list[str]:
    """Models that the shader of the virtual display draws itself."""
    return [name for name, model in _OWN.items() if model.stand_in == name]


def drawn_model(name: str) -> str:
    """Model in `models_drawn_live` that replaces another in the virtual display."""
    try:
        model = lens_model(name)
    except UsageError:
        return models_drawn_live()[-1]
    while model.stand_in != model.name:
        model = lens_model(model.stand_in)
    return model.name


def check_lens_model(name: str, display: Display) -> None:
    """Raise unless the model exists and the display's lenses are possible for it.

    Raises `UsageError`: unknown model. `DisplayError`: a prescription that cannot be ground or does
    not fit the gap.
    """
    lens_model(name).check(display)


def white_exposure(display: Display, name: str) -> np.float32:
    """Exposure factor of a view that makes the panel's white appear white on the axis.

    No viewer compares a display with its scene side by side: the loss at a lens's two faces is set
    right with the panel's brightness.
    """
    return np.float32(1 / lens_model(name).transmittance(display))


def through_array(
    trace: Trace,
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
    ray = trace(array, traits, ops, *to_array(array, traits, x, y, sx, sy), index)
    return to_panel(array, traits, ray)


def trace_to_panel(
    display: Display,
    name: str,
    x_mm: Any,
    y_mm: Any,
    slope_x: Any,
    slope_y: Any,
    *,
    index: float | None = None,
    dtype: type = np.float64,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Trace a viewer's rays to the panel, in NumPy.

    * `name`: one of `lens_models` that is not a mesh.
    * `x_mm`, `y_mm`, (...) array: intersections of the rays with the array plane z = 0, display
      frame.
    * `slope_x`, `slope_y`, (...) array: sideways travel per millimetre away from the viewer.
    * `index`: refractive index; default: the display's.
    * `dtype`, float type: type of the computation.

    Returns `panel_x_mm`, `panel_y_mm`, `weight`, (...) arrays of `dtype`.

    Raises `UsageError` or `DisplayError`: as for `check_lens_model`; or the model is a mesh.
    """
    model = lens_model(name)
    trace = model.traced_without_renderer()
    model.check(display)
    x, y, sx, sy = np.broadcast_arrays(
        *(np.asarray(value, dtype) for value in (x_mm, y_mm, slope_x, slope_y))
    )
    array = lens_array(display).convert(dtype)
    n = dtype(display.refractive_index if index is None else index)
    with np.errstate(invalid="ignore"):  # lanes of total reflection carry weight 0
        panel_x, panel_y, weight = through_array(
            trace, array, lens_traits(display), NUMPY_OPS, x, y, sx, sy, n
        )
    return panel_x, panel_y, np.asarray(weight, dtype)
