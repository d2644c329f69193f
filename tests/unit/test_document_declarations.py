"""Documents: strict JSON in, typed values out, and back.

Expected: each refusal is one short line that gives the place and the remedy; numbers that are not
finite return as NaN, and an infinite PSNR as null.
"""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import pytest
from jsonschema import Draft202012Validator

from inim.cli.schemas import schema
from inim.report.document import ReportDocument
from inim.scores.regression.document import BaselineDocument, CompareDocument
from inim.system.document import Document, Part, decode, doc, encode, read_document, write_document
from inim.system.errors import FileError
from tests.schemas import DATACLASSES, completed

OLDER_REPORTS = Path(__file__).parent / "older_reports"


class Score(Part):
    value: float | None
    note: str = ""


class Notes(Document, tag="inim.notes/1"):
    title: Annotated[str, doc("Title.")]
    scores: dict[str, Score] = {}  # noqa: RUF012
    columns: int = 1


class Other(Document, tag="inim.other/3"):
    title: str


def refusal(path: Path, content: str | bytes) -> str:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(FileError) as caught:
        read_document(path, "write it again", Notes, Other)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and message.endswith("; write it again")
    assert message.isprintable() and len(message) < len(str(path)) + 260
    return message


def test_document_reads_back_as_written(tmp_path):
    document = Notes(title="jug \udcff", scores={"a": Score(value=0.5, note="b")}, columns=3)
    write_document(tmp_path / "notes.json", document)
    assert read_document(tmp_path / "notes.json", "", Other, Notes) == document


def test_defaults_are_left_out():
    assert json.loads(encode(Notes(title="a"))) == {"schema": "inim.notes/1", "title": "a"}


def test_numbers_that_are_not_finite_are_null_and_return_as_nan():
    values = {"nan": math.nan, "low": -math.inf, "psnr": math.inf, "none": None}
    text = encode(Notes(title="a", scores={k: Score(value=v) for k, v in values.items()}))
    assert json.loads(text)["not_finite"] == [["scores", k, "value"] for k in ("nan", "low")]
    scores = decode(text, Notes).scores
    assert math.isnan(scores["nan"].value or 0) and math.isnan(scores["low"].value or 0)
    assert scores["psnr"].value is None and scores["none"].value is None
    assert encode(decode(text, Notes)) == text


NOTES: dict[str, Any] = {"schema": "inim.notes/1", "title": "a"}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "not a JSON document"),
        (b"\xff\xfe", "can't decode byte"),
        ("[" * 100_000, "nested too deeply"),
        ('{"a":' * 100_000, "nested too deeply"),
        ("[]", "schema is null, not inim.notes/1 or inim.other/3"),
        (json.dumps({"schema": ["inim.notes/1"]}), 'schema is ["inim.notes/1"], not'),
        (json.dumps(NOTES | {"schema": "inim.notes/9"}), "schema is 'inim.notes/9', not"),
        (json.dumps({"schema": "inim.notes/1"}), "missing required field `title`"),
        (json.dumps(NOTES | {"mine": 1}), "unknown field `mine`"),
        (json.dumps(NOTES | {"\x1b" * 10**6: 1}), "unknown field"),
        (json.dumps(NOTES | {"title": 7}), "got `int` - at `$.title`"),
        (json.dumps(NOTES | {"columns": 12.0}), "got `float` - at `$.columns`"),
        (json.dumps(NOTES | {"columns": True}), "got `bool` - at `$.columns`"),
        (json.dumps(NOTES | {"scores": {"a": {"value": "0"}}}), "at `$.scores[...].value`"),
        (json.dumps(NOTES | {"not_finite": [["title"]]}), "where there is no null"),
        (json.dumps(NOTES | {"not_finite": [["scores", 3]]}), "where there is no null"),
        (json.dumps(NOTES | {"not_finite": [[]]}), "where there is no null"),
        (json.dumps(NOTES | {"not_finite": 3}), "at `$.not_finite`"),
        (json.dumps(NOTES | {"columns": math.nan}), "NaN is not a finite number"),
        (json.dumps(NOTES)[:-1] + ', "columns": 1e999}', "1e999 is not a finite number"),
        (json.dumps(NOTES | {"columns": 0}).replace("0", "9" * 4000), "an integer of 4000 digits"),
        ("[" + "0," * 300_001 + "0]", "300001 values; at most 300000"),
        (" " * (2**24 + 1), "at most 16 MiB are read"),
    ],
)  # fmt: skip
def test_a_refusal_is_one_line_with_the_place(content, message, tmp_path):
    assert message in refusal(tmp_path / "notes.json", content)


# -- the project's documents, with jsonschema as the oracle ----------------------------------------

NAMED = {"viewpoints": [{"name": "centre", "position_mm": [0.0, 0.0, 400.0]}]}
VIEWS = {"views": {"centre": {}}}
SOUND: dict[str, dict[str, Any]] = {
    "report": NAMED
    | {"scene": {}}
    | {"noise_floor": VIEWS, "reference": VIEWS, "algorithms": {"template": VIEWS}, "misalign": ""},
    "compare": {},
    "baseline": {},
}
TYPES: dict[str, type[Document]] = {
    "report": ReportDocument,
    "compare": CompareDocument,
    "baseline": BaselineDocument,
}


def mutations(value: Any) -> Iterator[Any]:
    """Copies of a value: each with a key more or less, or a value of another type."""
    if isinstance(value, dict):
        yield value | {"nobody's": 1}
        for key, inner in value.items():
            yield {k: v for k, v in value.items() if k != key}
            yield value | {key: "text" if isinstance(inner, (dict, list)) else {"nobody's": 1}}
            yield from (value | {key: mutated} for mutated in mutations(inner))
    elif isinstance(value, list):
        for place, inner in enumerate(value):
            for mutated in mutations(inner):
                yield [*value[:place], mutated, *value[place + 1 :]]


@pytest.mark.parametrize("name", SOUND)
def test_reader_accepts_its_documents_and_refuses_what_the_schema_refuses(name):
    document = completed(name, SOUND[name])
    validator = Draft202012Validator(schema(name))
    validator.validate(document)
    decoded = decode(json.dumps(document), TYPES[name])
    validator.validate(json.loads(encode(decoded)))
    assert decode(encode(decoded), TYPES[name]) == decoded
    refused = 0
    for mutated in mutations(document):
        try:
            decode(json.dumps(mutated), TYPES[name])
        except ValueError:
            refused += 1
        else:
            validator.validate(mutated)
    assert refused > 100


@pytest.mark.parametrize("path", sorted(OLDER_REPORTS.glob("*.json")), ids=str)
def test_older_report_reads_and_writes_back_equal(path):
    """But for parameters newer than the report, which have their defaults."""
    text = path.read_text("utf-8")
    document = json.loads(text)
    display = document["display"]
    display["parameters"] = DATACLASSES["Display"] | display["parameters"]
    assert json.loads(encode(decode(text, ReportDocument))) == document


def test_half_of_a_surrogate_pair_is_refused():
    text = '{"schema": "inim.report/2", "title": "\\ud800"}'
    with pytest.raises(ValueError, match="half of a surrogate pair"):
        decode(text, ReportDocument)
