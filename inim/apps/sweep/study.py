"""Studies: the combinations of a sweep, read from a TOML file and checked key by key.

======================  ===========================================================================
``[study]``             ``scenes`` (files), ``displays`` (names), ``algorithms``, ``viewpoints``,
                        ``lens_model``, ``title``, ``backend``, ``time``, ``keep_reports``
``[settings]``          any other `inim.*` setting without its prefix, and any parameter of a
                        display, for all displays
``[[display]]``         ``name``, ``preset``, and any parameter of a display; or ``name`` and
                        ``file``, an .xml with `inim.*` settings
======================  ===========================================================================

In ``[settings]`` and ``[[display]]``, a list of values multiplies the combinations, and so does a
range, ``{from = 0.5, to = 1, step = 0.1}`` or ``{from = 0.5, to = 1, count = 6}``.
"""

from __future__ import annotations

import itertools
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import msgspec

from inim.display import DISPLAYS, Display
from inim.display.lens import lens_models
from inim.display.pixels import exact_length
from inim.display.settings import DISPLAY_KEYS, PREFIX, Settings
from inim.display.viewpoint import Viewpoint, is_file_safe, viewpoint_items
from inim.pipeline.stages.method import parse_methods
from inim.render.scene_files.file import display_of
from inim.system.errors import FileError, InimError, UsageError, suggest_words
from inim.system.files import check_file, read_file

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

#: Name of the display that each scene sets.
AS_SCENE = "scene"

# Settings with a key elsewhere in a study.
_ELSEWHERE = {
    "title": "study.title",
    "display": "study.displays",
    "algorithms": "study.algorithms",
    "viewpoints": "study.viewpoints",
    "lens_model": "study.lens_model",
}
_SETTINGS = tuple(f.name for f in fields(Settings) if f.name not in _ELSEWHERE)
# Largest number of validations: a day at ten seconds each.
_MOST_UNITS = 10_000


class _StudyTable(msgspec.Struct, forbid_unknown_fields=True):
    """The table ``[study]``."""

    scenes: list[str]
    algorithms: list[str]
    displays: list[str] | None = None
    viewpoints: str | list[str] | None = None
    lens_model: str | list[str] = []
    title: str = ""
    backend: Literal["auto", "llvm", "cuda"] = "auto"
    time: bool = False
    keep_reports: bool = False


class _Tables(msgspec.Struct, forbid_unknown_fields=True):
    """All tables of a study."""

    study: _StudyTable
    settings: dict[str, Any] = {}
    display: list[dict[str, Any]] = []


@dataclass(frozen=True)
class NamedDisplay:
    """A display of a study.

    `display` is that of a `Request`; None for `AS_SCENE`. `variation` has the values of its listed
    parameters.
    """

    name: str
    display: Display | str | Path | None = None
    variation: str = ""

    def with_settings(
        self, definitions: Mapping[str, str], source: str
    ) -> tuple[Display | str | Path | None, dict[str, str]]:
        """Display and definitions of a `Request`, with some settings.

        A `Display` takes its own parameters from them; others are overridden by definitions.
        """
        if not isinstance(self.display, Display):
            return self.display, dict(definitions)
        settings = Settings.parse(definitions, source)
        own = {k: getattr(settings, k) for k in DISPLAY_KEYS if f"{PREFIX}{k}" in definitions}
        others = {k: v for k, v in definitions.items() if k.removeprefix(PREFIX) not in own}
        return self.display.replace(**own), others


@dataclass(frozen=True)
class Study:
    """Combinations of a sweep.

    `scenes` are files by their names in the table; `algorithms` have the names of a report;
    `variations` are all combinations of lens models and settings, by the values that distinguish
    them. The viewpoints are those of a `Request`, by default each scene's own. `time`
    and `keep_reports` are switches: time the generators; keep the report of each validation.
    """

    path: Path
    title: str
    scenes: dict[str, Path]
    displays: tuple[NamedDisplay, ...]
    algorithms: tuple[str, ...]
    variations: dict[str, dict[str, str]]
    viewpoints: tuple[str | Viewpoint, ...] | None
    backend: str
    time: bool
    keep_reports: bool


