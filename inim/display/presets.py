"""Presets: displays by name."""

from inim.display.display import Display
from inim.display.looking_glass import TYPICAL
from inim.system.errors import suggest_words


class Presets(dict[str, Display]):
    """Displays by name."""

    def __missing__(self, name: object) -> Display:
        raise KeyError(f"no display {name!r}; {self.suggest(name)}")

    def suggest(self, name: object) -> str:
        """Remedy for an unknown name."""
        return suggest_words(name, self, most=2)


DISPLAYS = Presets({
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
    # For a first look, from a search: a panel like nominal's, finer lenses, and
    # elemental images that aim at 543 mm, where the head may move by 28 mm to either side.
    "fine": Display(
        pitch_mm=0.7164,
        elemental_pitch_mm=0.72,
        focal_length_mm=2.5,
        gap_mm=2.727,
        pixel_pitch_mm=0.06,
        lens_columns=90,
        lens_rows=90,
        depth_min_mm=0.0,
        depth_max_mm=30.0,
        name="fine",
    ),
    **{name: values.display(name=name) for name, values in TYPICAL.items()},
})  # fmt: skip
