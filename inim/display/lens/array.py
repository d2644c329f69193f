"""Lens array as numbers, rays through it, and the arithmetic of lens models.

Lens models work in the *array frame*: the display frame, moved to the array's centre and rotated
with it. Kinds of lens and layout are Python values (`LensTraits`): features that a display lacks
are not compiled. Lengths may be Dr.Jit scalars (`LensArray`): changing one needs no new
compilation.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from inim.display import Display
from inim.display.layers import air_equivalent_mm
from inim.display.layouts import NUMPY_OPS, Layout, Ops

__all__ = [
    "CHANNEL_WAVELENGTHS_NM",
    "NUMPY_OPS",
    "LensArray",
    "LensTraits",
    "Ops",
    "PanelRay",
    "channel_indices",
    "in_aperture",
    "lens_array",
    "lens_centre",
    "lens_traits",
    "pass_straight",
    "to_array",
    "to_panel",
]


# Air that is thinner, shorter than two wavelengths, is contact: no lens sheet is measured better.
_CONTACT_MM = 1e-3


class LensTraits(NamedTuple):
    """Kind of lenses of a display: Python values, fixed when a kernel is compiled.

    `touching`: the layers behind the lenses begin without air.
    """

    layout: type[Layout]
    round_aperture: bool
    full_aperture: bool
    clear_between: bool
    bulges_to_viewer: bool
    conic: bool
    asphere: bool
    turned: bool
    tilted: bool
    touching: bool = False


class LensArray(NamedTuple):
    """Numbers of a `Display` for lens models; each value may be a float or a Dr.Jit scalar.

    Lengths in millimetres.

    Attributes
    ----------
    pitch_x, pitch_y :
        Distance of neighbours in a row; distance of rows.
    half_columns, half_rows :
        N / 2 and M / 2.
    gap, focal_length :
        g and f.
    radius, thickness :
    design_index :
        Refractive index of the design, which determines the principal planes for all colours.
    conic, a4, a6 :
    half_aperture :
        Half the aperture's width.
    shift_x, shift_y, cosine, sine :
        Shift and rotation of the array over the panel.
    tilt_x, tilt_y :
        Growth of the gap per millimetre.
    layers : tuple of (thickness, index)
        Layers in the gap, from the lenses on.
    """

    pitch_x: Any
    pitch_y: Any
    half_columns: Any
    half_rows: Any
    gap: Any
    focal_length: Any
    radius: Any
    thickness: Any
    design_index: Any
    conic: Any
    a4: Any
    a6: Any
    half_aperture: Any
    shift_x: Any
    shift_y: Any
    cosine: Any
    sine: Any
    tilt_x: Any
    tilt_y: Any
    layers: tuple[tuple[Any, Any], ...] = ()

    def convert(self, number: Callable[[float], Any]) -> LensArray:
        """Copy with all numbers converted, such as to Dr.Jit scalars."""
        values = {key: number(value) for key, value in self._asdict().items() if key != "layers"}
        layers = tuple((number(thickness), number(index)) for thickness, index in self.layers)
        return LensArray(**values, layers=layers)


def lens_traits(display: Display) -> LensTraits:
    """The kind of a display's lenses."""
    return LensTraits(
        layout=type(display.layout),
        round_aperture=display.aperture == "round",
        full_aperture=display.aperture == "square" and display.fill_factor == 1,
        clear_between=display.between_lenses == "clear",
        bulges_to_viewer=display.curved_side == "viewer",
        conic=display.conic != 0,
        asphere=display.asphere_a4 != 0 or display.asphere_a6 != 0,
        turned=bool(display.rotation_deg or display.shift_x_mm or display.shift_y_mm),
        tilted=bool(display.tilt_x_deg or display.tilt_y_deg),
        touching=bool(display.layers) and abs(air_mm(display)) < _CONTACT_MM,
    )


def air_mm(display: Display) -> float:
    """Air between a thick lens and the layers; negative if they do not fit into the gap.

    It begins at the flat face, or at the vertex of a face that bulges towards the panel.
    """
    thickness = display.lens_thickness_mm or display.pitch_mm
    inside = thickness / display.refractive_index if display.curved_side == "viewer" else 0.0
    return display.gap_mm - inside - air_equivalent_mm(display.layers)


def lens_array(display: Display) -> LensArray:
    """The numbers of a display's lens array; radius R = f (n - 1) of a plano-convex lens."""
    thickness = display.lens_thickness_mm
    angle, (rows, columns) = math.radians(display.rotation_deg), display.layout.grid
    return LensArray(
        pitch_x=display.pitch_mm,
        pitch_y=display.row_pitch_mm,
        half_columns=columns / 2,
        half_rows=rows / 2,
        gap=display.gap_mm,
        focal_length=display.focal_length_mm,
        radius=display.focal_length_mm * (display.refractive_index - 1),
        thickness=display.pitch_mm if thickness is None else thickness,
        design_index=display.refractive_index,
        conic=display.conic,
        a4=display.asphere_a4,
        a6=display.asphere_a6,
        half_aperture=display.fill_factor * display.pitch_mm / 2,
        shift_x=display.shift_x_mm,
        shift_y=display.shift_y_mm,
        cosine=math.cos(angle),
        sine=math.sin(angle),
        tilt_x=display.tilt_slopes[0],
        tilt_y=display.tilt_slopes[1],
        layers=display.layers,
    )


