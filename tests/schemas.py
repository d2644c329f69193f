"""Documents held to their schemas, wherever a test reads one."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match
from referencing import Registry, Resource

import inim.schemas

FOLDER = Path(inim.schemas.__file__).parent
#: Of the study of accuracy, whose stress.json is not that of the command.
STUDY = Path(__file__).parents[1] / "reports" / "stress" / "study" / "stress.schema.json"


def read_document(path: Path) -> dict[str, Any]:
    """A document from its file, which must keep its schema."""
    return read_text(path.read_text("utf-8"))


def read_text(text: str) -> dict[str, Any]:
    """A document from its text, which must be strict JSON and keep its schema."""
    document = json.loads(text, parse_constant=_no_number)
    assert_schema(document)
    return dict(document)


def assert_schema(document: Mapping[str, Any]) -> None:
    """A document keeps the schema that it names."""
    _assert_valid(document, document["schema"])


def assert_rows(rows: Iterable[Mapping[str, Any]]) -> None:
    """Rows of a sweep's table keep their schema."""
    for row in rows:
        _assert_valid(row, "inim.sweep/1")


def _assert_valid(document: Mapping[str, Any], named: str) -> None:
    worst = best_match(validator(named).iter_errors(document))
    assert worst is None, f"{worst.json_path}: {worst.message[:500]}"


def _no_number(name: str) -> float:
    raise AssertionError(f"{name} is no strict JSON")


@cache
def validator(named: str) -> Draft202012Validator:
    """Of the documents that name this schema, such as ``inim.report/1``."""
    found = _files()["urn:" + named.replace(".", ":").replace("/", ":")]
    known = [(name, Resource.from_contents(one)) for name, one in _files().items()]
    return Draft202012Validator(found, registry=Registry().with_resources(known))


def file_of(name: str) -> dict[str, Any]:
    """A schema as its file has it."""
    return _read(FOLDER / f"{name}.schema.json")


@cache
def _files() -> dict[str, dict[str, Any]]:
    """All files, by what they are called in references."""
    return {one["$id"]: one for one in map(_read, [*FOLDER.glob("*.json"), STUDY])}


def _read(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text("utf-8")))
