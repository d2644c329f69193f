"""The schemas of the documents that inim writes.

Expected: each is a schema, says what each key is, and is complete: whatever is taken from a
document, added to it or of another type is refused. The committed documents keep theirs, and keys
that follow from the code are those of the code.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from inim.display import DISPLAYS
from inim.documents import NAMES, schema
from inim.documents.parts import DerivedDisplay
from inim.sweep import table, task
from tests.schemas import (
    FOLDER,
    assert_schema,
    example,
    file_of,
    flat,
    members,
    read_document,
    validator,
)

ROOT = Path(__file__).parents[2]
# Of the gallery only its reports are documents; the rest is what its page is made of. Studies of
# the project's own have tables of their own.
OWN_KIND = {
    ROOT / "reports/stress/stress.json",
    ROOT / "reports/scoreboard/scoreboard.json",
    ROOT / "reports/one_picture/one_picture.json",
    ROOT / "reports/calibration/calibration.json",
    ROOT / "reports/calibration/shown.json",
    *ROOT.glob("reports/gallery/**/entry.json"),
    ROOT / "reports/gallery/gallery.json",
    *ROOT.glob("reports/**/.*-files.json"),  # lists of the files of an output folder
}
COMMITTED = sorted(set(ROOT.glob("reports/**/*.json")) - OWN_KIND)
SCHEMAS = {
    "sweep": table.SCHEMA,
    "unit": task.SCHEMA,
}
# Keys that need not be there.
OPTIONAL = {
    "unit": {
        *(f"making/{key}" for key in ("entry_point", "version", "sha256")),
        "key/lazy", "key/metrics", "key/metrics/a/version", "key/metrics/a/sha256",
    },
}  # fmt: skip
# Displays that need not have all parameters: the others are defaults, or came later.
PARTLY = ("conditions/display/", "display/given/")

At = tuple[str | int, ...]
every = pytest.mark.parametrize("name", SCHEMAS)  # those with a schema file


@cache
def whole(name: str) -> tuple[Any, dict[At, dict[str, Any]]]:
    """An example of a schema, and the schema of every place in it."""

    def places(part: dict[str, Any], at: At) -> Iterator[tuple[At, dict[str, Any]]]:
        part = flat(part, name)
        yield at, part
        inner: list[tuple[Any, Any]] = []
        if "object" in part["type"]:
            inner = members(part)
        elif "array" in part["type"]:
            inner = list(enumerate(part.get("prefixItems") or [part.get("items")]))
        for key, one in inner:
            if one is not None:
                yield from places(one, (*at, key))

    return example(schema(name), name), dict(places(schema(name), ()))


def let_in(name: str, changes: list[tuple[At, Any]]) -> list[str]:
    """Places whose change, to a value or to nothing at all (None), makes no difference."""
    found, held = [], validator(SCHEMAS[name])
    for at, value in changes:
        document = copy.deepcopy(whole(name)[0])
        holder = document
        for key in at[:-1]:
            holder = holder[key]
        if value is None:
            del holder[at[-1]]
        else:
            holder[at[-1]] = value
        if held.is_valid(document):
            found.append("/".join(map(str, at)))
    return found


# -- the files ------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.json")), ids=lambda p: p.name)
def test_file_is_a_schema_and_says_what_each_key_is(path: Path) -> None:
    text = path.read_text("utf-8")
    found = json.loads(text)
    Draft202012Validator.check_schema(found)
    assert found["$schema"] == Draft202012Validator.META_SCHEMA["$id"]
    assert found["title"] and found["description"].endswith(".")
    assert text == json.dumps(found, indent=2, ensure_ascii=False) + "\n", "its layout"
    untold = [key for key, part in properties_in(found) if not is_told(part)]
    assert untold == []


def properties_in(value: Any) -> Iterator[tuple[str, Any]]:
    """All properties in a schema, by key."""
    if isinstance(value, dict):
        # Those below `then` only add to what is said elsewhere.
        yield from value.get("properties", {}).items()
        value = [one for key, one in value.items() if key not in ("if", "then")]
    for one in value if isinstance(value, list) else ():
        yield from properties_in(one)


def is_told(part: Any) -> bool:
    """Whether a property has a description: its own or, in this package, that of its part."""
    if "$ref" in part and "description" not in part:
        part = file_of("parts")["$defs"].get(part["$ref"].rpartition("/")[2]) or part
    return "$ref" in part or part["description"].endswith(".")


def test_files_are_those_that_are_named_and_every_part_is_used() -> None:
    assert {p.name.partition(".")[0] for p in FOLDER.glob("*.json")} == {*SCHEMAS, "parts"}
    parts, used = file_of("parts")["$defs"], set()
    for name in SCHEMAS:
        own = file_of(name).get("$defs", {}).keys()
        assert not own & parts.keys(), "one would stand for the other"
        used |= schema(name).get("$defs", {}).keys()
    assert parts.keys() <= used
    with pytest.raises(ValueError, match=r"'parts'.*report"):
        schema("parts")


@every
def test_schema_names_what_the_code_writes(name: str) -> None:
    assert schema(name)["$id"] == "urn:" + SCHEMAS[name].replace(".", ":").replace("/", ":")
    if name != "sweep":  # there the table's metadata name it
        assert schema(name)["properties"]["schema"]["const"] == SCHEMAS[name]


@pytest.mark.parametrize("name", [name for name in NAMES if name not in SCHEMAS])
def test_generated_schema_describes_each_key(name: str) -> None:
    generated = schema(name)
    Draft202012Validator.check_schema(generated)
    Draft202012Validator(generated).validate(example(generated, name))
    assert generated["title"] and generated["description"].endswith(".")
    parts = generated["$defs"]
    undescribed = [
        key
        for key, part in properties_in(generated)
        if key != "schema" and "description" not in part | parts.get(referred(part), {})
    ]
    assert undescribed == []


def referred(part: dict[str, Any]) -> str:
    """Name of the part that is referred to, alone or as an alternative to null."""
    choices = [part, *part.get("anyOf", ())]
    return next((one["$ref"] for one in choices if "$ref" in one), "").rpartition("/")[2]


# -- what is refused ------------------------------------------------------------------------------


@every
def test_example_is_valid_and_so_is_the_file_with_its_parts_apart(name: str) -> None:
    document = whole(name)[0]
    Draft202012Validator(schema(name)).validate(document)
    validator(SCHEMAS[name]).validate(document)


@every
def test_each_missing_key_is_refused_but_those_that_need_not_be_there(name: str) -> None:
    keys = [
        at
        for at in whole(name)[1]
        if at and at[-1] in whole(name)[1][at[:-1]].get("properties", ())
        if not "/".join(map(str, at)).startswith(PARTLY)
    ]
    assert len(keys) > 20
    needed = [key for key in keys if "/".join(map(str, key)) not in OPTIONAL.get(name, ())]
    assert len(needed) == len(keys) - len(OPTIONAL.get(name, ()))
    assert let_in(name, [(at, None) for at in needed]) == []


@every
def test_an_unknown_key_is_refused(name: str) -> None:
    # What a study adds to a bench is its own.
    objects = [
        at
        for at, part in whole(name)[1].items()
        if "object" in part["type"] and "additionalProperties" in part
    ]
    assert objects
    assert let_in(name, [((*at, "nobody's"), True) for at in objects]) == []


@every
def test_another_type_is_refused(name: str) -> None:
    changes = [
        (at, "text" if {"object", "array"} & {*_types(part)} else {"nobody's": True})
        for at, part in whole(name)[1].items()
        if at
    ]
    assert let_in(name, changes) == []


def _types(part: dict[str, Any]) -> list[str]:
    return [part["type"]] if isinstance(part["type"], str) else part["type"]


# -- the code's own keys --------------------------------------------------------------------------


def test_derived_lengths_of_a_display_are_those_of_the_code() -> None:
    for display in DISPLAYS.values():
        assert list(DerivedDisplay.__struct_fields__) == list(display.derived())


def test_a_sweep_s_columns_are_those_of_the_code() -> None:
    assert list(schema("sweep")["properties"]) == list(table.columns())


# -- documents ------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", COMMITTED, ids=lambda path: str(path.relative_to(ROOT)))
def test_committed_document_keeps_its_schema(path: Path) -> None:
    read_document(path)


def test_a_document_that_does_not_is_told_where() -> None:
    document = copy.deepcopy(example(schema("report"), "report"))
    document["verdict"]["passed"] = "yes"
    with pytest.raises(AssertionError, match=r"verdict\.passed: 'yes' is not of type 'boolean'"):
        assert_schema(document)
