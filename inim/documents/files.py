"""Files of documents: strict on reading, written whole or not at all."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

from msgspec.structs import replace

from inim.documents.document import Document, decode, encode
from inim.errors import FileError
from inim.files import read_file
from inim.files.image import write_atomically

# The project's own reports have about 100 kB and two thousand values.
_LARGEST_BYTES = 2**24
_LARGEST_VALUE_COUNT = 300_000
_LONGEST_MESSAGE = 200

_D = TypeVar("_D", bound=Document)


def read_document(path: Path, remedy: str, *types: type[_D]) -> _D:
    """Read and check a document.

    * `remedy`: end of each error message.
    * `*types`: the key `schema` selects among them.

    Raises `FileError`: missing, not a regular file, too large, not strict JSON, or not as its type
    declares. The line names the file and the place in the document.
    """
    data = read_file(path, _LARGEST_BYTES, remedy=remedy)
    try:
        value_count = data.count(b",")
        if value_count > _LARGEST_VALUE_COUNT:
            raise ValueError(f"{value_count} values; at most {_LARGEST_VALUE_COUNT} are read")
        return decode(data.decode("utf-8"), *types)
    except ValueError as error:
        raise FileError(f"{path}: {_one_line(str(error))}; {remedy}") from None


def write_document(path: Path, document: Document) -> None:
    """Write a document whole or not at all."""
    write_text(path, encode(document))


def write_forms(
    document: _D, folder: Path, name: str, forms: Mapping[str, Callable[[_D], str]]
) -> None:
    """Write a document and other forms of it, the document last: it marks a whole report.

    * `name`: file name of the document.
    * `forms`: by file name, the function for the file's text. It gets the document as it reads
      back, so that all forms agree.
    """
    text = encode(document)
    decoded = decode(text, type(document))
    texts = {file: render(decoded) for file, render in forms.items()}
    for file, content in {**texts, name: text}.items():
        write_text(folder / file, content)


def write_listed(
    document: _D, folder: Path, name: str, forms: Mapping[str, Callable[[_D], str]]
) -> None:
    """Write a document's forms as `write_forms`; its `files` name all files of the folder."""
    files = folder_files(folder, name, *forms)
    write_forms(replace(document, files=files), folder, name, forms)


def folder_files(folder: Path, *names: str) -> list[str]:
    """All files below `folder`, and those still to be written there."""
    present = (str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())
    return sorted({*present, *names})


def write_text(path: Path, content: str) -> None:
    """Write UTF-8 text that ends in one line break, whole or not at all."""
    line = content.rstrip("\n") + "\n"

    def put(temporary: Path) -> None:
        # A path may hold bytes that are not UTF-8. Python keeps them as lone surrogates. Written as
        # backslash and number they are valid UTF-8, and in JSON the escape that reads back.
        temporary.write_text(line, encoding="utf-8", errors="backslashreplace")

    write_atomically(path, put)


def _one_line(message: str) -> str:
    """A message in printable characters; a long one loses its middle, and its end is the place."""
    text = "".join(c if c.isprintable() else " " for c in message)
    half = _LONGEST_MESSAGE // 2
    return text if len(text) <= _LONGEST_MESSAGE else f"{text[:half]} ... {text[-half:]}"
