"""The ray that leaves a lens for the panel, and what happens to one that misses the lens."""

from __future__ import annotations

from typing import Any, NamedTuple

from inim.lens.array import LensArray, LensTraits, Ops

__all__ = ["PanelRay", "pass_straight", "to_array", "to_panel"]


class PanelRay(NamedTuple):
    """Where a ray meets the plane z = -gap, its direction there, and the light it carries.

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
    """A lens's ray where it met the aperture; beside it, the ray past the lens or nothing.

    Parameters
    ----------
    ray : PanelRay
        Through the lens.
    within, inside : bool
        In the aperture; on the array.
    arriving : (x, y, sx, sy)
        The ray as it would go on past the lens, from the plane z = 0.
    clear_weight :
        What the bare sheet lets through.
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
