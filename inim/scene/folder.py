"""A scene's folder: which file each name in a scene means, and that none lies outside.

Mitsuba looks a name up in the folders of the files it reads, in `<path>`s and in the current
folder, for plugins as well; so a name must mean one file only, wherever it is looked for.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from inim.errors import FileError, SceneError

__all__ = ["SceneFolder"]

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
        Of the scene's XML, resolved; every file must lie in it.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._places = {folder: None}
        self._named: dict[str, tuple[Path, str]] = {}
        self._digests: dict[Path, bytes] = {}
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
        if path not in self._digests:
            self._digests[path] = self._digest(path, name, where)
        return path, self._digests[path]

    def settle(self, shown: str) -> None:
        """What only the whole scene tells: names that mean two files, plugins beside the scene."""
        for name, (path, where) in self._named.items():
            if self._found(name, where) != path:
                raise SceneError(f"{where}: {name!r} names several files; rename all but one")
        # Mitsuba looks for plugins where it looks for files: a library there would be run.
        for place in (*self._places, Path()):
            for library in _libraries(place / "plugins"):
                raise SceneError(
                    f"{shown}: {library} would be loaded into the renderer and run; move the "
                    "folder 'plugins' elsewhere"
                )

    def _digest(self, path: Path, name: str, where: str) -> bytes:
        digest = hashlib.sha256()
        try:
            self._bytes += path.stat().st_size
            if self._bytes > _MOST_BYTES:
                raise SceneError(
                    f"{where}: with {name!r}, the scene's files hold {self._bytes} bytes; at "
                    f"most {_MOST_BYTES}"
                )
            with path.open("rb") as file:
                while block := file.read(_BLOCK_BYTES):
                    digest.update(block)
        except OSError as error:
            raise FileError(f"{where}: {name!r} cannot be read ({error.strerror})") from None
        return digest.digest()

    def _found(self, name: str, where: str) -> Path | None:
        """The one file or folder that a name can mean; None where there is none."""
        places = [self._inside(place, name, where) for place in self._places]
        try:
            there = {path for path in places if path.exists()}
        except OSError as error:
            raise _unusable(name, where, error) from None
        if len(there) > 1:
            raise SceneError(f"{where}: {name!r} names several files; rename all but one")
        return there.pop() if there else None

    def _inside(self, place: Path, name: str, where: str) -> Path:
        try:
            path = (place / name).resolve()
        except (OSError, ValueError, RuntimeError) as error:
            raise _unusable(name, where, error) from None
        if not path.is_relative_to(self._folder):
            raise SceneError(
                f"{where}: {name!r} lies outside the scene's folder; copy it beside the scene"
            )
        return path


def _unusable(name: str, where: str, error: Exception) -> FileError:
    cause = getattr(error, "strerror", None) or error
    return FileError(f"{where}: {name[:120]!r} is no usable file name ({cause})")


def _libraries(folder: Path) -> list[str]:
    """Shared libraries in a folder; none where it cannot be looked into."""
    try:
        return sorted(str(p) for p in folder.iterdir() if p.suffix in _LIBRARIES)
    except OSError:
        return []