def lens_centre(
    array: LensArray, traits: LensTraits, ops: Ops, x: Any, y: Any
) -> tuple[Any, Any, Any]:
    """Centre of the lens whose cell holds (x, y), and whether the array reaches that far.

    Array frame; see `inim.display.layouts`.
    """
    return traits.layout.lens_centre(array, ops, x, y)


def in_aperture(array: LensArray, traits: LensTraits, dx: Any, dy: Any) -> Any:
    """True if a point, given relative to the lens's centre, is in the lens's aperture."""
    if traits.layout.of_cylinders:
        return (dx <= array.half_aperture) & (dx >= -array.half_aperture)
    if traits.round_aperture:
        return dx * dx + dy * dy <= array.half_aperture * array.half_aperture
    half_y = array.half_aperture * (array.pitch_y / array.pitch_x)
    return (
        (dx <= array.half_aperture)
        & (dx >= -array.half_aperture)
        & (dy <= half_y)
        & (dy >= -half_y)
    )


class PanelRay(NamedTuple):
    """Ray at the plane z = -gap: its position, its slopes, and its share of light.

    `x`, `y` in millimetres; `sx`, `sy` sideways travel per millimetre away from the viewer;
    `weight` the share of light that gets through, 0 where none does.
    """

    x: Any
    y: Any
    sx: Any
    sy: Any
    weight: Any


def pass_straight(
    array: LensArray,
    traits: LensTraits,
    ops: Ops,
    ray: PanelRay,
    within: Any,
    inside: Any,
    arriving: tuple[Any, Any, Any, Any],
    clear_weight: Any,
) -> PanelRay:
    """Ray of a lens inside its aperture; outside it, the ray past the lens or a blocked ray.

    Parameters
    ----------
    ray : PanelRay
        Ray through the lens.
    within, inside : bool
        Masks of rays in the aperture and on the array.
    arriving : (x, y, sx, sy)
        Undeviated ray past the lens, from the plane z = 0.
    clear_weight :
        Transmittance of the bare sheet.
    """
    if traits.full_aperture:
        return ray
    if not traits.clear_between:
        return ray._replace(weight=ops.where(within, ray.weight, 0.0))
    x, y, sx, sy = arriving
    past = PanelRay(
        x + array.gap * sx, y + array.gap * sy, sx, sy, ops.where(inside, clear_weight, 0.0)
    )
    return PanelRay(*(ops.where(within, a, b) for a, b in zip(ray, past, strict=True)))


def to_array(
    array: LensArray, traits: LensTraits, x: Any, y: Any, sx: Any, sy: Any
) -> tuple[Any, Any, Any, Any]:
    """A ray of the display frame in the array frame."""
    if not traits.turned:
        return x, y, sx, sy
    c, s = array.cosine, array.sine
    x, y = x - array.shift_x, y - array.shift_y
    return c * x + s * y, c * y - s * x, c * sx + s * sy, c * sy - s * sx


def to_panel(array: LensArray, traits: LensTraits, ray: PanelRay) -> tuple[Any, Any, Any]:
    """Panel point (display frame) and weight of a ray of the array frame; the panel may tilt."""
    x, y, sx, sy, weight = ray
    if traits.turned:
        c, s = array.cosine, array.sine
        x, y = c * x - s * y + array.shift_x, c * y + s * x + array.shift_y
        sx, sy = c * sx - s * sy, c * sy + s * sx
    if traits.tilted:
        # The panel lies tilt . (x, y) behind z = -gap; the ray needs that much more travel.
        farther = (array.tilt_x * x + array.tilt_y * y) / (
            1.0 - array.tilt_x * sx - array.tilt_y * sy
        )
        x, y = x + sx * farther, y + sy * farther
    return x, y, weight


#: Dominant wavelengths of the sRGB primaries under D65: red, green, blue.
CHANNEL_WAVELENGTHS_NM = (611.4, 549.1, 464.2)
# Fraunhofer's lines that the Abbe number V = (n_d - 1) / (n_F - n_C) is defined by.
_BLUE_F_NM, _YELLOW_D_NM, _RED_C_NM = 486.13, 587.56, 656.27


def channel_indices(display: Display) -> tuple[float, float, float]:
    """Index for red, green and blue, by Cauchy's n = A + B / wavelength^2.

    The display's `refractive_index` is the one of the d line, and its focal length too; without an
    Abbe number all three are equal to it.
    """
    n = display.refractive_index
    if display.abbe_number is None:
        return n, n, n
    slope = (n - 1) / display.abbe_number / (_BLUE_F_NM**-2 - _RED_C_NM**-2)
    red, green, blue = (
        n + slope * (wavelength**-2 - _YELLOW_D_NM**-2) for wavelength in CHANNEL_WAVELENGTHS_NM
    )
    return red, green, blue
