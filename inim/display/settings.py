"""The `inim.*` settings of a scene file, in one table: name, type, default, meaning.

They travel as ``<default name="inim.KEY" value="..."/>`` elements, which Mitsuba accepts and
ignores, and are overridden by ``-D inim.KEY=VALUE``. Text in, a checked `Settings` out. A display
file is XML with only those of a display.
"""

from __future__ import annotations

import math
import re
from collections.abc import Container, Mapping
from dataclasses import dataclass, field, fields, replace
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import Any

from inim.display import DISPLAYS, Display
from inim.display.display import TABLES
from inim.display.looking_glass import LookingGlass
from inim.display.parameters import rows_text
from inim.system.errors import DisplayError, SceneError, UsageError, suggest_words
from inim.system.process.atomic_file import write_atomically

PREFIX = "inim."
#: Text of an optional number that is not set, whatever the scene states.
NOT_SET = "none"

# Far above any sensible length, count or seed, and far below where arithmetic overflows.
_LARGEST = 1e18
# Whole numbers below this are written without a decimal point: counts are read as whole numbers.
_EXACT = 1e15
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+")
# More samples than this per pixel is a slip of the keyboard that would run for days.
_MOST_SAMPLES = 2**20

#: Settings that go to `Display` under the same name.
DISPLAY_KEYS = tuple(f.name for f in fields(Display) if f.name != "name")


def value_text(name: str, value: object, *, label: str = "") -> str:
    """Text of a setting's or an option's value, read back as the same value.

    * `label`: the value's place, for error messages; default: `name`.

    Raises `UsageError` for anything but text, numbers, paths, and the rows of a `TABLES` entry.
    """
    table = TABLES.get(name.removeprefix(PREFIX))
    if isinstance(value, list | tuple) and table is not None:
        return rows_text(table(value))
    if isinstance(value, bool) or not isinstance(value, str | Real | PathLike):
        raise UsageError(
            f"{label or name}: {value!r} is a {type(value).__name__}; give text or a number"
        )
    if not isinstance(value, Real):
        return str(value)
    number = float(value)
    return str(int(number)) if number.is_integer() and abs(number) < _EXACT else repr(number)


def plain_parameters(display: Display) -> dict[str, Any]:
    """A display's parameters as text and numbers, without its name and those that are not set.

    The plugins of Mitsuba scenes and a study's `[[display]]` take them so.
    """
    values = {key: getattr(display, key) for key in DISPLAY_KEYS}
    return {
        key: value_text(key, value) if isinstance(value, tuple) else value
        for key, value in values.items()
        if value is not None
    }


def _setting(
    default: Any, meaning: str, *, low: float | None = None, high: float = math.inf
) -> Any:
    return field(default=default, metadata={"meaning": meaning, "low": low, "high": high})