def read_study(path: Path) -> Study:
    """Read and check a study.

    Raises `FileError` for a file that is not TOML, and `UsageError` for an invalid key or value.
    """
    return _study(_StudyReader(path, _read_toml(path)))


def study_of(tables: Mapping[str, Any], source: str) -> Study:
    """Check a study given as tables; paths of scenes start at the current folder.

    Raises `UsageError` for an invalid key or value, with the `source` in its message.
    """
    return _study(_StudyReader(Path(source), tables))


def _study(reader: _StudyReader) -> Study:
    path, study = reader.path, reader.tables.study
    displays = reader.displays()
    scenes, variations = reader.scenes(), reader.variations()
    units = len(scenes) * len(displays) * len(variations)
    if units > _MOST_UNITS:
        raise UsageError(
            f"{path}: {len(scenes)} scenes x {len(displays)} displays x {len(variations)} "
            f"combinations of settings are {units} validations; at most {_MOST_UNITS}: split it"
        )
    return Study(
        path,
        study.title or path.stem,
        scenes,
        displays,
        reader.algorithms(),
        variations,
        reader.viewpoints(),
        study.backend,
        study.time,
        study.keep_reports,
    )


# Largest number of algorithms, displays or lens models.
_MOST_NAMED = 100
# Characters of a value in a message.
_MOST_SHOWN = 40
# The parser's memory grows with the square of a dotted key's length: a gigabyte for this size.
_LARGEST_BYTES = 2**15


