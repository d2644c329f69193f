"""Parameters and files of a scene: substitution of `$name`, and resolution of file names.

Mitsuba searches a file name in the folders of the files it reads and in `<path>`s. A name must
therefore mean the same file in all of them, and no file may be outside the scene's folder and the
allowed folders.

`$name` in the attributes of a scene's XML is substituted as in Mitsuba 3.9, because the scan must
determine the file names that Mitsuba will open. This module repeats Mitsuba's
rules (longest name first, a backslash escapes), in bounded length and time.
"""

import hashlib
import os
import re
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path

from inim.system.errors import FileError, SceneError
from inim.system.files import open_file

#: A file's SHA-256, size, and times [ns] of the last changes of its content, and of its name or
#: rights: what was changed and changed back has other times.
Content = tuple[bytes, int, int, int]

# Places where files are looked for (folders of included files, <path> elements), and files named.
_MOST_PLACES = 64
_MOST_FILES = 4096
_MOST_BYTES = 2**32
_BLOCK_BYTES = 2**20
# Folders in which Mitsuba looks for its plugins and its own data.
_RESERVED = ("plugins", "data")


class SceneFolder:
    """The files that a scene names.

    * `folder`: of the scene's XML, resolved.
    * `allowed`: folders, resolved, besides it: every file must lie in one of them.
    * `extends`: allow the common folder of all files.
    """

    def __init__(
        self, folder: Path, allowed: Iterable[Path] = (), *, extends: bool = False
    ) -> None:
        self._folder, self._extends = folder, extends
        self._allowed = (folder, *allowed)
        #: Common folder of all files, where it is not the scene's.
        self.common: Path | None = None
        self._places = {folder: None}
        self._named: dict[str, tuple[Path, str]] = {}
        #: Of every file, XML included, what was read.
        self.contents: dict[Path, Content] = {}
        self._bytes = 0

    @property
    def named(self) -> dict[str, Path]:
        """Path of every named file, by its name in the scene."""
        return {name: path for name, (path, _) in self._named.items()}

    def add_place(self, place: Path, location: str) -> None:
        """Names are looked up in this folder, too; `location` is for messages, here and below."""
        self._places.setdefault(place)
        if len(self._places) > _MOST_PLACES:
            raise SceneError(
                f"{location}: more than {_MOST_PLACES} folders; gather the files in one"
            )

    def add_path(self, name: str, location: str) -> None:
        """Add the folder named in a `<path>`, as `add_place`."""
        self.add_place(self._inside(self._folder, name, location), location)

    def included_path(self, name: str, location: str) -> Path:
        """The XML that an `<include>` names, there or not."""
        path = self._find_path(name, location) or self._inside(self._folder, name, location)
        if "\\" in name:  # which Mitsuba opens by itself
            raise SceneError(f"{location}: {name!r} has backslashes; write slashes")
        self._named.setdefault(name, (path, location))
        return path

    def file(self, name: str, location: str) -> tuple[Path, bytes]:
        """Resolve a file name, and compute the SHA-256 of the file.

        Raises `FileError`: the file is missing or unreadable. `SceneError`: the file is outside the
        allowed folders, the name is ambiguous, or there are too many files.
        """
        path = self._find_path(name, location)
        if path is None and ("<udim>" in name.lower() or "<uvtile>" in name.lower()):
            raise FileError(
                f"{location}: {name!r} is a set of pictures, one per tile, which Mitsuba does not "
                "read; bake them into one picture"
            )
        if path is None or not path.is_file():
            raise FileError(f"{location}: {name!r} is not there; paths start at the scene's folder")
        self._named.setdefault(name, (path, location))
        if len(self._named) > _MOST_FILES:
            raise SceneError(f"{location}: names more than {_MOST_FILES} files; simplify the scene")
        if path not in self.contents:
            self.contents[path] = self._content(path, name, location)
        return path, self.contents[path][0]

    def check_whole(self, label: str) -> None:
        """Reject ambiguous file names, and plugins and data in the folders of the whole scene."""
        for name, (path, location) in self._named.items():
            if self._find_path(name, location) != path:
                raise SceneError(f"{location}: {name!r} names several files; rename all but one")
        folders = [path.parent for path, _ in self._named.values()]
        allowed = [
            place for place in self._allowed if any(f.is_relative_to(place) for f in folders)
        ]
        for place in (*self._places, *allowed):
            _check_reserved(place, label)

    def _content(self, path: Path, name: str, location: str) -> Content:
        digest = hashlib.sha256()
        with open_file(path, label=f"{location}: {name!r}") as file:
            status = os.fstat(file.fileno())
            self._bytes += status.st_size
            if self._bytes > _MOST_BYTES:
                raise SceneError(
                    f"{location}: with {name!r}, the scene's files hold {self._bytes} bytes; at "
                    f"most {_MOST_BYTES}"
                )
            while block := file.read(_BLOCK_BYTES):
                digest.update(block)
        return content_of(digest.digest(), status)

    def _find_path(self, name: str, location: str) -> Path | None:
        """The one file or folder that a name can mean; None where there is none."""
        paths = [self._resolve(place, name, location) for place in self._places]
        try:
            there = {path for path in paths if path.exists()}
            if not there and "\\" in name:  # as programs for Windows write it
                name = name.replace("\\", "/")
                paths = [self._resolve(place, name, location) for place in self._places]
                there = {path for path in paths if path.exists()}
        except OSError as error:
            raise _unusable_error(name, location, error) from None
        # What is not there cannot be opened; it matters where the file should have been.
        for path in there or paths:
            self._check_inside(path, name, location)
        if len(there) > 1:
            raise SceneError(f"{location}: {name!r} names several files; rename all but one")
        return there.pop() if there else None

    def _inside(self, place: Path, name: str, location: str) -> Path:
        path = self._resolve(place, name, location)
        self._check_inside(path, name, location)
        return path

    def _resolve(self, place: Path, name: str, location: str) -> Path:
        try:
            return (place / name).resolve()
        except (OSError, ValueError, RuntimeError) as error:
            raise _unusable_error(name, location, error) from None

    def _check_inside(self, path: Path, name: str, location: str) -> None:
        if any(path.is_relative_to(folder) for folder in self._allowed):
            return
        if self._extends:
            self.common = Path(os.path.commonpath([self.common or self._folder, path]))
            if self.common == Path(path.anchor):
                raise SceneError(
                    f"{location}: {name!r} has no folder in common with the scene; name its "
                    "folder with --allow-folder"
                )
        else:
            raise SceneError(
                f"{location}: {name!r} is outside the scene's folder; copy it next to the scene, "
                f"or add --allow-folder {shlex.quote(str(self._folder_to_allow(path)))}"
            )

    def _folder_to_allow(self, path: Path) -> Path:
        """Folder to propose for --allow-folder: the first below the parent shared with it."""
        folder, top = path if path.is_dir() else path.parent, Path(path.anchor)
        common = next(
            (parent for parent in self._folder.parents if folder.is_relative_to(parent)), top
        )
        return folder if common in (top, folder) else common / folder.relative_to(common).parts[0]


