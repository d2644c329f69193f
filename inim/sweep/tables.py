"""A study's file: its TOML, read within bounds, and what to say of a key that is wrong."""

from __future__ import annotations

import re
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.errors import FileError, UsageError, known_words
from inim.files.regular_file import read_file

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

#: Of algorithms, displays or lens models; each is looked up or made, to be checked.
MOST_NAMED = 100
# Characters of a value in a message.
_MOST_SHOWN = 40
_LARGEST_BYTES = 2**20
_MOST_PARTS = 4


class Tables:
    """The tables of one file, and what to say where they are wrong.

    Parameters
    ----------
    path : Path

    Raises
    ------
    FileError
        Missing, unreadable, or no TOML.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.tables = path, _toml(path)

    def wrong(self, key: str, words: str) -> UsageError:
        """The error for a key."""
        return UsageError(f"{self.path}: {key}: {words}")

    def table(self, name: str) -> Mapping[str, Any]:
        """A table; empty where there is none."""
        found = self.tables.get(name, {})
        if not isinstance(found, dict):
            raise self.wrong(name, f"write it as a table, [{name}]")
        return found

    def check_names(self, before: str, table: Mapping[str, Any], known: Sequence[str]) -> None:
        """Refuse keys that nobody reads; a slip of a letter would go unnoticed."""
        for name in table:
            if name not in known:
                key = f"{before}{name[:_MOST_SHOWN]}"
                raise self.wrong(key, f"unknown key; {known_words(name, known)}")

    def text(self, key: str, value: Any) -> str:
        """A text that is not empty."""
        if not isinstance(value, str) or not value.strip():
            raise self.wrong(key, f"must be a text, not {shown(value)}")
        return value.strip()

    def texts(self, key: str, value: Any, most: int = MOST_NAMED) -> list[str]:
        """A list of texts, none twice."""
        if not isinstance(value, list) or not value:
            raise self.wrong(key, f"must be a list of texts, not {shown(value)}")
        self.check_count(key, value, most)
        found = [self.text(key, one) for one in value]
        for one, count in Counter(found).items():
            if count > 1:
                raise self.wrong(key, f"{shown(one)} is given twice; drop one")
        return found

    def check_count(self, key: str, values: Sequence[object], most: int) -> None:
        """Refuse more than a study can mean."""
        if len(values) > most:
            raise self.wrong(key, f"{len(values)} of them; at most {most}: split the study")

    def switch(self, key: str, value: Any) -> bool:
        """True or false."""
        if not isinstance(value, bool):
            raise self.wrong(key, f"must be true or false, not {shown(value)}")
        return value

    def one_of(self, key: str, value: Any, known: Sequence[str]) -> str:
        """One of a few words."""
        if value not in known:
            raise self.wrong(key, f"{shown(value)}: {known_words(value, known)}")
        return str(value)


def shown(value: Any) -> str:
    """A value as the study's author may have written it, in a few characters."""
    return repr(value)[:_MOST_SHOWN]


def _toml(path: Path) -> dict[str, Any]:
    data = read_file(path, _LARGEST_BYTES, way_out="name a study (.toml)")
    try:
        text = data.decode("utf-8")
        _check_keys(text)
        return dict(tomllib.loads(text))
    except (ValueError, RecursionError) as error:
        words = " ".join(str(error).split())[:200]
        raise FileError(f"{path}: no TOML ({words})") from None


_TOKEN = re.compile(r"[\n=,\[\]{}.#\"']")
_ENDS = {
    '"': re.compile(r'["\\\n]'),
    "'": re.compile(r"['\n]"),
    '"""': re.compile(r'"""|\\'),
    "'''": re.compile(r"'''"),
}


def _check_keys(text: str) -> None:
    """Raise ValueError for a key of many dotted parts: in memory, they grow as their square.

    One pass over what is no text and no comment. Nothing but keys has so many dots.
    """
    at = dots = 0
    while token := _TOKEN.search(text, at):
        mark, at = token[0], token.end()
        if mark == ".":
            dots += 1
            if dots >= _MOST_PARTS:
                line = text.count("\n", 0, at) + 1
                raise ValueError(f"line {line}: a key of more than {_MOST_PARTS} parts")
        elif mark in "\"'":
            at = _text_end(text, token.start())
        elif mark == "#":
            at = text.find("\n", at) % (len(text) + 1)
        else:
            dots = 0


def _text_end(text: str, at: int) -> int:
    """Where a quoted text ends; of one that does not, the end of all, where reading ends, too."""
    quote = text[at]
    mark = 3 * quote if text.startswith(3 * quote, at) else quote
    at += len(mark)
    while found := _ENDS[mark].search(text, at):
        at = found.end()
        if found[0] == mark:
            # Up to two quotes may stand before those that end a text of several lines.
            while len(mark) == 3 and at < found.end() + 2 and text.startswith(quote, at):
                at += 1
            return at
        if found[0] == "\n":
            break
        at += 1  # what a backslash makes ordinary
    return len(text)
