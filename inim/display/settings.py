"""The `inim.*` settings of a scene file, in one table: name, type, default, meaning.

They travel as ``<default name="inim.KEY" value="..."/>`` elements, which Mitsuba accepts and
ignores, and are overridden by ``-D inim.KEY=VALUE``. Text in, a checked `Settings` out. A display
file is XML with only those of a display.
"""

from __future__ import annotations

import math
from collections.abc import Container, Mapping
from dataclasses import dataclass, make_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from inim.display import DISPLAYS, Display
from inim.display.declaration import Values, declared, meanings, setting_text
from inim.display.looking_glass import LookingGlass
from inim.system.errors import DisplayError, SceneError, UsageError, suggest_words
from inim.system.process.atomic_file import write_atomically

PREFIX = "inim."
# More samples than this per pixel is a slip of the keyboard that would run for days.
_MOST_SAMPLES = 2**20
# Characters of a value in a message.
_LONGEST_SHOWN = 40

#: Declarations of the settings that go to `Display` under the same name.
_OF_DISPLAY = {name: field for name, field in declared(Display).items() if name != "name"}
#: Their names, and those with the preset.
DISPLAY_KEYS = tuple(_OF_DISPLAY)
DISPLAY_PART = ("display", *DISPLAY_KEYS)


def plain_parameters(display: Display) -> dict[str, Any]:
    """A display's parameters as text and numbers, without its name and those that are not set.

    The plugins of Mitsuba scenes and a study's `[[display]]` take them so.
    """
    values = {key: getattr(display, key) for key in DISPLAY_KEYS}
    return {
        key: setting_text(value) if isinstance(value, tuple) else value
        for key, value in values.items()
        if value is not None
    }


@dataclass(frozen=True)
class _Start:
    title: str = ""  #: name of the scene in reports; the file's name if empty
    display: str = "nominal"


if TYPE_CHECKING:
    _Stated = _Start
else:
    # Each parameter of a display; None: that of the preset.
    _Stated = make_dataclass(
        "_Stated",
        [(name, field.type | None, None) for name, field in _OF_DISPLAY.items()],
        bases=(_Start,),
        frozen=True,
    )


@dataclass(frozen=True)
class Placement:
    """Part of a scene that a display shows, and its place; see the settings of the same names."""

    fit_share: float
    turn_deg: float | None = None
    relic: str = ""


