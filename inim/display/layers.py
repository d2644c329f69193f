"""Layers between lenses and panel: cover glass, glue, air."""

import math
from collections.abc import Sequence

from inim.display.declaration import parse_rows
from inim.display.parameters import Layers

# Each layer costs the renderer and the virtual display a refraction per ray.
_MOST_LAYERS = 8
# Above diamond.
_LARGEST_INDEX = 3.0
_WRITE = "write thickness in mm and refractive index of each layer, such as '0.5 1.52, 0.1 1.47'"


def parse_layers(layers: str | Sequence[Sequence[float]]) -> Layers:
    """Layers as pairs of thickness and index.

    * `layers`: pairs, or text: ``"0.5 1.52, 0.1 1.47"``; ``"none"`` or empty: no layers.

    Raises `ValueError`: no such pairs, or layers that cannot exist.
    """
    try:
        numbers: Layers = parse_rows(layers, columns=2)
    except ValueError:
        raise ValueError(_WRITE) from None
    if len(numbers) > _MOST_LAYERS:
        raise ValueError(f"{len(numbers)} layers; at most {_MOST_LAYERS} are allowed")
    for thickness, index in numbers:
        if not (math.isfinite(thickness) and thickness > 0):
            raise ValueError(f"thickness {thickness:g} mm: must be a positive length")
        if not 1 <= index <= _LARGEST_INDEX:
            raise ValueError(f"refractive index {index:g}: must be from 1 to {_LARGEST_INDEX:g}")
    return numbers


def air_equivalent_mm(layers: Layers) -> float:
    """Thickness of air with the same paraxial effect: the sum of t / n."""
    return sum(thickness / index for thickness, index in layers)


def excess_mm(layers: Layers) -> float:
    """Sum of t - t / n: a measured gap exceeds the air-equivalent gap by this."""
    return sum(thickness for thickness, _ in layers) - air_equivalent_mm(layers)
