"""A display's optics as the numbers that the script and its shader work with."""

from __future__ import annotations

from typing import Any

from inim.display import Display
from inim.lens import channel_indices, drawn_live, lens_array, lens_traits

__all__ = ["SKETCHED_LENS_MODELS", "drawn_as_none", "optics"]

#: The lens models that the shader knows.
SKETCHED_LENS_MODELS = drawn_live()


def optics(display: Display) -> dict[str, Any]:
    """Everything the live display needs of a `Display`, for JSON; lengths in millimetres.

    `traits` are names the shader is compiled with.

    Parameters
    ----------
    display : Display
        As its array really lies.
    """
    array, traits = lens_array(display), lens_traits(display)
    rows, columns = display.eia_shape
    indices = channel_indices(display)
    kinds = {
        "COLORED": len(set(indices)) > 1,
        "HEXAGONAL": traits.hexagonal,
        "APERTURE": not traits.full_aperture,
        "ROUND_APERTURE": traits.round_aperture,
        "CLEAR_BETWEEN": traits.clear_between,
        "TURNED": traits.turned,
        "TILTED": traits.tilted,
    }
    return {
        "size_mm": [display.width_mm, display.height_mm],
        "pitch_mm": [array.pitch_x, array.pitch_y],
        "lenses": [display.lens_columns, display.lens_rows],
        "gap_mm": array.gap,
        "elemental_pitch_mm": [display.elemental_image_pitch_mm, display.elemental_row_pitch_mm],
        "power_per_mm": [(n - 1) / array.radius for n in indices],
        "traits": [name for name, has in kinds.items() if has],
        "half_aperture_mm": array.half_aperture,
        "shift_mm": [array.shift_x, array.shift_y],
        "turn": [array.cosine, array.sine],
        "tilt": [array.tilt_x, array.tilt_y],
        "pixel_mm": display.pixel_pitch_mm,
        "panel": [columns, rows],
        "front_mm": max(display.depth_range_mm[1], 0.0),
    }


def drawn_as_none(display: Display) -> bool:
    """Whether the panel has sub-pixels or dark gaps, which the live display leaves out."""
    return display.subpixels != "none" or display.pixel_fill < 1
