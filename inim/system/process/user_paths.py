"""Paths of a worker's job: absolute for the worker, relative in texts if the user's are relative.

A worker runs in an empty folder, while its messages and reports are about the user's.
"""

import pickle
import re
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import IO, Any

_user_paths: dict[str, str] = {}


class AbsolutePathPickler(pickle.Pickler):
    """Pickler that makes relative paths absolute; `user_paths` has them by absolute path."""

    def __init__(self, stream: IO[bytes]) -> None:
        super().__init__(stream)
        self.user_paths: dict[str, str] = {}

    def reducer_override(self, value: Any) -> Any:
        """Replace a relative path."""
        if not isinstance(value, PurePath) or value.is_absolute():
            return NotImplemented
        absolute = str(Path(value).absolute())
        self.user_paths[absolute] = str(value)
        return Path, (absolute,)


def remember_user_paths(user_paths: Mapping[str, str]) -> None:
    """Use a pickler's `user_paths` in `user_text`; the longest paths come first."""
    _user_paths.clear()
    _user_paths.update(sorted(user_paths.items(), key=lambda item: -len(item[0])))


def user_text(value: object) -> str:
    """Convert a value to a text with the user's relative paths."""
    text = str(value)
    if text in _user_paths:
        return _user_paths[text]
    for absolute, path in _user_paths.items():
        if path != ".":
            pattern = rf"(?<![\w./-]){re.escape(absolute)}"
            text = re.sub(pattern, path.replace("\\", r"\\"), text)
    return text
