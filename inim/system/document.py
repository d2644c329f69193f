"""Base classes of all documents, their JSON files, and their JSON Schemas (draft 2020-12).

JSON has no number that is not finite. A document's text has null in its place. The paths of NaN and
minus infinity are listed under `not_finite`, and a reader puts NaN there. Any other null is a value
that does not exist, or plus infinity: the PSNR of identical images.

A field's description, with its unit, is the `#:` comment behind it or above it, as Sphinx has them.
"""

from __future__ import annotations

import inspect
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, Union

import msgspec
import msgspec.inspect
from msgspec.structs import replace

from inim.system.errors import FileError
from inim.system.field_comments import field_comments
from inim.system.files import read_file
from inim.system.process.atomic_file import write_atomically
from inim.system.process.printing import printable

if TYPE_CHECKING:
    from typing_extensions import dataclass_transform
else:  # before Python 3.11 there is none

    def dataclass_transform(**_):  # noqa: D103
        return lambda declared: declared


_LARGEST_INTEGER_DIGITS = 20
_SHOWN_CHARACTERS = 60
# The project's own reports have about 100 kB and two thousand values.
_LARGEST_BYTES = 2**24
_LARGEST_VALUE_COUNT = 300_000
_LONGEST_MESSAGE = 200
_NOT_FINITE = "not_finite"
# JSON escape of half of a surrogate pair. Only those of undecodable file names are valid.
_SURROGATE = "\\ud"

_Path = tuple[str | int, ...]


def doc(text: str, **schema: Any) -> msgspec.Meta:
    """Description of a type that several fields share; `schema` adds keys to its JSON Schema."""
    return msgspec.Meta(description=text, extra_json_schema=schema or None)


class _Declaration(msgspec.StructMeta):
    """Passes `kw_only` on to subclasses, which msgspec does not."""

    def __new__(mcs, name: str, bases: Any, namespace: Any, **options: Any) -> Any:
        return super().__new__(mcs, name, bases, namespace, **{"kw_only": True} | options)


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(msgspec.field,))
class Part(
    msgspec.Struct,
    frozen=True,
    forbid_unknown_fields=True,
    omit_defaults=True,
    metaclass=_Declaration,
):
    """An object in a document. A field with a default is left out of the JSON if it has it."""


class Document(Part, tag_field="schema"):
    """A whole document. Its `tag` is the name of its schema and stands in the key `schema`.

    The first line of a document's docstring is the title of its schema.
    """

    #: Paths (keys and indices) of the nulls that stand for NaN or minus infinity. A null PSNR that
    #: is not listed is infinite; any other null is a value that does not exist.
    not_finite: list[list[str | int]] = []


_D = TypeVar("_D", bound=Document)


def encode(document: Document) -> str:
    """The document as text of strict JSON."""
    values = msgspec.to_builtins(document, enc_hook=lambda number: number.item())
    values.pop(_NOT_FINITE, None)
    paths: list[_Path] = []
    strict = _without_nonfinite(values, (), paths)
    strict |= {_NOT_FINITE: paths} if paths else {}
    return json.dumps(strict, indent=1, allow_nan=False, ensure_ascii=False)


def decode(text: str, *types: type[_D]) -> _D:
    """The document in a text of strict JSON.

    * `*types`: the key `schema` selects among them.

    Raises `ValueError`: not strict JSON, nested too deeply, or not as the type declares; the
    message gives the place in the document.
    """
    try:
        values = json.loads(
            text, parse_constant=_finite_float, parse_float=_finite_float, parse_int=_short_int
        )
    except RecursionError:
        raise ValueError("nested too deeply") from None
    except ValueError as error:
        raise ValueError(f"not a JSON document ({error})") from None
    if _SURROGATE in text.lower():
        try:
            json.dumps(values, ensure_ascii=False).encode(errors="surrogateescape")
        except UnicodeEncodeError:
            raise ValueError("contains half of a surrogate pair") from None
    schemas = [str(type_.__struct_config__.tag) for type_ in types]
    name = values.get("schema") if isinstance(values, dict) else None
    if name not in schemas:
        raise ValueError(f"schema is {_short_value(name)}, not {' or '.join(schemas)}")
    document: _D = msgspec.convert(values, Union[types])  # noqa: UP007
    if document.not_finite:
        for path in document.not_finite:
            _restore_nan(values, path)
        document = msgspec.convert(values, Union[types])  # noqa: UP007
    return document


