"""Lines of text on the terminal: printable, one line each, and only our own."""

import logging
import unicodedata
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

# Besides all categories that begin with C: controls, formats such as the direction of text, lone
# surrogates of names that are not UTF-8.
_BREAKS = ("Zl", "Zp")


def printable(line: object) -> str:
    r"""A line with its control characters and bytes outside UTF-8 escaped, as in ``\x1b``.

    Names of files may contain them. Raw, they end the line or change the terminal.
    """
    text = str(line)
    return text if text.isascii() and text.isprintable() else "".join(map(_escaped, text))


def _escaped(character: str) -> str:
    category = unicodedata.category(character)
    if category[0] != "C" and category not in _BREAKS:
        return character
    if "\udc80" <= character <= "\udcff":  # how Python keeps a byte of such a name
        return f"\\x{ord(character) - 0xDC00:02x}"
    return character.encode("unicode_escape").decode("ascii")


@contextmanager
def quiet_libraries() -> Iterator[None]:
    """Suppress warnings and log messages of libraries; ours are printed by our own functions."""
    root, handler = logging.getLogger(), logging.NullHandler()
    root.addHandler(handler)  # without any, Python prints messages
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        root.removeHandler(handler)
