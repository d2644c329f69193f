"""A scene's parameters and files: what each `$name`, and each file name in it, stands for.

Mitsuba looks a file name up in the folders of the files it reads, in `<path>`s and in the current
folder, for plugins as well; so a name must mean one file only, wherever it is looked for, and none
may lie outside the scene's folder and those that its reader allows.

`$name` in the attributes of a scene's XML is substituted as Mitsuba 3.9 does it: the scan of a
scene is worth what it knows of the file names Mitsuba will open. So this repeats Mitsuba's own
rules (longest name first, a backslash escapes), in bounded length and time.
"""

from __future__ import annotations

import hashlib
import os
import re
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path

from inim.errors import FileError, SceneError
from inim.files.regular_file import open_file

#: A file's SHA-256, size, and times [ns] of the last changes of its content, and of its name or
#: rights: what was changed and changed back has other times.
Content = tuple[bytes, int, int, int]

# Places where files are looked for (folders of included files, <path> elements), and files named.
_MOST_PLACES = 64
_MOST_FILES = 4096
_MOST_BYTES = 2**32
_BLOCK_BYTES = 2**20
_LIBRARIES = (".so", ".dylib", ".dll")


class SceneFolder:
    """The files that a scene names.

    Parameters
    ----------
    folder : Path
        Of the scene's XML, resolved.
    allowed : iterable of Path
        Folders, resolved, besides it: every file must lie in one of them.
    """

    def __init__(self, folder: Path, allowed: Iterable[Path] = ()) -> None:
        self._folder = folder
        self._allowed = (folder, *allowed)
        self._places = {folder: None}
        self._named: dict[str, tuple[Path, str]] = {}
        #: Of every file, XML included, what was read.
        self.contents: dict[Path, Content] = {}
        self._bytes = 0

    @property
    def named(self) -> dict[str, Path]:
        """By the name in the scene, every file it names."""
        return {name: path for name, (path, _) in self._named.items()}

    def add_place(self, place: Path, where: str) -> None:
        """Names are looked up in this folder, too; `where` is for messages, here and below."""
        self._places.setdefault(place)
        if len(self._places) > _MOST_PLACES:
            raise SceneError(f"{where}: more than {_MOST_PLACES} folders; gather the files in one")

    def add_path(self, name: str, where: str) -> None:
        """As `add_place`, by the name in a `<path>`."""
        self.add_place(self._inside(self._folder, name, where), where)

    def included(self, name: str, where: str) -> Path:
        """The XML that an `<include>` names, there or not."""
        path = self._found(name, where) or self._inside(self._folder, name, where)
        self._named.setdefault(name, (path, where))
        return path

    def file(self, name: str, where: str) -> tuple[Path, bytes]:
        """The one file that a name means, and the SHA-256 of what is in it.

        Raises
        ------
        FileError
            It is not there, or cannot be read.
        SceneError
            It lies outside, or means several files; or there are too many of them.
        """
        path = self._found(name, where)
        if path is None or not path.is_file():
            raise FileError(f"{where}: {name!r} is not there; paths start at the scene's folder")
        self._named.setdefault(name, (path, where))
        if len(self._named) > _MOST_FILES:
            raise SceneError(f"{where}: names more than {_MOST_FILES} files; simplify the scene")
        if path not in self.contents:
            self.contents[path] = self._content(path, name, where)
        return path, self.contents[path][0]

    def check_whole(self, shown: str) -> None:
        """Refuse what only the whole scene shows: a name of two files, plugins in its folders."""
        for name, (path, where) in self._named.items():
            if self._found(name, where) != path:
                raise SceneError(f"{where}: {name!r} names several files; rename all but one")
        for place in (*self._places, Path()):
            check_plugin_folder(place, f"{shown}: ")

    def _content(self, path: Path, name: str, where: str) -> Content:
        digest = hashlib.sha256()
        with open_file(path, label=f"{where}: {name!r}") as file:
            found = os.fstat(file.fileno())
            self._check_bytes(found.st_size, name, where)
            while block := file.read(_BLOCK_BYTES):
                self._bytes += len(block)
                self._check_bytes(0, name, where)
                digest.update(block)
        return content_of(digest.digest(), found)

    def _check_bytes(self, more: int, name: str, where: str) -> None:
        if self._bytes + more > _MOST_BYTES:
            raise SceneError(
                f"{where}: with {name!r}, the scene's files hold {self._bytes + more} bytes; at "
                f"most {_MOST_BYTES}"
            )

    def _found(self, name: str, where: str) -> Path | None:
        """The one file or folder that a name can mean; None where there is none."""
        paths = [self._resolved(place, name, where) for place in self._places]
        try:
            there = {path for path in paths if path.exists()}
        except OSError as error:
            raise _unusable(name, where, error) from None
        # What is not there cannot be opened; it matters where the file should have been.
        for path in there or paths:
            self._check_inside(path, name, where)
        if len(there) > 1:
            raise SceneError(f"{where}: {name!r} names several files; rename all but one")
        return there.pop() if there else None

    def _inside(self, place: Path, name: str, where: str) -> Path:
        path = self._resolved(place, name, where)
        self._check_inside(path, name, where)
        return path

    def _resolved(self, place: Path, name: str, where: str) -> Path:
        try:
            return (place / name).resolve()
        except (OSError, ValueError, RuntimeError) as error:
            raise _unusable(name, where, error) from None

    def _check_inside(self, path: Path, name: str, where: str) -> None:
        if not any(path.is_relative_to(folder) for folder in self._allowed):
            raise SceneError(
                f"{where}: {name!r} lies outside the scene's folder; copy it beside the scene, or "
                f"add --allow-folder {shlex.quote(str(self._to_allow(path)))}"
            )

    def _to_allow(self, path: Path) -> Path:
        """The folder to propose: the first below what the file and the scene have in common."""
        folder, top = path if path.is_dir() else path.parent, Path(path.anchor)
        common = next((one for one in self._folder.parents if folder.is_relative_to(one)), top)
        return folder if common in (top, folder) else common / folder.relative_to(common).parts[0]


