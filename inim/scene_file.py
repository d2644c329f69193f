"""Reading a scene's XML before Mitsuba does: settings, files it names, and whether it is safe.

Mitsuba opens whatever path a scene names, follows include chains for minutes and dies on deep
nesting; so a scene is scanned first, in bounded time, and refused with one line.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

from inim.errors import FileError, SceneError, UsageError
from inim.settings import PREFIX

__all__ = ["SceneFile", "parse_definitions", "read_scene_file"]

# Generous for scenes written by people or exporters, small against what harms: Mitsuba overflows
# its stack near 20,000 levels, and include fan-out grows as a power.
_DEEPEST = 64
_MOST_ELEMENTS = 200_000
_MOST_INCLUDES = 64
_LARGEST_BYTES = 64 * 2**20
_MESH_TYPES = frozenset({"ply", "obj", "serialized"})
_PARAMETER = re.compile(r"\$([\w.]+)")


@dataclass(frozen=True)
class SceneFile:
    """A scanned scene file.

    Attributes
    ----------
    path : Path
    settings : dict of str to str
        `inim.*` texts, the command line's over the file's.
    parameters : dict of str to str
        What to hand to Mitsuba's loader.
    meshes : tuple of (str, Path)
        Shape plugin and mesh file of the scene's shapes, to be checked before Mitsuba reads them.
    exrs : tuple of Path
        EXR pictures it names, to be checked likewise: the renderer's own reader is an old one.
    sha256 : str
        Over the XML and all files it names.
    """

    path: Path
    settings: dict[str, str]
    parameters: dict[str, str]
    meshes: tuple[tuple[str, Path], ...]
    exrs: tuple[Path, ...]
    sha256: str


def parse_definitions(items: list[str]) -> dict[str, str]:
    """`-D key=value` items as a mapping.

    Raises
    ------
    UsageError
        An item without an equals sign, or a key given twice.
    """
    parsed: dict[str, str] = {}
    for item in items:
        key, equals, value = item.partition("=")
        if not equals or not key.strip():
            raise UsageError(f"-D {item}: write -D key=value, such as -D inim.pitch_mm=0.5")
        if key.strip() in parsed:
            raise UsageError(f"-D {key.strip()}: given twice; keep one")
        parsed[key.strip()] = value
    return parsed


def read_scene_file(path: Path, definitions: Mapping[str, str] | None = None) -> SceneFile:
    """Scan a scene and everything it includes.

    Parameters
    ----------
    path : Path
        Mitsuba XML.
    definitions : mapping of str to str, optional
        The command line's `-D key=value`.

    Raises
    ------
    FileError
        Missing, unreadable or broken XML, or a file it names that is not there.
    SceneError
        Too deep, too large, or naming files outside its own folder; an unknown `-D` key.
    """
    definitions = dict(definitions or {})
    try:
        folder = path.resolve().parent
    except OSError as error:  # a relative path, and the current folder was deleted
        raise FileError(f"{path}: cannot be found ({error.strerror}); give its full path") from None
    scan = _Scan(folder, definitions)
    scan.read(path, shown=str(path), level=0)
    own = {k: v for k, v in definitions.items() if k.startswith(PREFIX)}
    for key in definitions.keys() - own.keys() - scan.defaults.keys():
        known = ", ".join(k for k in scan.defaults if not k.startswith(PREFIX)) or "none"
        raise SceneError(f"{path}: -D {key}: the scene has no such parameter (it has: {known})")
    # Mitsuba refuses parameters that a scene does not use; the inim.* ones mostly are not.
    wanted = {k: v for k, v in definitions.items() if k not in own or k in scan.used}
    in_file = {k: v for k, v in scan.defaults.items() if k.startswith(PREFIX)}
    return SceneFile(
        path,
        {**in_file, **own},
        wanted,
        tuple(scan.meshes),
        tuple(scan.exrs),
        scan.hash.hexdigest(),
    )


class _Scan:
    """State of one scan over a scene and its includes."""

    def __init__(self, folder: Path, definitions: Mapping[str, str]) -> None:
        self.folder = folder
        self.definitions = definitions
        self.defaults: dict[str, str] = {}
        self.used: set[str] = set()
        self.meshes: list[tuple[str, Path]] = []
        self.exrs: list[Path] = []
        self.hash = hashlib.sha256()
        self.elements = 0
        self.includes = 0

    def read(self, path: Path, shown: str, level: int) -> None:
        """Parse one file; `shown` is its name in messages."""
        text = self._bytes(path, shown)
        self.hash.update(text)
        stack: list[tuple[str, dict[str, str]]] = []
        parser = expat.ParserCreate()

        def start(tag: str, attributes: dict[str, str]) -> None:
            where = f"{shown}:{parser.CurrentLineNumber}"
            self._element(tag, attributes, stack, where, level)
            stack.append((tag, attributes))

        def doctype(*_: object) -> None:
            raise SceneError(f"{shown}: has a DOCTYPE; entities are refused, remove it")

        parser.StartElementHandler = start
        parser.EndElementHandler = lambda _tag: stack.pop()
        parser.StartDoctypeDeclHandler = doctype
        try:
            parser.Parse(text, True)
        except expat.ExpatError as error:
            raise FileError(f"{shown}: broken XML ({error})") from None
        except (LookupError, ValueError) as error:
            raise FileError(f"{shown}: unreadable XML ({error})") from None

    def _bytes(self, path: Path, shown: str) -> bytes:
        try:
            if not path.is_file():
                reason = "is a folder" if path.is_dir() else "no such file"
                raise FileError(f"{shown}: {reason}; name a Mitsuba scene (.xml)")
            if path.stat().st_size > _LARGEST_BYTES:
                raise SceneError(
                    f"{shown}: {path.stat().st_size} bytes of XML; at most {_LARGEST_BYTES}"
                )
            return path.read_bytes()
        except OSError as error:
            raise FileError(f"{shown}: cannot be read ({error.strerror})") from None

    def _element(
        self,
        tag: str,
        attributes: dict[str, str],
        stack: list[tuple[str, dict[str, str]]],
        where: str,
        level: int,
    ) -> None:
        self.elements += 1
        if len(stack) >= _DEEPEST:
            raise SceneError(f"{where}: nested deeper than {_DEEPEST} levels; flatten the scene")
        if self.elements > _MOST_ELEMENTS:
            raise SceneError(f"{where}: more than {_MOST_ELEMENTS} elements; simplify the scene")
        if not stack and level == 0 and tag != "scene":
            raise FileError(f"{where}: <{tag}> is no Mitsuba scene; the root must be <scene>")
        for text in attributes.values():
            self.used.update(_PARAMETER.findall(text))
        if tag == "default" and "name" in attributes:
            # Mitsuba's escape: a title may hold a dollar sign.
            value = attributes.get("value", "").replace("\\$", "$")
            self.defaults.setdefault(attributes["name"], value)
        elif tag == "include":
            self._include(self._substitute(attributes.get("filename", "")), where, level)
        elif tag == "path":
            self._inside(self._substitute(attributes.get("value", "")), where)
        elif tag == "string" and attributes.get("name") == "filename":
            self._names_file(self._substitute(attributes.get("value", "")), stack, where)

    def _include(self, name: str, where: str, level: int) -> None:
        self.includes += 1
        if self.includes > _MOST_INCLUDES or level >= _DEEPEST // 4:
            raise SceneError(f"{where}: more than {_MOST_INCLUDES} includes, or a circle of them")
        path = self._inside(name, where)
        self.read(path, shown=f"{where}: {name}", level=level + 1)

    def _names_file(self, name: str, stack: list[tuple[str, dict[str, str]]], where: str) -> None:
        path = self._inside(name, where)
        if not path.is_file():
            raise FileError(f"{where}: {name!r} is not there; paths start at the scene's folder")
        kind = stack[-1][1].get("type", "") if stack else ""
        if stack and stack[-1][0] == "shape" and kind in _MESH_TYPES:
            self.meshes.append((kind, path))
        elif path.suffix.lower() == ".exr":
            self.exrs.append(path)
        try:
            self.hash.update(hashlib.sha256(path.read_bytes()).digest())
        except OSError as error:
            raise FileError(f"{where}: {name!r} cannot be read ({error.strerror})") from None

    def _inside(self, name: str, where: str) -> Path:
        try:
            path = (self.folder / name).resolve()
        except (OSError, ValueError, RuntimeError) as error:
            raise FileError(f"{where}: {name!r} is no usable file name ({error})") from None
        if not path.is_relative_to(self.folder):
            raise SceneError(
                f"{where}: {name!r} lies outside the scene's folder; copy it beside the scene"
            )
        return path

    def _substitute(self, text: str) -> str:
        def value(match: re.Match[str]) -> str:
            name = match[1]
            return self.definitions.get(name, self.defaults.get(name, match[0]))

        return _PARAMETER.sub(value, text)
