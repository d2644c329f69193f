"""Files that a mesh file names: material libraries and pictures."""

import io
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from inim.image.files.picture import grey_of_16_bits
from inim.system.errors import FileError
from inim.system.files import read_file

_MOST_TEXTURE_PIXELS = 2**26
_MOST_BYTES = 2**29
_MOST_NAME = 120


class Companions:
    """Files in a mesh's own folder.

    `lacking` are the names that no file has, `transparent` those of pictures with transparent
    pixels.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._folder = path, path.parent
        self.lacking: dict[str, None] = {}
        self.transparent: dict[str, None] = {}

    def read(self, name: str, folder: str = "") -> bytes | None:
        """Content of a file by its path from the mesh's folder, or from another in it.

        Also found are a name with backslashes, in another case, or with percent signs, and the
        bare name in the mesh's folder. None, and a note in `lacking`, if there is no such file.
        """
        for words in dict.fromkeys((name, name.partition(" #")[0], unquote(name))):
            path = words.strip().strip("\"'").replace("\\", "/")
            bare = path.rpartition("/")[2]
            for candidate in dict.fromkeys((f"{folder}/{path}", path, path.lstrip("/"), bare)):
                if candidate and (data := self._read(candidate)) is not None:
                    return data
            for entry in self._folder.iterdir():
                if entry.name.lower() == bare.lower() and (data := self._read(entry.name)):
                    return data
        self.lacking[name[:_MOST_NAME]] = None
        return None

    def _read(self, name: str) -> bytes | None:
        """Content of a file inside the mesh's folder."""
        with suppress(ValueError, OSError, RuntimeError, FileError):
            path = (self._folder / name.lstrip("/")).resolve()
            if path.is_relative_to(self._folder.resolve()):
                data: bytes = read_file(path, _MOST_BYTES)
                return data
        return None

    def picture(self, name: str, folder: str = "") -> np.ndarray | None:
        """Pixels of a picture, (h, w, 3) uint8 sRGB; None if it cannot be read."""
        from PIL import Image

        data = self.read(name, folder)
        if data is None:
            return None
        try:
            with Image.open(io.BytesIO(data)) as image:
                pixels = self.pixels(image)
                if "A" in image.getbands() or "transparency" in image.info:
                    alpha = np.asarray(image.convert("RGBA"))[..., 3]
                    if alpha.min() < 128:
                        self.transparent[name[:_MOST_NAME]] = None
                return pixels
        except FileError:
            raise
        except Exception:  # of any type: decoders of many formats
            self.lacking[name[:_MOST_NAME]] = None
            return None

    def pixels(self, image: Any) -> np.ndarray:
        """Pixels of a picture of Pillow, (h, w, 3) uint8.

        Raises `FileError`: it is too large.
        """
        if image.width * image.height > _MOST_TEXTURE_PIXELS:
            raise FileError(
                f"{self._path}: texture of {image.width} x {image.height} pixels; scale it below "
                "8192 x 8192"
            )
        if image.mode.startswith("I"):
            return grey_of_16_bits(image)
        return np.asarray(image.convert("RGB"), np.uint8)

    def losses(self) -> list[str]:
        """Sentences on files that are missing, or not shown as they are."""
        lines = [
            f"{name!r} is missing, unreadable or outside the mesh's folder; the relic goes "
            "without it"
            for name in self.lacking
        ]
        if self.transparent:
            lines.append(f"transparent pixels of {', '.join(self.transparent)} are shown opaque")
        return lines