@dataclass(frozen=True)
class Settings(_Stated):
    """Settings of display, viewer, sampling and criteria, from a scene file or the command line.

    Every field is one `inim.*` key; None means "not given".
    """

    #: misalignment that the algorithms do not correct: 'rotation_deg=0.5, gap_mm=0.1'
    misalign: str = ""
    #: share of the array that the relic may fill, 0..1
    fit_share: Annotated[float, Values(low=1e-6, high=1)] = 0.85
    #: turn of the relic about its upward axis, counter-clockwise seen from above; its size is then
    #: the same at all turns (none: not turned)
    turn_deg: float | None = None
    #: shapes that form the relic, by their ids or the names of their files, separated by commas;
    #: the others are left out (all, or what the scene's camera shows if that is far smaller)
    relic: str = ""
    lens_model: str = "thick"  #: lens model of the reconstruction: pinhole, thin, thick or full
    #: algorithms to score, separated by commas (lenticulars: template)
    algorithms: str = "wang2024,template"
    #: arrangements of cameras for further RGB-D inputs: `5` (centre and corners of the viewing
    #: zone) or a grid such as `3x3`, separated by commas
    cameras: str = ""
    #: viewpoints to score: names, or 'name=x y [z]' in mm, separated by commas (lenticulars:
    #: centre, left, right)
    viewpoints: str = "centre,left,right,up,down"
    #: eye distance (twice the nearest usable distance)
    viewing_distance_mm: Annotated[float, Values(low=1e-9)] | None = None
    pupil_mm: Annotated[float, Values(low=0)] = 0.0  #: diameter of the eye's pupil; 0 is a pinhole
    #: focus distance of the eye (the distance of the central depth plane)
    focus_mm: Annotated[float, Values(low=1e-9)] | None = None
    #: luminance of the panel's white, for perceptual metrics
    luminance_cd_m2: Annotated[float, Values(low=1e-3)] = 500.0
    #: pixels per lens of the views (lenticulars: 1)
    view_pixels_per_lens: Annotated[int, Values(low=1)] = 4
    #: RGB-D pixels per lens pitch (lenticulars: 3); P / P_I is the resolution of the paper
    capture_pixels_per_pitch: Annotated[int | float, Values(low=1)] = 5
    #: samples per RGB-D pixel (as many as the scores need, 16 to 256; lenticulars: 8 to 64)
    capture_spp: Annotated[int, Values(low=1, high=_MOST_SAMPLES)] | None = None
    #: samples per ground-truth EIA pixel (as many as the scores need, 8 to 128; lenticulars: 8 to
    #: 32)
    eia_spp: Annotated[int, Values(low=2, high=_MOST_SAMPLES)] | None = None
    #: samples per ground-truth view pixel (as many as the scores need, 16 to 256)
    view_spp: Annotated[int, Values(low=2, high=_MOST_SAMPLES)] | None = None
    #: samples per reconstructed view pixel
    reconstruction_spp: Annotated[int, Values(low=1, high=_MOST_SAMPLES)] = 64
    #: sample until the interval of each headline score is within plus or minus this error; 0: a
    #: quarter of the most samples
    score_error: Annotated[float, Values(low=0, high=1)] = 0.01
    seed: Annotated[int, Values(low=0)] = 0  #: random seed of the ground truth
    #: names of finished EIAs that were computed from the ground-truth EIA and share its noise,
    #: separated by commas
    shared_noise: str = ""
    #: criterion: minimum SSIM on the relic to the reference, '0.9' for all or 'template:0.9,
    #: wang2024:0.5'
    min_ssim_to_reference: str = ""

    @property
    def placement(self) -> Placement:
        """Part of a scene that the display shows, and its place."""
        return Placement(self.fit_share, self.turn_deg, self.relic)

    @classmethod
    def field_meanings(cls) -> dict[str, str]:
        """Meanings of the settings, by name."""
        presets = {"display": f"preset to start from: {', '.join(DISPLAYS)}"}
        return meanings(_Start) | presets | meanings(Display) | meanings(Settings)

    @classmethod
    def parse(cls, values: Mapping[str, Any], source: str) -> Settings:
        """Settings from texts or values by full key (`inim.pitch_mm`).

        `source` is the scene's path, for messages. Raises `SceneError` for an unknown key, with the
        nearest known one, or a value of the wrong kind.
        """
        return cls(**parse_settings(values, source))

    def make_display(self, source: str) -> Display:
        """The display that these settings describe: the preset with the given values changed.

        Raises `SceneError` for an unknown preset, and `DisplayError` for an impossible display.
        """
        if self.display not in DISPLAYS:
            way_out = DISPLAYS.suggest(self.display)
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

    def with_defaults_of(self, display: Display, explicit: Container[str]) -> Settings:
        """A copy with the defaults of the display's layout (`Layout.default_settings`).

        * `explicit`: names of settings that keep their values.
        """
        defaults = display.layout.default_settings.items()
        values: dict[str, Any] = {k: v for k, v in defaults if k not in explicit}
        return replace(self, **values)

    def with_samples(self, display: Display) -> Settings:
        """A copy in which every number of samples is stated (`Layout.usual_samples`)."""
        usual = display.layout.usual_samples.items()
        values: dict[str, Any] = {k: v for k, v in usual if getattr(self, k) is None}
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
            try:
                limit = float(text)
            except ValueError:
                limit = math.nan
            if not 0 <= limit <= 1:
                raise SceneError(f"{source}: {key} = {item!r}: must be in 0..1")
            for name in names:
                if name not in algorithms:
                    raise SceneError(
                        f"{source}: {key} names {name!r}, which is not among the algorithms run "
                        f"({', '.join(algorithms)}); add it, or remove its limit"
                    )
                if name in limits:
                    raise SceneError(f"{source}: {key} limits {name!r} twice; keep one limit")
                limits[name] = limit
        return limits