@dataclass(frozen=True)
class Settings:
    """Settings of display, viewer, sampling and criteria, from a scene file or the command line.

    Every field is one `inim.*` key; None means "not given".
    """

    title: str = _setting("", "name of the scene in reports; the file's name if empty")
    display: str = _setting("nominal", f"preset to start from: {', '.join(DISPLAYS)}")
    pitch_mm: float | None = _setting(None, "lens pitch P")
    focal_length_mm: float | None = _setting(None, "lens focal length f")
    gap_mm: float | None = _setting(
        None, "gap g between lens array and panel, air-equivalent: a layer counts as t / n"
    )
    pixel_pitch_mm: float | None = _setting(None, "panel pixel P_D")
    lens_columns: int | None = _setting(None, "lenses across")
    lens_rows: int | None = _setting(None, "lenses down")
    panel_columns: int | None = _setting(None, "panel pixels across")
    panel_rows: int | None = _setting(None, "panel pixels down")
    depth_min_mm: float | None = _setting(None, "far end of the depth range (both or neither)")
    depth_max_mm: float | None = _setting(None, "near end of the depth range")
    elemental_pitch_mm: float | None = _setting(
        None, "pitch of the elemental images, if it differs from P"
    )
    refractive_index: float | None = _setting(
        None, "refractive index of the thick lens (1.4917, PMMA)"
    )
    lens_thickness_mm: float | None = _setting(None, "centre thickness of the thick lens (P)")
    curved_side: str | None = _setting(None, "curved side of the thick lens: viewer or panel")
    conic: float | None = _setting(None, "conic constant of the curved face (0)")
    asphere_a4: float | None = _setting(None, "sag term in r^4 of the curved face, mm^-3 (0)")
    asphere_a6: float | None = _setting(None, "sag term in r^6 of the curved face, mm^-5 (0)")
    abbe_number: float | None = _setting(
        None, "Abbe number of the lens material; none: no dispersion"
    )
    pitch_y_mm: float | None = _setting(
        None, "pitch of the lens rows (P, or that of the hexagonal lattice)"
    )
    lattice: str | None = _setting(
        None, "lens lattice: square, hexagonal, or lenticular for slanted cylinders (square)"
    )
    aperture: str | None = _setting(None, "shape of a lens's aperture: square or round (square)")
    fill_factor: float | None = _setting(None, "width of a lens's aperture, in pitches (1)")
    between_lenses: str | None = _setting(None, "sheet between the apertures: dark or clear (dark)")
    layers: str | None = _setting(
        None,
        "layers in the gap, from the lenses on, thickness in mm and index: '0.5 1.52, 0.1 1.47' "
        "(none)",
    )
    shift_x_mm: float | None = _setting(None, "shift of the array to the right (0)")
    shift_y_mm: float | None = _setting(None, "shift of the array upwards (0)")
    rotation_deg: float | None = _setting(
        None, "counter-clockwise rotation of the array, seen by the viewer (0)"
    )
    tilt_x_deg: float | None = _setting(None, "tilt of the panel: the gap grows to the right (0)")
    tilt_y_deg: float | None = _setting(None, "tilt of the panel: the gap grows upwards (0)")
    subpixels: str | None = _setting(
        None, "sub-pixel layout: none, rgb-stripe, pentile or cells (none)"
    )
    subpixel_cells: str | None = _setting(
        None,
        "centres of red, green and blue for `cells`, right and up in pixels, of each kind of "
        "pixel: '-0.3 0.25 0.3 0.25 0 -0.25, ...' (none)",
    )
    cell_pattern: str | None = _setting(
        None,
        "kinds of pixels for `cells`: single, checkerboard, columns, rows, rows-of-4 or staggered "
        "(single)",
    )
    pixel_fill: float | None = _setting(
        None, "width of the light-emitting area of a (sub-)pixel, in its pitches (1)"
    )
    black_level: float | None = _setting(None, "luminance of the panel's black over white (0)")
    ambient_reflection: float | None = _setting(
        None, "room light that the display reflects, as a share of white (0)"
    )
    veiling_glare: float | None = _setting(
        None, "share of a view's light that spreads evenly over it (0)"
    )
    white_point_k: float | None = _setting(
        None, "colour temperature of the panel's white, kelvin (D65)"
    )
    misalign: str = _setting(
        "", "misalignment that the algorithms do not correct: 'rotation_deg=0.5, gap_mm=0.1'"
    )
    fit_share: float = _setting(
        0.85, "share of the array that the relic may fill, 0..1", low=1e-6, high=1
    )
    turn_deg: float | None = _setting(
        None,
        "turn of the relic about its upward axis, counter-clockwise seen from above; its size is "
        "then the same at all turns (none: not turned)",
    )
    lens_model: str = _setting(
        "thick", "lens model of the reconstruction: pinhole, thin, thick or full"
    )
    algorithms: str = _setting(
        "wang2024,template", "algorithms to score, separated by commas (lenticulars: template)"
    )
    cameras: str = _setting(
        "",
        "arrangements of cameras for further RGB-D inputs: `5` (centre and corners of the viewing "
        "zone) or a grid such as `3x3`, separated by commas",
    )
    viewpoints: str = _setting(
        "centre,left,right,up,down",
        "viewpoints to score: names, or 'name=x y [z]' in mm, separated by commas (lenticulars: "
        "centre, left, right)",
    )
    viewing_distance_mm: float | None = _setting(
        None, "eye distance (twice the nearest usable distance)", low=1e-9
    )
    pupil_mm: float = _setting(0.0, "diameter of the eye's pupil; 0 is a pinhole", low=0)
    focus_mm: float | None = _setting(
        None, "focus distance of the eye (the distance of the central depth plane)", low=1e-9
    )
    luminance_cd_m2: float = _setting(
        500.0, "luminance of the panel's white, for perceptual metrics", low=1e-3
    )
    view_pixels_per_lens: int = _setting(4, "pixels per lens of the views (lenticulars: 1)", low=1)
    capture_pixels_per_pitch: int | float = _setting(
        5,
        "RGB-D pixels per lens pitch (lenticulars: 3); P / P_I is the resolution of the paper",
        low=1,
    )
    capture_spp: int = _setting(
        64, "samples per RGB-D pixel (lenticulars: 16)", low=1, high=_MOST_SAMPLES
    )
    eia_spp: int = _setting(
        32,
        "samples per ground-truth EIA pixel, both passes (lenticulars: 8)",
        low=2,
        high=_MOST_SAMPLES,
    )
    view_spp: int = _setting(
        64, "samples per ground-truth view pixel, both passes", low=2, high=_MOST_SAMPLES
    )
    reconstruction_spp: int = _setting(
        64, "samples per reconstructed view pixel", low=1, high=_MOST_SAMPLES
    )
    score_error: float = _setting(
        0.0,
        "stop sampling when every SSIM has this precision, such as 0.01; 0: use all samples",
        low=0,
        high=1,
    )
    seed: int = _setting(0, "random seed of the ground truth", low=0)
    min_ssim_to_reference: str = _setting(
        "",
        "criterion: minimum SSIM on the relic to the reference, '0.9' for all or "
        "'template:0.9, wang2024:0.5'",
    )

    @classmethod
    def field_meanings(cls) -> dict[str, str]:
        """Meanings of the settings, by name."""
        return {f.name: f.metadata["meaning"] for f in fields(cls)}

    @classmethod
    def parse(cls, values: Mapping[str, str], source: str) -> Settings:
        """Settings from texts by full key (`inim.pitch_mm`).

        `source` is the scene's path, for messages. Raises `SceneError` for an unknown key, with the
        nearest known one, or a value of the wrong kind.
        """
        fields_by_name = {f.name: f for f in fields(cls)}
        parsed: dict[str, Any] = {}
        for key, text in values.items():
            name = key.removeprefix(PREFIX)
            if name not in fields_by_name:
                hint = suggest_words(name, fields_by_name, "see `inim info settings`", PREFIX)
                raise SceneError(f"{source}: unknown setting {key!r}; {hint}")
            kind = str(fields_by_name[name].type)
            if text.strip() == NOT_SET and "None" in kind and not kind.startswith("str"):
                continue
            parsed[name] = _read(key, text, kind, source)
            low = fields_by_name[name].metadata["low"]
            if low is not None and parsed[name] < low:
                raise SceneError(f"{source}: {key} = {text}: must be at least {low:g}")
            high = fields_by_name[name].metadata["high"]
            if high < math.inf and parsed[name] > high:
                raise SceneError(f"{source}: {key} = {text}: must be at most {high:.7g}")
        return cls(**parsed)

    def make_display(self, source: str) -> Display:
        """The display that these settings describe: the preset with the given values changed.

        Raises `SceneError` for an unknown preset, and `DisplayError` for an impossible display.
        """
        if self.display not in DISPLAYS:
            way_out = suggest_words(self.display, DISPLAYS)
            if self.display.lower().endswith(".xml"):
                way_out = f"name a file with --display: --display {self.display}"
            raise SceneError(
                f"{source}: {PREFIX}display = {self.display!r}: no such preset; {way_out}"
            )
        preset = DISPLAYS[self.display]
        parameters = {
            key: getattr(self, key) for key in DISPLAY_KEYS if getattr(self, key) is not None
        }
        if not parameters:
            return preset
        covered = preset.layout.of_cylinders and "lattice" not in parameters
        if not (covered or {"panel_columns", "panel_rows"} & parameters.keys()) and (
            parameters.keys() & {"pitch_mm", "pixel_pitch_mm", "lens_columns", "lens_rows"}
        ):
            # The preset's panel belongs to the preset's array; a changed array gets its own.
            parameters |= {"panel_columns": None, "panel_rows": None}
        try:
            display = preset.replace(name=f"{preset.name}, changed", **parameters)
            # A panel that is given without its lenses has as many as fit on it.
            counted: dict[str, Any] = {
                f"lens_{axis}": lenses
                for axis, lenses in zip(("rows", "columns"), display.lenses_on_panel, strict=True)
                if parameters.get(f"panel_{axis}") and f"lens_{axis}" not in parameters
            }
            return display.replace(**counted) if counted and not covered else display
        except DisplayError as error:
            raise DisplayError(f"{source}: {error}") from None

    def with_display(self, display: Display, overridden: Container[str] = ()) -> Settings:
        """A copy that describes this display: a preset, and the parameters that differ from it.

        The copy includes `overridden` parameters although they are the preset's: a scene sets
        another value.
        """
        ways = []
        for name, preset in DISPLAYS.items():
            differing = [
                key
                for key in DISPLAY_KEYS
                if key in overridden or getattr(display, key) != getattr(preset, key)
            ]
            ways += [(name, differing), (name, DISPLAY_KEYS)]
        values: dict[str, Any]
        for name, keys in sorted(ways, key=lambda way: len(way[1])):
            values = {key: getattr(display, key) if key in keys else None for key in DISPLAY_KEYS}
            settings = replace(self, display=name, **values)
            if settings.make_display("").replace(name=display.name) == display:
                return settings
        raise AssertionError("all parameters of a display state it")

    def with_defaults_of(self, display: Display, explicit: Container[str]) -> Settings:
        """A copy with the defaults of the display's layout (`Layout.default_settings`).

        * `explicit`: full keys of settings that keep their values.
        """
        defaults = display.layout.default_settings.items()
        values: dict[str, Any] = {k: v for k, v in defaults if f"{PREFIX}{k}" not in explicit}
        return replace(self, **values)

    def ssim_limits(self, algorithms: tuple[str, ...], source: str) -> dict[str, float]:
        """Smallest SSIM to the reference that passes, by algorithm; without those that have no
        limit.

        Raises `SceneError` for a limit outside 0..1, or for an algorithm that is not run.
        """
        limits: dict[str, float] = {}
        for item in filter(None, (part.strip() for part in self.min_ssim_to_reference.split(","))):
            name, colon, text = item.rpartition(":")
            names = (name.strip(),) if colon else algorithms
            key = f"{PREFIX}min_ssim_to_reference"
            limit = _read(key, text.strip(), "float", source)
            if not 0 <= limit <= 1:
                raise SceneError(f"{source}: {key} = {item!r}: must be in 0..1")
            for name in names:
                if name not in algorithms:
                    raise SceneError(
                        f"{source}: {key} names {name!r}, which is not among the algorithms run "
                        f"({', '.join(algorithms)})"
                    )
                if name in limits:
                    raise SceneError(f"{source}: {key} limits {name!r} twice; keep one limit")
                limits[name] = limit
        return limits


