"""Scan of a scene's XML before Mitsuba reads it: settings, named files, and safety.

Mitsuba opens any path that a scene names, follows include chains for minutes and crashes on deep
nesting. A scene is therefore scanned first, in bounded time, and rejected with one line.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any
from xml.parsers import expat

from inim.display import Display
from inim.display.declaration import value_text
from inim.display.looking_glass import parse_calibration
from inim.display.settings import (
    DISPLAY_PART,
    PREFIX,
    Settings,
    definition_texts,
    describe_display,
    parse_setting,
    parse_settings,
)
from inim.render.meshes.splat_ply import SPLAT_SHAPES
from inim.render.scene_files.elements import ElementRecord
from inim.render.scene_files.parameters import Content, SceneFolder, SceneParameters, content_of
from inim.system.errors import DisplayError, FileError, SceneError, UsageError
from inim.system.files import open_file, read_file

# Generous for scenes written by people or exporters, small against what harms: Mitsuba overflows
# its stack near 20,000 levels, and include fan-out grows as a power.
_DEEPEST = 64
_MOST_ELEMENTS = 200_000
_MOST_INCLUDES = 64
# Each shape, material and light costs Mitsuba up to a millisecond and a kernel some branches.
_MOST_PLUGINS = 10_000
_LARGEST_BYTES = 64 * 2**20
_LARGEST_CALIBRATION = 2**20
_MESH_TYPES = frozenset({"ply", "obj", "serialized"}) | SPLAT_SHAPES
_VOLUME_TYPES = frozenset({"gridvolume", "sdfgrid"})
# Of images; whatever the name ends with, the renderer goes by the content.
_PICTURE_TYPES = frozenset({"bitmap", "envmap"})
# What Mitsuba's own XML reader takes as the same text.
_ENCODINGS = ("utf-8", "us-ascii", "ascii", "iso-8859-1", "latin1", "utf-16")
_NAME_A_SCENE = "name a Mitsuba scene (.xml)"
# What only leads to other elements, or to their parameters.
_UNSEEN = frozenset({"default", "include", "path"})
# Settings that a display file replaces in a scene.
_OF_DISPLAY = (*DISPLAY_PART, "misalign", "luminance_cd_m2")
_PLUGIN = re.compile(r"\w+", re.ASCII)
#: Parameters by which plugins of Mitsuba 3.9 open a file: True for the path of a file of the scene,
#: False for the name of a material in Mitsuba's `data/ior`.
FILE_PARAMETERS = {"filename": True, "material": False}
_MATERIAL = re.compile(r"[\w-]+", re.ASCII)


#: Among allowed folders: the common folder of all files that a scene names.
AUTO = Path("auto")


@dataclass(frozen=True)
class SceneFile:
    """A scanned scene file."""

    path: Path
    settings: dict[str, str]  #: `inim.*` texts; the command line overrides the file.
    parameters: dict[str, str]  #: Parameters for Mitsuba's loader.
    #: Shape plugin and mesh file of the scene's shapes, to be decoded for Mitsuba.
    meshes: tuple[tuple[str, Path], ...]
    #: Pictures to be decoded for Mitsuba or checked, and grids to be checked, because Mitsuba
    #: allocates the size in a header.
    pictures: tuple[Path, ...]
    volumes: tuple[Path, ...]
    named: dict[str, Path]  #: Path of every named file, by its name in the scene.
    #: SHA-256, size and modification times of the XML and all named files as read.
    contents: dict[Path, Content]
    #: Arguments of the scan.
    definitions: Mapping[str, str]
    allowed: tuple[Path, ...]
    sha256: str  #: Digest of the XML and all named files.
    #: Digest of the renderer's input: elements with substituted parameters, and the bytes of files,
    #: without `inim.*` settings, comments, layout, includes, or the names of files.
    rendered_sha256: str
    #: Canonical text of every element, by name; see `inim.render.scene_files.elements`.
    elements: Mapping[str, str]
    #: Folder of all named files, if `allowed` asks for it and it is not the scene's.
    common: Path | None = None

    def cache_key(self) -> dict[str, Any]:
        """Return the digest of the scene and all its files."""
        return {"scene": self.sha256}

    @property
    def file_names(self) -> dict[str, str]:
        """Names of the named files without folders, by the SHA-256 of their content."""
        return {self.contents[path][0].hex(): path.name for path in self.named.values()}

    def check_unchanged(self) -> None:
        """Raise `FileError` if a file has changed since the scan; called after loading all files.

        Files are loaded by name: one that is saved meanwhile would be taken for the one scanned,
        and its pictures kept in the result cache under a digest that is not theirs.
        """
        now = read_scene_file(self.path, self.definitions, self.allowed).contents
        changed = [p for p in {**self.contents, **now} if self.contents.get(p) != now.get(p)]
        if changed:
            raise FileError(f"{changed[0]}: was saved while the run read it; run it again")


def parse_definitions(definitions: object, source: str) -> dict[str, Any]:
    """Values of settings, and texts of scene parameters, to override, by key.

    * `definitions`: `key=value` items, as after -D; or texts and values by key.
    * `source`: name for error messages.

    Raises `UsageError`: an item without an equals sign, a key given twice, or another type.
    `SceneError`: an unknown setting, or an invalid value.
    """
    values = definitions if isinstance(definitions, Mapping) else _items(definitions)
    return {
        str(key): parse_setting(str(key), value, source)
        if str(key).startswith(PREFIX)
        else value_text(f"definitions[{key!r}]", value)
        for key, value in values.items()
    }


def _items(definitions: object) -> dict[str, str]:
    """Texts of `key=value` items, by key."""
    if not isinstance(definitions, list | tuple) or not all(
        isinstance(i, str) for i in definitions
    ):
        raise UsageError(
            f"definitions: is a {type(definitions).__name__}; give a mapping such as "
            "{'inim.pitch_mm': 0.5}"
        )
    parsed: dict[str, str] = {}
    for item in definitions:
        key, equals, value = item.partition("=")
        if not equals or not key.strip():
            raise UsageError(f"-D {item}: write -D key=value, such as -D inim.pitch_mm=0.5")
        if key.strip() in parsed:
            raise UsageError(f"-D {key.strip()}: given twice; keep one")
        parsed[key.strip()] = value
    return parsed


def read_scene_file(
    path: Path, definitions: Mapping[str, Any] | None = None, allowed: Iterable[Path] = ()
) -> SceneFile:
    """Scan a scene and everything it includes.

    * `path`: Mitsuba XML.
    * `definitions`: settings and scene parameters to override; see `parse_definitions`.
    * `allowed`: folders besides its own where files that it names may lie; or `AUTO`.

    Raises `FileError`: missing, unreadable or broken XML, or a file it names that is not there.
    `SceneError`: too deep, too large, or naming files elsewhere; an unknown `-D` key.
    """
    # Mitsuba's parameters, and what they substitute in the XML, are text.
    texts, allowed = definition_texts(definitions or {}), tuple(allowed)
    scan = _scan(path, texts, allowed)
    scan.folder.check_whole(str(path))
    # Mitsuba refuses parameters that a scene does not use; the inim.* ones mostly are not.
    changed_defaults = {
        k: v for k, v in texts.items() if not k.startswith(PREFIX) or k in scan.parameters.used
    }
    return SceneFile(
        path,
        scan.settings,
        changed_defaults,
        tuple((kind, file) for kind, file in scan.files if kind in _MESH_TYPES),
        tuple(file for kind, file in scan.files if kind in _PICTURE_TYPES),
        tuple(file for kind, file in scan.files if kind in _VOLUME_TYPES),
        scan.folder.named,
        scan.folder.contents,
        texts,
        allowed,
        scan.hash.hexdigest(),
        scan.rendered(changed_defaults),
        scan.record.elements,
        scan.folder.common,
    )


def read_scene_settings(path: Path, definitions: Mapping[str, Any] | None = None) -> dict[str, str]:
    """The `inim.*` texts of a scene, the command line's over the file's.

    Raises `FileError` or `SceneError`: as `read_scene_file`, but that meshes and pictures are not
    looked for.
    """
    return _scan(path, definition_texts(definitions or {}), (), files=False).settings


def choose_display(
    display: Display | str | Path | None = None,
    definitions: Mapping[str, Any] | None = None,
    source: str = "display",
    scene: SceneFile | None = None,
) -> tuple[Display, Settings]:
    """Design display and settings of a run.

    * `display`: a display; the name of a preset; or the path of an XML file with `inim.*` settings,
      or of the calibration file of a Looking Glass, `visual.json`.
      A preset replaces the scene's preset. A display or a file replaces all display settings of a
      scene, and those with other defaults for its layout; a file also replaces misalignment and
      luminance. None: the scene's display, or the
      default one.
    * `definitions`: single settings to override; see `parse_definitions`. With a `Display`, they
      cannot be its parameters.
    * `source`: name for error messages without a file.
    * `scene`: scene read with these definitions. Without a scene, a display file gives all
      settings.

    Raises `InimError`: an unknown setting or preset, values that describe no possible display, or
    another type.
    """
    definitions = parse_definitions({} if definitions is None else definitions, source)
    overrides = {k.removeprefix(PREFIX): v for k, v in definitions.items() if k.startswith(PREFIX)}
    if not isinstance(display, Display | str | PathLike | None):
        raise UsageError(
            f"display: {display!r} is a {type(display).__name__}; give a Display, the name of a "
            "preset, or the path of a file with inim.* settings"
        )
    path = _display_path(display)
    if scene is None and (path is None or path.suffix.lower() == ".json"):
        _check_only_settings(definitions)
    texts = {} if scene is None else scene.settings
    replaced = _OF_DISPLAY if path else DISPLAY_PART if isinstance(display, Display) else ()
    others = {
        k: v for k, v in texts.items() if k.removeprefix(PREFIX) not in (*replaced, *overrides)
    }
    stated = parse_settings(others, source)
    if isinstance(display, Display):
        if clash := [name for name in overrides if name in DISPLAY_PART]:
            raise UsageError(
                f"display: is a Display, and definitions set {PREFIX}{clash[0]}; use "
                "display.replace"
            )
        stated |= describe_display(display, [key.removeprefix(PREFIX) for key in texts])
    elif path is not None:
        distance_mm = (stated | overrides).get("viewing_distance_mm")
        described = _read_display_file(path, {} if scene else definitions, distance_mm)
        if scene is None:
            source = str(path)
        else:
            Settings(**described).make_display(str(path))  # report mistakes as the file's
            described = {k: v for k, v in described.items() if k in _OF_DISPLAY}
        stated |= described
    elif display is not None:
        if "display" in overrides:
            raise UsageError(f"-D {PREFIX}display: the display is {display} already; name it once")
        stated["display"] = display
    stated |= overrides
    settings = Settings(**stated)
    chosen = settings.make_display(source)
    explicit = stated if scene is None or display is None else overrides
    return chosen, settings.with_defaults_of(chosen, explicit)


def display_of(display: Display | str | Path) -> Display:
    """A display from a value, the name of a preset, or a display file; see `choose_display`."""
    return display if isinstance(display, Display) else choose_display(display)[0]


def _display_path(display: Display | str | PathLike[str] | None) -> Path | None:
    """Path of a display file; None for a display, the name of a preset, or None."""
    if isinstance(display, PathLike):
        return Path(display)
    is_path = isinstance(display, str) and display.lower().endswith((".xml", ".json"))
    return Path(str(display)) if is_path else None


def _read_display_file(
    path: Path, definitions: Mapping[str, Any], distance_mm: float | None
) -> dict[str, Any]:
    """Settings of a display file, by name, except those that the definitions override.

    * `distance_mm`: viewing distance of a calibration file.
    """
    if path.suffix.lower() != ".json":
        texts = read_scene_settings(path, definitions)
        return parse_settings({k: v for k, v in texts.items() if k not in definitions}, str(path))
    calibration = parse_calibration(read_file(path, _LARGEST_CALIBRATION), str(path))
    try:
        return describe_display(calibration.display(distance_mm))
    except DisplayError as error:
        raise DisplayError(f"{path}: {error}") from None


def _check_only_settings(definitions: Mapping[str, Any]) -> None:
    other = [key for key in definitions if not key.startswith(PREFIX)]
    if other:
        raise SceneError(
            f"-D {other[0]}: a display has inim.* settings only; see `inim info settings`"
        )


def _scan(
    path: Path, definitions: dict[str, str], allowed: Sequence[Path], *, files: bool = True
) -> _Scan:
    """Scan a whole scene and check that all `-D` keys exist."""
    # A command makes paths absolute.
    places = [place for place in allowed if place.name != AUTO.name or place.exists()]
    for place in places:
        if not place.is_dir():
            raise UsageError(f"--allow-folder {place}: no such folder; give an existing one")
    try:
        resolved = [place.resolve() for place in places]
        folder = SceneFolder(path.resolve().parent, resolved, extends=len(places) < len(allowed))
    # A relative path, and the current folder was deleted; or a circle of links.
    except (OSError, RuntimeError) as error:
        why = getattr(error, "strerror", None) or "its links form a circle"
        raise FileError(f"{path}: cannot be found ({why}); give its full path") from None
    scan = _Scan(folder, definitions, files)
    scan.read(path, label=str(path), level=0)
    for key in definitions:
        if key.startswith(PREFIX) or key in scan.defaults:
            continue
        if key in Settings.__dataclass_fields__:
            raise SceneError(f"{path}: -D {key}: the setting is called {PREFIX}{key}")
        available = ", ".join(k for k in scan.defaults if not k.startswith(PREFIX)) or "none"
        raise SceneError(f"{path}: -D {key}: the scene has no such parameter (it has: {available})")
    return scan


class _Scan:
    """State of one scan over a scene and its includes; of the files it names, if they matter."""

    def __init__(self, folder: SceneFolder, definitions: Mapping[str, str], files: bool) -> None:
        self.folder, self._definitions, self._look_for_files = folder, definitions, files
        try:
            self.parameters = SceneParameters(definitions)
        except ValueError as error:
            raise UsageError(f"-D: {error}") from None
        self.defaults: dict[str, str] = {}
        self.files: dict[tuple[str, Path], None] = {}
        self.hash = hashlib.sha256()
        self._rendered = hashlib.sha256()
        self.record = ElementRecord()
        self.elements = self.plugins = self.includes = self.xml_bytes = 0

    @property
    def settings(self) -> dict[str, str]:
        """The `inim.*` texts, the command line's over the file's."""
        texts = {**self.defaults, **self._definitions}
        return {k: v for k, v in texts.items() if k.startswith(PREFIX)}

    def rendered(self, parameters: Mapping[str, str]) -> str:
        """See `SceneFile.rendered_sha256`; the parameters are those handed to the renderer."""
        digest = self._rendered.copy()
        digest.update(repr(sorted(parameters.items())).encode())
        return digest.hexdigest()

    def _see(self, tag: str, attributes: Mapping[str, str], level: int, *, end: bool) -> None:
        """Add an element's start or end to its record and to the digest of the renderer's input."""
        is_seen = tag not in _UNSEEN and tag != "scene"
        if end:
            self.record.end()
        else:
            self.record.start(tag, attributes, is_seen=is_seen)
        if is_seen or (tag == "scene" and not level):
            words = ["end", tag] if end else [tag, *(sorted(attributes.items()))]
            self._rendered.update(repr(words).encode())

    def read(self, path: Path, label: str, level: int) -> None:
        """Parse one file; `label` is its name in messages."""
        text = self._bytes(path, label)
        self.hash.update(text)
        self.folder.add_place(path.resolve().parent, label)
        stack: list[tuple[str, str]] = []
        parser = expat.ParserCreate()

        def start(tag: str, attributes: dict[str, str]) -> None:
            location = f"{label}:{parser.CurrentLineNumber}"
            try:
                substituted = {k: self.parameters.substitute(v) for k, v in attributes.items()}
                if tag == "default" and "name" in substituted:
                    name, value = substituted["name"], substituted.get("value", "")
                    self.parameters.define(name, value)
                    self.defaults.setdefault(name, value)
            except ValueError as error:
                raise SceneError(f"{location}: {error}") from None
            content = self._element(tag, substituted, stack, location, level)
            self._see(tag, substituted | content, level, end=False)
            stack.append((tag, substituted.get("type", "")))

        def finish(tag: str) -> None:
            stack.pop()
            self._see(tag, {}, level, end=True)

        def doctype(*_: object) -> None:
            raise SceneError(f"{label}: has a DOCTYPE; entities are refused, remove it")

        def declaration(_version: str, encoding: str | None, _alone: int) -> None:
            # Read otherwise here than by Mitsuba, a scene could hide what it names.
            if encoding and encoding.lower() not in _ENCODINGS:
                raise FileError(f"{label}: unknown encoding {encoding[:40]!r}; save it as UTF-8")

        parser.StartElementHandler = start
        parser.EndElementHandler = finish
        parser.StartDoctypeDeclHandler = doctype
        parser.XmlDeclHandler = declaration
        try:
            parser.Parse(text, True)
        except expat.ExpatError as error:
            raise FileError(f"{label}: broken XML ({error})") from None
        except (LookupError, ValueError) as error:
            raise FileError(f"{label}: unreadable XML ({error})") from None

    def _bytes(self, path: Path, label: str) -> bytes:
        left = _LARGEST_BYTES - self.xml_bytes
        with open_file(path, label=label, remedy=_NAME_A_SCENE) as file:
            before = os.fstat(file.fileno())
        text = read_file(path, left, label=label, remedy=_NAME_A_SCENE)
        self.xml_bytes += len(text)
        self.folder.contents[path.resolve()] = content_of(hashlib.sha256(text).digest(), before)
        return text

    def _element(
        self,
        tag: str,
        attributes: dict[str, str],
        stack: list[tuple[str, str]],
        location: str,
        level: int,
    ) -> dict[str, str]:
        """Check an element; its attributes that name a file, with the file's digest instead."""
        self.elements += 1
        if len(stack) >= _DEEPEST:
            raise SceneError(f"{location}: nested deeper than {_DEEPEST} levels; flatten the scene")
        if self.elements > _MOST_ELEMENTS:
            raise SceneError(f"{location}: more than {_MOST_ELEMENTS} elements; simplify the scene")
        if not stack and level == 0 and tag != "scene":
            raise FileError(f"{location}: <{tag}> is no Mitsuba scene; the root must be <scene>")
        self._plugin(attributes.get("type", ""), location)
        if tag == "include":
            self._include(attributes.get("filename", ""), location, level)
        elif tag == "path":
            self.folder.add_path(attributes.get("value", ""), location)
        elif tag == "string" and (name := attributes.get("name")) in FILE_PARAMETERS:
            value = attributes.get("value", "")
            if FILE_PARAMETERS[name]:
                kind = stack[-1][1] if stack else ""
                return {"value": self._names_file(value, kind, location)}
            if not _MATERIAL.fullmatch(value):
                raise SceneError(
                    f"{location}: {value[:80]!r} is no material of Mitsuba; give one such as 'Au', "
                    "or eta and k as <spectrum filename=...>"
                )
        elif tag == "spectrum" and "filename" in attributes:
            return {"filename": self._names_file(attributes["filename"], "", location)}
        return {}

    def _plugin(self, name: str, location: str) -> None:
        if not name:
            return
        if not _PLUGIN.fullmatch(name):
            raise SceneError(f"{location}: {name[:80]!r} cannot be the name of a plugin")
        self.plugins += 1
        if self.plugins > _MOST_PLUGINS:
            raise SceneError(
                f"{location}: more than {_MOST_PLUGINS} shapes, materials and lights; merge the "
                "shapes into one mesh"
            )

    def _include(self, name: str, location: str, level: int) -> None:
        self.includes += 1
        if self.includes > _MOST_INCLUDES or level >= _DEEPEST // 4:
            raise SceneError(
                f"{location}: more than {_MOST_INCLUDES} includes, or a circle of them"
            )
        path = self.folder.included_path(name, location)
        self.read(path, label=f"{location}: {name}", level=level + 1)

    def _names_file(self, name: str, kind: str, location: str) -> str:
        """Register a named file, and return the digest of its content."""
        if not self._look_for_files:
            return ""
        path, digest = self.folder.file(name, location)
        self.files.setdefault((kind, path))
        self.hash.update(digest)
        return digest.hex()
