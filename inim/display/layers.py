"""Layers between lenses and panel: cover glass, glue, air."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from inim.display.parameters import Layers
from inim.errors import DisplayError

#: Text of no layers.
NO_LAYERS = "none"
# Each layer costs the renderer and the virtual display a refraction per ray.
_MOST_LAYERS = 8
# Above diamond.
_LARGEST_INDEX = 3.0
_WRITE = "write thickness in mm and refractive index of each layer, such as '0.5 1.52, 0.1 1.47'"


def parse_layers(layers: str | Sequence[Sequence[float]]) -> Layers:
    """Layers as pairs of thickness and index.

    * `layers`: pairs, or text: ``"0.5 1.52, 0.1 1.47"``; ``"none"`` or empty: no layers.

    Raises `DisplayError`: no such pairs, or layers that cannot exist.
    """
    pairs: Any = layers
    if isinstance(layers, str):
        text = "" if layers.strip() == NO_LAYERS else layers
        pairs = [part.split() for part in text.split(",") if part.strip()]
    try:
        numbers = tuple((float(thickness), float(index)) for thickness, index in pairs)
    except (TypeError, ValueError):
        raise DisplayError(f"layers = {layers!r}: {_WRITE}") from None
    if len(numbers) > _MOST_LAYERS:
        raise DisplayError(f"layers: {len(numbers)} layers; at most {_MOST_LAYERS} are allowed")
    for thickness, index in numbers:
        if not (math.isfinite(thickness) and thickness > 0):
            raise DisplayError(f"layers: thickness {thickness:g} mm: must be a positive length")
        if not 1 <= index <= _LARGEST_INDEX:
            raise DisplayError(
                f"layers: refractive index {index:g}: must be from 1 to {_LARGEST_INDEX:g}"
            )
    return numbers


def layers_text(layers: Layers) -> str:
    """Text of layers, as `parse_layers` reads it."""
    return ", ".join(f"{thickness!r} {index!r}" for thickness, index in layers) or NO_LAYERS


def air_equivalent_mm(layers: Layers) -> float:
    """Thickness of air with the same paraxial effect: the sum of t / n."""
    return sum(thickness / index for thickness, index in layers)


def excess_mm(layers: Layers) -> float:
    """Sum of t - t / n: a measured gap exceeds the air-equivalent gap by this."""
    return sum(thickness for thickness, _ in layers) - air_equivalent_mm(layers)