def _without_nonfinite(value: Any, path: _Path, paths: list[_Path]) -> Any:
    """`value` with null for each number that is not finite; add to `paths` those to report."""
    if isinstance(value, Mapping):
        return {str(k): _without_nonfinite(v, (*path, str(k)), paths) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_nonfinite(v, (*path, i), paths) for i, v in enumerate(value)]
    if not isinstance(value, float) or math.isfinite(value):
        return value
    if value != math.inf:
        paths.append(path)
    return None


def _restore_nan(values: dict[str, Any], path: Sequence[Any]) -> None:
    place: Any = values
    try:
        *keys, last = path
        for key in keys:
            place = place[key]
        is_null = place[last] is None
    except (LookupError, TypeError, ValueError):
        is_null = False
    if not is_null:
        raise ValueError(f"{_NOT_FINITE} lists {_short_value(path)}, where there is no null")
    place[last] = math.nan


def _finite_float(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text[:_SHOWN_CHARACTERS]} is not a finite number")
    return number


def _short_int(text: str) -> int:
    if len(text) > _LARGEST_INTEGER_DIGITS:
        raise ValueError(f"an integer of {len(text)} digits")
    return int(text)


def _short_value(value: object) -> str:
    text = ascii(value) if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= _SHOWN_CHARACTERS else text[:_SHOWN_CHARACTERS] + "..."


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
    text = printable(message)
    half = _LONGEST_MESSAGE // 2
    return text if len(text) <= _LONGEST_MESSAGE else f"{text[:half]} ... {text[-half:]}"


_DRAFT = "https://json-schema.org/draft/2020-12/schema"


def document_schema(declaration: type[Document], tag: str) -> dict[str, Any]:
    """The JSON Schema of a document, complete in itself.

    * `tag`: its tag, for documents of users that state none.
    """
    _, parts = msgspec.json.schema_components([declaration], ref_template="#/$defs/{name}")
    for part_class in filter(lambda part_class: part_class.__name__ in parts, _subclasses(Part)):
        _describe_fields(parts[part_class.__name__], part_class)
    own = parts.pop(declaration.__name__)
    for dataclass in _dataclasses(msgspec.inspect.type_info(declaration), set()):
        _describe(parts[dataclass.__name__], dataclass)
    title, _, description = str(inspect.getdoc(declaration)).partition("\n\n")
    head = {
        "$schema": _DRAFT,
        "$id": f"urn:{_urn(str(declaration.__struct_config__.tag or tag))}",
        "title": title.removesuffix("."),
        "description": " ".join(description.split()),
    }
    return head | {k: v for k, v in own.items() if k not in head} | {"$defs": parts}


def _urn(tag: str) -> str:
    return tag.replace(".", ":").replace("/", ":")


def _subclasses(declaration: Any) -> Iterator[Any]:
    """Classes of this package that derive from one; no two of them share a name."""
    for derived in declaration.__subclasses__():
        yield from _subclasses(derived)
        if derived.__module__.startswith("inim."):
            yield derived


def _describe_fields(part: dict[str, Any], declaration: Any) -> None:
    """Describe the fields of a document's part by their comments, those of base classes too."""
    texts: dict[str, str] = {}
    for base in reversed(declaration.__mro__[: declaration.__mro__.index(Part)]):
        texts |= field_comments(base)
    keys = dict(
        zip(declaration.__struct_fields__, declaration.__struct_encode_fields__, strict=True)
    )
    for name, text in texts.items():
        part["properties"][keys[name]] |= {"description": text}


def _dataclasses(kind: Any, visited: set[type]) -> Iterator[Any]:
    """Dataclasses in a type, as `msgspec.inspect` describes it, at any depth."""
    if isinstance(kind, tuple):
        for item in kind:
            yield from _dataclasses(item, visited)
    declared = getattr(kind, "cls", None)
    if not isinstance(kind, msgspec.Struct) or declared in visited:
        return
    if declared is not None:
        visited.add(declared)
    if isinstance(kind, msgspec.inspect.DataclassType):
        yield declared
    for name in kind.__struct_fields__:
        yield from _dataclasses(getattr(kind, name), visited)


def _describe(part: dict[str, Any], dataclass: Any) -> None:
    """Describe a dataclass and its fields by `field_meanings`, as the table of settings does."""
    part["description"] = str(inspect.getdoc(dataclass)).partition("\n")[0]
    meanings = dataclass.field_meanings()
    for name, value in part["properties"].items():
        value["description"] = f"{meanings[name][:1].upper()}{meanings[name][1:]}."
