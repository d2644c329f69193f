"""Presets: displays by name."""

from __future__ import annotations

from inim.display.display import Display
from inim.display.looking_glass import TYPICAL

DISPLAYS = {
    "nominal": Display(
        pitch_mm=1.0,
        focal_length_mm=3.0,
        gap_mm=3.3,
        pixel_pitch_mm=1.0 / 17.0,
        lens_columns=64,
        lens_rows=64,
        name="nominal",
    ),
    # The paper's hardware: a 2400 x 1080 phone panel under 1 mm lenses, 15.7 pixels per lens.
    "phone": Display(
        pitch_mm=1.0,
        focal_length_mm=3.0,
        gap_mm=3.3,
        pixel_pitch_mm=0.0636,
        lens_columns=152,
        lens_rows=68,
        panel_columns=2400,
        panel_rows=1080,
        name="phone",
    ),
    **{name: values.display(name=name) for name, values in TYPICAL.items()},
}