def content_of(sha256: bytes, found: os.stat_result) -> Content:
    """What a file held when this was found of it."""
    return sha256, found.st_size, found.st_mtime_ns, found.st_ctime_ns


def _unusable(name: str, where: str, error: Exception) -> FileError:
    cause = getattr(error, "strerror", None) or error
    return FileError(f"{where}: {name[:120]!r} is no usable file name ({cause})")


def check_plugin_folder(place: Path, shown: str = "") -> None:
    """Refuse a folder with `plugins/*.so`: Mitsuba looks for plugins where it looks for files.

    Raises
    ------
    SceneError
        The message starts with `shown`.
    """
    for library in _libraries(place / "plugins"):
        raise SceneError(
            f"{shown}{library} would be loaded into the renderer and run; move the folder "
            "'plugins' elsewhere"
        )


def _libraries(folder: Path) -> list[str]:
    """Shared libraries in a folder; none where it cannot be looked into."""
    try:
        return sorted(str(p) for p in folder.iterdir() if p.suffix in _LIBRARIES)
    except OSError:
        return []


# Far above what scenes use. Parameters made of parameters grow as a power: ten levels of ten
# make ten gigabytes of a kilobyte.
_MOST_PARAMETERS = 512
_LONGEST_VALUE = 2**16
_MOST_SUBSTITUTED = 2**24
_NAME = re.compile(r"(?<!\\)\$(\w*)", re.ASCII)


class SceneParameters:
    """What `$name` stands for, first definition first.

    Parameters
    ----------
    given : mapping of str to str
        The command line's; a scene's own `<default>`s yield to them.
    """

    def __init__(self, given: Mapping[str, str]) -> None:
        self._values: dict[str, str] = {}
        self._longest_first: list[str] = []
        self._substituted = 0
        #: Names that were asked for.
        self.used: set[str] = set()
        for name, value in given.items():
            self.define(name, value)

    def define(self, name: str, value: str) -> None:
        """Give a parameter a value, unless it has one.

        Raises
        ------
        ValueError
            Too many of them, or one without a name.
        """
        if not name:
            raise ValueError("a parameter has no name")
        if name in self._values:
            return
        if len(self._values) >= _MOST_PARAMETERS:
            raise ValueError(f"more than {_MOST_PARAMETERS} parameters; simplify the scene")
        self._values[name] = value
        self._longest_first = sorted(self._values, key=len, reverse=True)

    def substitute(self, text: str) -> str:
        """The text as Mitsuba takes it.

        Raises
        ------
        ValueError
            A parameter that nothing defines, or a text that grows out of bounds.
        """
        if "$" not in text:
            return text
        for name in self._longest_first:
            text = self._replaced(text, name)
        missing = _NAME.search(text)
        if missing:
            raise ValueError(
                f"parameter ${missing[1][:40]} is not defined; add a <default> or -D, or write "
                "\\$ for a dollar sign"
            )
        return text.replace("\\$", "$")

    def _replaced(self, text: str, name: str) -> str:
        """Each `$name` that no backslash precedes, by its value; the value is not looked into."""
        key, value = f"${name}", self._values[name]
        done, at, last = [], 0, ""
        while (found := text.find(key, at)) >= 0:
            last = text[found - 1] if found > at else last
            escaped = last == "\\"
            if not escaped:
                self.used.add(name)
            new = key if escaped else value
            done += [text[at:found], new]
            at, last = found + len(key), new[-1:] or last
            self._count(len(new))
        done.append(text[at:])
        text = "".join(done)
        if len(text) > _LONGEST_VALUE:
            raise ValueError(f"parameter ${name[:40]} makes a text too long; shorten its value")
        return text

    def _count(self, length: int) -> None:
        self._substituted += length + 1
        if self._substituted > _MOST_SUBSTITUTED:
            raise ValueError("the scene's parameters unfold to too much text; simplify them")