#: Declarations of all settings, by name. `Display` checks the ranges of its own.
SETTINGS = {
    name: replace(
        setting,
        name=f"{PREFIX}{name}",
        values=Values(words=setting.values.words, rows=setting.values.rows)
        if name in DISPLAY_KEYS
        else setting.values,
    )
    for name, setting in declared(Settings).items()
}


def parse_settings(values: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Values of settings by name, from texts or values by full key; see `Settings.parse`."""
    return {
        key.removeprefix(PREFIX): parse_setting(key, value, source) for key, value in values.items()
    }


def parse_setting(key: str, value: Any, source: str) -> Any:
    """Checked value of a setting from its text, or from a value; see `Settings.parse`."""
    name = key.removeprefix(PREFIX)
    if name not in SETTINGS:
        hint = suggest_words(name, SETTINGS, "see `inim info settings`", PREFIX)
        raise SceneError(f"{source}: unknown setting {key!r}; {hint}")
    setting, text = SETTINGS[name], repr(str(value)[:_LONGEST_SHOWN])
    try:
        if isinstance(value, str):
            text, value = value if setting.is_number else text, setting.read(value)
        elif isinstance(value, float) and value.is_integer():
            value = int(value)
        return setting.check(value)
    except ValueError as error:
        raise SceneError(f"{source}: {key} = {text}: {error}") from None


def definition_texts(definitions: Mapping[str, Any]) -> dict[str, str]:
    """Texts of settings and scene parameters by key, for records and for the renderer."""
    return {key: setting_text(value) for key, value in definitions.items()}


def setting_table() -> str:
    """The table of settings as Markdown, for the documents and `inim info settings`."""
    rows = ["| key | default | meaning |", "| --- | --- | --- |"]
    texts = Settings.field_meanings()
    for name, setting in SETTINGS.items():
        default = "preset" if name in DISPLAY_KEYS else setting.default
        default_text = "" if default in (None, "") else f"`{default}`"
        rows.append(f"| `{PREFIX}{name}` | {default_text} | {texts[name]} |")
    return "\n".join(rows)


def describe_display(display: Display, overridden: Container[str] = ()) -> dict[str, Any]:
    """Settings that describe a display, by name: the nearest preset, and what differs from it.

    * `overridden`: names of parameters to include although they are the preset's, because a scene
      sets another value.
    """
    values = {key: getattr(display, key) for key in DISPLAY_KEYS}
    values = {key: value for key, value in values.items() if value is not None}
    ways: list[dict[str, Any]] = [
        {"display": name}
        | {k: v for k, v in values.items() if k in overridden or v != getattr(preset, k)}
        for name, preset in DISPLAYS.items()
    ]
    # A panel or a number of lenses may follow from what differs, and must then be stated.
    ways = sorted(ways, key=len) + [way | values for way in ways]
    nameless = display.replace(name="")
    return next(
        way for way in ways if Settings(**way).make_display("").replace(name="") == nameless
    )


def save_display(display: Display, path: Path) -> None:
    """Write a display file, or the calibration file of a Looking Glass (.json)."""
    if path.suffix.lower() == ".json":
        text = LookingGlass.of(display).text()
    elif path.suffix.lower() == ".xml":
        lines = [
            f'    <default name="{PREFIX}{key}" value="{value}"/>'
            for key, value in definition_texts(describe_display(display)).items()
        ]
        text = "\n".join(['<scene version="3.0.0">', *lines, "</scene>\n"])
    else:
        raise UsageError(f"{path}: a display file is an .xml; name it {path.stem}.xml")
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