def content_of(sha256: bytes, status: os.stat_result) -> Content:
    """Content record of a file from its digest and status."""
    return sha256, status.st_size, status.st_mtime_ns, status.st_ctime_ns


def _unusable_error(name: str, location: str, error: Exception) -> FileError:
    cause = getattr(error, "strerror", None) or error
    return FileError(f"{location}: {name[:120]!r} is not a usable file name ({cause})")


def _check_reserved(place: Path, label: str) -> None:
    """Refuse a folder of a scene with something that Mitsuba could take for its own.

    What it contains does not matter: a library in a folder that cannot be listed can be loaded.
    """
    for name in _RESERVED:
        try:
            (place / name).lstat()
        except FileNotFoundError:
            continue
        except OSError as error:
            raise FileError(f"{label}: {place} cannot be searched ({error.strerror})") from None
        raise SceneError(
            f"{label}: {place / name} could replace the renderer's own {name}; rename it, or move "
            "the scene elsewhere"
        )


# Far above what scenes use. Parameters made of parameters grow as a power: ten levels of ten
# make ten gigabytes of a kilobyte.
_MOST_PARAMETERS = 512
_LONGEST_VALUE = 2**16
_MOST_SUBSTITUTED = 2**24
_NAME = re.compile(r"(?<!\\)\$(\w*)", re.ASCII)


class SceneParameters:
    """Values of `$name`; the first definition wins.

    * `given`: the command line's; a scene's own `<default>`s yield to them.
    """

    def __init__(self, definitions: Mapping[str, str]) -> None:
        self._values: dict[str, str] = {}
        self._longest_first: list[str] = []
        self._substituted = 0
        #: Names that were asked for.
        self.used: set[str] = set()
        for name, value in definitions.items():
            self.define(name, value)

    def define(self, name: str, value: str) -> None:
        """Give a parameter a value, unless it has one.

        Raises `ValueError`: too many of them, or one without a name.
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
        """Substitute parameters in a text as Mitsuba does.

        Raises `ValueError`: an undefined parameter, or a text beyond the size limit.
        """
        if "$" not in text:
            return text
        for name in self._longest_first:
            text = self._substitute(text, name)
        missing = _NAME.search(text)
        if missing:
            raise ValueError(
                f"parameter ${missing[1][:40]} is not defined; add a <default> or -D, or write "
                "\\$ for a dollar sign"
            )
        return text.replace("\\$", "$")

    def _substitute(self, text: str, name: str) -> str:
        """Each `$name` that no backslash precedes, by its value; the value is not looked into."""
        key, value = f"${name}", self._values[name]
        pieces, at, last = [], 0, ""
        while (start := text.find(key, at)) >= 0:
            last = text[start - 1] if start > at else last
            escaped = last == "\\"
            if not escaped:
                self.used.add(name)
            new = key if escaped else value
            pieces += [text[at:start], new]
            at, last = start + len(key), new[-1:] or last
            self._count(len(new))
        pieces.append(text[at:])
        text = "".join(pieces)
        if len(text) > _LONGEST_VALUE:
            raise ValueError(f"parameter ${name[:40]} makes a text too long; shorten its value")
        return text

    def _count(self, length: int) -> None:
        self._substituted += length + 1
        if self._substituted > _MOST_SUBSTITUTED:
            raise ValueError("the scene's parameters unfold to too much text; simplify them")
