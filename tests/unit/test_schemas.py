"""The schemas of the documents that inim writes.

Expected: each is a schema and describes each key; the committed documents keep theirs.
"""

import copy
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from inim.cli.schemas import NAMES, schema
from inim.display import DISPLAYS
from inim.scores.document_parts import DerivedDisplay
from tests.schemas import assert_schema, example, read_document

ROOT = Path(__file__).parents[2]
OWN_KIND = {
    *(ROOT / f"reports/{name}/{name}.json" for name in ("reality", "scoreboard")),  # no tag yet
    # Studies, whose class reads them, and results of earlier versions of the bench.
    *(
        path
        for path in ROOT.glob("reports/**/*.json")
        if re.match(r'{\s*"schema": ?"inim\.(study/1|bench/2)"', path.read_text("utf-8"))
    ),
    *ROOT.glob("reports/**/.*-files.json"),  # lists of the files of an output folder
}
COMMITTED = sorted(set(ROOT.glob("reports/**/*.json")) - OWN_KIND)


def properties_in(value: Any) -> Iterator[tuple[str, Any]]:
    """All properties in a schema, by key."""
    if isinstance(value, dict):
        yield from value.get("properties", {}).items()
        value = list(value.values())
    for entry in value if isinstance(value, list) else ():
        yield from properties_in(entry)


@pytest.mark.parametrize("name", NAMES)
def test_generated_schema_describes_each_key(name):
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
    return next((choice["$ref"] for choice in choices if "$ref" in choice), "").rpartition("/")[2]


def test_another_name_is_refused():
    with pytest.raises(ValueError, match=r"'parts'.*report"):
        schema("parts")


def test_derived_lengths_of_a_display_are_those_of_the_code():
    for display in DISPLAYS.values():
        assert list(DerivedDisplay.__struct_fields__) == list(display.derived_quantities())


@pytest.mark.parametrize("path", COMMITTED, ids=lambda path: str(path.relative_to(ROOT)))
def test_committed_document_keeps_its_schema(path):
    read_document(path)


def test_an_invalid_document_is_refused_with_the_place():
    document = copy.deepcopy(example(schema("report"), "report"))
    document["verdict"]["passed"] = "yes"
    with pytest.raises(AssertionError, match=r"verdict\.passed: 'yes' is not of type 'boolean'"):
        assert_schema(document)
