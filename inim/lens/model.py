"""What a lens model is: where rays go, and all that the rest of the program asks of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np

from inim.display import Display
from inim.errors import UsageError
from inim.lens.array import LensArray, LensTraits, Ops, PanelRay

#: (array, traits, ops, x, y, sx, sy, index) to the ray at the panel; see `inim.lens`.
Trace = Callable[[LensArray, LensTraits, Ops, Any, Any, Any, Any, Any], PanelRay]


@dataclass(frozen=True)
class SheetMesh:
    """A closed body, display frame, millimetres; faces run counter-clockwise seen from outside.

    Attributes
    ----------
    vertices, normals : (n, 3) float64
        Normals point outwards and are those of the exact surface.
    faces : (m, 3) uint32
    is_glass : (m,) bool
        Which faces refract; the others are the black mount.
    front_mm : float
        Largest z.
    flat_mm, rear_principal_mm : float
        z of the flat face, and of the rear principal plane.
    facet_error_mm : float
        How far, along z, facets depart from the curved face at most.
    """

    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    is_glass: np.ndarray
    front_mm: float
    flat_mm: float
    rear_principal_mm: float
    facet_error_mm: float


def _accept(display: Display) -> None:
    """Any display will do."""


def _lossless(display: Display) -> float:  # noqa: ARG001
    """All light gets through."""
    return 1.0


@dataclass(frozen=True)
class LensModel:
    """A lens model: a function `trace`, or a body `mesh` that the renderer traces rays through.

    Attributes
    ----------
    name : str
        As settings have it.
    summary : str
        One line.
    trace : callable, optional
        See `inim.lens`. It serves NumPy and the renderer, and tells in advance which panel pixels
        a view depends on.
    mesh : callable, optional
        From a `Display` to its lens array as a `SheetMesh`. Path traced: rays scatter between the
        lenses, and any panel pixel may be observed.
    check : callable
        Of a `Display`; raises `DisplayError` where its lenses cannot be what the model describes:
        a thick lens that cannot be ground.
    transmittance : callable
        From a `Display` to the share of the panel's light, above 0, that its lenses let through
        along the axis. Views are exposed by its inverse.
    refracts : bool
        Whether the material's index matters: only then are colours traced apart.
    stand_in : str
        The simpler model in its place where this one cannot be: in `inim inspect` if it is a mesh
        or, chosen by nobody, refuses the display; in the virtual display, which draws models that
        stand in for themselves.
    steepest_slope : float
        Sideways travel per millimetre of the steepest ray that it was measured safe for in float32.
    least_index : float
        Refractive index below which it loses its digits in float32.

    Raises
    ------
    UsageError
        Neither `trace` nor `mesh`, or both.
    """

    name: str
    _: KW_ONLY
    summary: str
    trace: Trace | None = None
    mesh: Callable[[Display], SheetMesh] | None = None
    check: Callable[[Display], None] = _accept
    transmittance: Callable[[Display], float] = _lossless
    refracts: bool = True
    stand_in: str = "thin"
    steepest_slope: float = math.inf
    least_index: float = 1.0

    def __post_init__(self) -> None:
        if callable(self.trace) == callable(self.mesh):
            raise UsageError(f"lens model {self.name!r}: give it a function, trace, or a mesh")

    @property
    def function(self) -> Trace:
        """`trace`.

        Raises
        ------
        UsageError
            The model is a mesh.
        """
        if self.trace is None:
            raise UsageError(
                f"lens model {self.name!r} is traced by the renderer only; use "
                f"{self.stand_in!r} here"
            )
        return self.trace