def _read(key: str, text: str, kind: str, source: str) -> Any:
    """Parse the text of a value by the field's annotation."""
    if kind.startswith("str"):
        return text.strip()
    whole = kind.startswith("int") and "float" not in kind
    try:
        value = int(text) if whole else float(text)
    except ValueError:
        requirement = "a whole number" if whole else "a number"
        if not whole and _DECIMAL_COMMA.fullmatch(text.strip()):
            requirement += f"; write {text.strip().replace(',', '.')}"
        raise SceneError(f"{source}: {key} = {text[:40]!r}: must be {requirement}") from None
    if not abs(value) < _LARGEST:
        raise SceneError(f"{source}: {key} = {text[:40]!r}: must be finite and below {_LARGEST:g}")
    # Also where decimals are allowed, a whole number becomes an int.
    return int(value) if kind.startswith("int") and value == int(value) else value


def setting_table() -> str:
    """The table of settings as Markdown, for the documents and `inim info settings`."""
    rows = ["| key | default | meaning |", "| --- | --- | --- |"]
    for f in fields(Settings):
        default = "preset" if f.default is None and f.name in DISPLAY_KEYS else f.default
        default_text = "" if default in (None, "") else f"`{default}`"
        rows.append(f"| `{PREFIX}{f.name}` | {default_text} | {f.metadata['meaning']} |")
    return "\n".join(rows)


def display_texts(display: Display) -> dict[str, str]:
    """Settings of a display by full key: the nearest preset, and the parameters that differ."""
    settings = Settings().with_display(display)
    values = {key: getattr(settings, key) for key in ("display", *DISPLAY_KEYS)}
    return {f"{PREFIX}{k}": value_text(k, v) for k, v in values.items() if v is not None}


def save_display(display: Display, path: Path) -> None:
    """Write a display file, or the calibration file of a Looking Glass (.json)."""
    if path.suffix.lower() == ".json":
        text = LookingGlass.of(display).text()
    elif path.suffix.lower() == ".xml":
        lines = [
            f'    <default name="{key}" value="{value}"/>'
            for key, value in display_texts(display).items()
        ]
        text = "\n".join(['<scene version="3.0.0">', *lines, "</scene>\n"])
    else:
        raise UsageError(f"{path}: a display file is an .xml; name it {path.stem}.xml")
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
