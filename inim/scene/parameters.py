"""`$name` in the attributes of a scene's XML, substituted as Mitsuba 3.9 does it.

The scan of a scene is worth what it knows of the file names Mitsuba will open; so this repeats
Mitsuba's own rules (longest name first, a backslash escapes), in bounded length and time.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

__all__ = ["SceneParameters"]

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