class _StudyReader:
    """Reader of a sweep's study, with error messages that give the key."""

    def __init__(self, path: Path, tables: Mapping[str, Any]) -> None:
        self.path = path
        try:
            self.tables = msgspec.convert(tables, _Tables)
        except msgspec.ValidationError as error:
            problem, _, place = str(error).partition(" - at `$")
            raise self.wrong(place.strip(".`") or "tables", problem) from None

    def wrong(self, key: str, words: str) -> UsageError:
        """Error for a key."""
        return UsageError(f"{self.path}: {key}: {words}")

    def check_names(self, before: str, table: Mapping[str, Any], allowed: Sequence[str]) -> None:
        """Reject unknown keys, which would otherwise hide a misspelling."""
        for name in table:
            if name not in allowed:
                key = f"{before}{name[:_MOST_SHOWN]}"
                raise self.wrong(key, f"unknown key; {suggest_words(name, allowed)}")

    def texts(self, key: str, texts: Sequence[str], most: int = _MOST_NAMED) -> Sequence[str]:
        """Check a list of different texts that must not be empty."""
        if not texts or not all(text.strip() for text in texts):
            raise self.wrong(key, "is empty; give a text")
        if len(texts) > most:
            raise self.wrong(key, f"{len(texts)} of them; at most {most}: split the study")
        for text, count in Counter(texts).items():
            if count > 1:
                raise self.wrong(key, f"{_short_value(text)} is given twice; remove one")
        return texts

    def one_of(self, key: str, value: Any, allowed: Sequence[str]) -> str:
        """Check a value that must be one of a few words."""
        if value not in allowed:
            raise self.wrong(key, f"{_short_value(value)}: {suggest_words(value, allowed)}")
        return str(value)

    def scenes(self) -> dict[str, Path]:
        """Scenes by file name; by the path as written if file names are equal."""
        names = self.texts("study.scenes", self.tables.study.scenes, _MOST_UNITS)
        stems = [Path(name).stem for name in names]
        shared = Counter(stems)
        scenes = {}
        for name, stem in zip(names, stems, strict=True):
            scene = self.path.parent / name
            try:
                check_file(scene)
            except FileError as error:
                why = str(error).removeprefix(f"{scene}: ")
                words = f"{_short_value(name)}: {why}; paths are relative to the study's folder"
                raise self.wrong("study.scenes", words) from None
            scenes[stem if shared[stem] == 1 else name] = scene
        return scenes

    def algorithms(self) -> tuple[str, ...]:
        """Algorithms under their names in reports."""
        names = self.texts("study.algorithms", self.tables.study.algorithms)
        for name in names:
            if "," in name:
                words = f"{_short_value(name)}: write one algorithm in each text"
                raise self.wrong("study.algorithms", words)
        try:
            return tuple(c.name for c in parse_methods(names, {}))
        except InimError as error:
            raise self.wrong("study.algorithms", str(error)) from None

    def viewpoints(self) -> tuple[str | Viewpoint, ...] | None:
        """Viewpoints as in a `Request`."""
        value = self.tables.study.viewpoints
        try:
            return None if value is None else viewpoint_items(value)
        except InimError as error:
            raise self.wrong("study.viewpoints", str(error)) from None

    def displays(self) -> tuple[NamedDisplay, ...]:
        """Displays in [study]; by default all of the study's own, else each scene's."""
        own = self._own_displays()
        named = self.tables.study.displays
        if named is None:
            return tuple(itertools.chain(*own.values())) or (NamedDisplay(AS_SCENE),)
        presets = {name: (NamedDisplay(name, preset),) for name, preset in DISPLAYS.items()}
        displays_by_name = {AS_SCENE: (NamedDisplay(AS_SCENE),), **presets, **own}
        names = self.texts("study.displays", named)
        for name in names:
            if name not in displays_by_name:
                words = (
                    f"{_short_value(name)} is unknown; use {', '.join(displays_by_name)}, or add it"
                )
                raise self.wrong("study.displays", f"{words} as a [[display]]")
        return tuple(itertools.chain(*(displays_by_name[name] for name in names)))

    def _own_displays(self) -> dict[str, tuple[NamedDisplay, ...]]:
        """Displays of the study's own tables by name, each with its variations."""
        displays: dict[str, tuple[NamedDisplay, ...]] = {}
        for table in self.tables.display:
            name = str(table.get("name", ""))
            if not is_file_safe(name) or name in (AS_SCENE, *DISPLAYS, *displays):
                why = "is taken" if is_file_safe(name) else "use 1 to 64 letters, digits or . _ + -"
                raise self.wrong("display.name", f"{_short_value(name)}: {why}")
            parameters = {k: v for k, v in table.items() if k not in ("name", "preset", "file")}
            if "file" in table:
                displays[name] = (self._from_file(name, table),)
                continue
            before = f"display {name!r}: "
            self.check_names(before, parameters, DISPLAY_KEYS)
            preset = self.one_of(f"{before}preset", table.get("preset", "nominal"), tuple(DISPLAYS))
            axes = {key: self._listed(f"{before}{key}", v) for key, v in parameters.items()}
            displays[name] = tuple(
                NamedDisplay(name, self._display(f"display {name!r}", preset, words), label)
                for label, words in self._combinations(before, axes)
            )
        return displays

    def _display(self, key: str, preset: str, words: Mapping[str, str]) -> Display:
        settings = self._settings(key, {"display": preset, **words})
        return settings.make_display(f"{self.path}: {key}")

    def _from_file(self, name: str, table: Mapping[str, Any]) -> NamedDisplay:
        """Display described by a file."""
        label = f"display {name!r}: file"
        if others := [key for key in table if key not in ("name", "file")]:
            raise self.wrong(f"display {name!r}: {others[0]}", "belongs into its file")
        file = str(table["file"])
        if not file.lower().endswith(".xml"):
            raise self.wrong(label, f"{_short_value(file)}: name an .xml with inim.* settings")
        path = self.path.parent / file
        display_of(path)  # raises for an invalid file
        return NamedDisplay(name, path)

    def variations(self) -> dict[str, dict[str, str]]:
        """All combinations of listed values, by the values that vary."""
        table = self.tables.settings
        for name in table:
            if name in _ELSEWHERE:
                raise self.wrong(f"settings.{name}", f"belongs to {_ELSEWHERE[name]}")
        self.check_names("settings.", table, _SETTINGS)
        axes = {name: self._listed(f"settings.{name}", value) for name, value in table.items()}
        lens_model = self.tables.study.lens_model
        models = lens_model if isinstance(lens_model, list) else [lens_model]
        for model in models:
            self.one_of("study.lens_model", model, tuple(lens_models()))
            axes.setdefault("lens_model", []).append(model)
        variations = {}
        for label, words in self._combinations("settings.", axes):
            self._settings("settings", words)
            variations[label] = {f"{PREFIX}{name}": word for name, word in words.items()}
        return variations

    def _combinations(
        self, before: str, axes: Mapping[str, Sequence[Any]]
    ) -> Iterator[tuple[str, dict[str, str]]]:
        """All combinations of listed values, as texts by name, with a label of those that vary."""
        for chosen in itertools.islice(itertools.product(*axes.values()), _MOST_UNITS + 1):
            words = self._values(before, dict(zip(axes, chosen, strict=True)))
            yield ", ".join(f"{k} = {v}" for k, v in words.items() if len(axes[k]) > 1), words

    def _listed(self, key: str, value: Any) -> list[Any]:
        """Values of a key: a single value, a list of different ones, or a range."""
        if isinstance(value, dict):
            return self._range(key, value)
        values = value if isinstance(value, list) else [value]
        if not values:
            raise self.wrong(key, "is an empty list; give a value")
        if len({str(v) for v in values}) < len(values):
            raise self.wrong(key, "has a value twice; remove one")
        return values

    def _range(self, key: str, table: Mapping[str, Any]) -> list[int | float]:
        """Equidistant values, exact in decimals: 0.1 to 0.3 by 0.1 ends with 0.3."""
        self.check_names(f"{key}.", table, ("from", "to", "step", "count"))
        if not {"from", "to"} <= table.keys() or ("step" in table) == ("count" in table):
            raise self.wrong(key, "write a range as {from = 0.5, to = 1, step = 0.1}, or count = 6")
        for name, value in table.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or value - value:
                raise self.wrong(f"{key}.{name}", f"must be a number, not {_short_value(value)}")
        first, last = (exact_length(table[name]) for name in ("from", "to"))
        if "count" in table:
            count = table["count"]
            if not isinstance(count, int) or not 2 <= count <= _MOST_UNITS or first == last:
                raise self.wrong(key, f"needs two ends and a count of 2 to {_MOST_UNITS}")
            step = (last - first) / (count - 1)
        else:
            step = exact_length(table["step"])
            if not step or not 0 <= (last - first) / step < _MOST_UNITS:
                raise self.wrong(key, f"its step leads to no, or over {_MOST_UNITS}, values")
            count = (last - first) // step + 1
        return [_number(first + n * step) for n in range(count)]

    def _values(self, before: str, table: Mapping[str, Any]) -> dict[str, str]:
        """Format numbers and texts as values of -D."""
        for name, value in table.items():
            if isinstance(value, bool) or not isinstance(value, (int, float, str)):
                words = f"must be a number or a text, not {_short_value(value)}"
                raise self.wrong(f"{before}{name}", words)
        return {name: str(value) for name, value in table.items()}

    def _settings(self, key: str, words: Mapping[str, str]) -> Settings:
        try:
            definitions = {f"{PREFIX}{name}": word for name, word in words.items()}
            return Settings.parse(definitions, f"{self.path}: {key}")
        except InimError as error:
            raise UsageError(str(error)) from None


def _short_value(value: Any) -> str:
    """Format a value for a message, in a few characters."""
    return repr(value)[:_MOST_SHOWN]


def _number(value: Fraction) -> int | float:
    return int(value) if value.denominator == 1 else float(value)


def _read_toml(path: Path) -> dict[str, Any]:
    """Tables of a TOML file; raises `FileError` for any other file."""
    data = read_file(path, _LARGEST_BYTES, remedy="name a study (.toml)")
    try:
        return tomllib.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise FileError(f"{path}: no TOML ({' '.join(str(error).split())[:200]})") from None
