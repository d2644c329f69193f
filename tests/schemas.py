"""Documents of the tests, checked against their schemas."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match

from inim.apps.sweep.table import columns
from inim.cli import schemas
from inim.display import DISPLAYS
from inim.display.settings import Settings
from inim.report.document import ALGORITHM_VIEW_SCORES, ReportDocument
from inim.scores.document_parts import EIA_SCORES, VIEW_SCORES

schema = cache(schemas.schema)


def read_document(path: Path) -> dict[str, Any]:
    """Read a document and check it against its schema."""
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
    """Rows of a sweep's table have its columns, each with a value of its type or null."""
    types = {"string": str, "float64": float, "int64": int, "bool": bool}
    for row in rows:
        assert list(row) == list(columns())
        for name, kind in columns().items():
            assert row[name] is None or type(row[name]) is types[kind], (name, row[name])


def _assert_valid(document: Mapping[str, Any], named: str) -> None:
    worst = best_match(validator(named).iter_errors(document))
    assert worst is None, f"{worst.json_path}: {worst.message[:500]}"


def _no_number(name: str) -> float:
    raise AssertionError(f"{name} is no strict JSON")


@cache
def validator(named: str) -> Draft202012Validator:
    """Validator of the documents with this schema name, such as ``inim.report/1``."""
    by_tag = {s["properties"]["schema"]["enum"][0]: s for s in map(schema, schemas.NAMES)}
    return Draft202012Validator(by_tag[named])


def flat(part: dict[str, Any], name: str) -> dict[str, Any]:
    """Replace the references of a part of a schema by their definitions."""
    if "anyOf" in part:  # a value or null
        values = [flat(option, name) for option in part["anyOf"]]
        kinds = [kind for value in values for kind in types_of(value)]
        return values[0] | {k: v for k, v in part.items() if k != "anyOf"} | {"type": kinds}
    if "$ref" not in part:
        return part
    definition = flat(schema(name)["$defs"][part["$ref"].removeprefix("#/$defs/")], name)
    required = [*definition.get("required", ()), *part.get("required", ())]
    return definition | part | ({"required": required} if required else {})


# Complete examples of dataclasses: separate examples of their fields may be inconsistent.
DATACLASSES = {"Display": asdict(DISPLAYS["nominal"]), "Settings": asdict(Settings())}
DATACLASSES = json.loads(json.dumps(DATACLASSES))


def types_of(part: dict[str, Any]) -> list[str]:
    """JSON types that a flat part allows."""
    if "enum" in part:
        return ["string"]
    return [part["type"]] if isinstance(part["type"], str) else part["type"]


def example(part: dict[str, Any], name: str) -> Any:
    """Example of a schema with all optional members; arrays have the smallest length."""
    part = flat(part, name)
    if part.get("title") in DATACLASSES:
        return DATACLASSES[part["title"]]
    if "const" in part:
        return part["const"]
    for keyword in ("examples", "enum"):
        if keyword in part:
            return part[keyword][0]
    kind = types_of(part)[0]
    if kind == "object":
        return {key: example(member, name) for key, member in members(part)}
    if kind == "array":
        items = part.get("prefixItems") or [part["items"]] * part.get("minItems", 1)
        return [example(item, name) for item in items]
    return {"string": "text", "number": 0.5, "integer": 1, "boolean": True}[kind]


def members(part: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Keys of an object's example, each with its schema."""
    allows = Draft202012Validator(part.get("propertyNames", True)).is_valid
    properties, required = part.get("properties", {}), part.get("required", ())
    pairs = [
        (key, member)
        for key, member in properties.items()
        if allows(key) and (key != "not_finite" or key in required)
    ]
    if part.get("additionalProperties"):
        key = next(filter(allows, ("a", "a_to_reference")))
        pairs.append((key, part["additionalProperties"]))
    return pairs


def completed(name: str, document: Mapping[str, Any]) -> dict[str, Any]:
    """Add examples of all required members that a document lacks."""
    complete: dict[str, Any] = _completed(schema(name), name, document)
    return complete


def _completed(part: dict[str, Any], name: str, value: Any) -> Any:
    part = flat(part, name)
    if isinstance(value, Mapping):
        if part.get("title") in DATACLASSES:
            return {**DATACLASSES[part["title"]], **value}
        properties, others = part.get("properties", {}), part.get("additionalProperties")
        required = {key: example(properties[key], name) for key in part.get("required", ())}
        schemas = {key: properties.get(key, others or {}) for key in value}
        return required | {k: _completed(schemas[k], name, v) for k, v in value.items()}
    if isinstance(value, list) and "items" in part and "prefixItems" not in part:
        return [_completed(part["items"], name, item) for item in value]
    return value


def report_document(data: Mapping[str, Any]) -> ReportDocument:
    """Report with these keys, without other scores, and with examples of all other keys."""
    names = [eye["name"] for eye in data.get("viewpoints", ())]
    floor, reference = data.get("noise_floor", {}), data.get("reference", {})
    empty: dict[str, Any] = {name: {} for name in names}
    scored = {
        "noise_floor": {
            "eia": dict.fromkeys(EIA_SCORES) | floor.get("eia", {}),
            "views": _scored(empty | floor.get("views", {}), VIEW_SCORES),
        },
        "reference": reference
        | {"views": _scored(empty | reference.get("views", {}), VIEW_SCORES)},
        "algorithms": {
            name: {"precision": {}, "seconds": None}
            | result
            | {
                "eia": dict.fromkeys([*EIA_SCORES, "hole_fraction"]) | result.get("eia", {}),
                "views": _scored(result.get("views", {}), ALGORITHM_VIEW_SCORES),
            }
            for name, result in data.get("algorithms", {}).items()
        },
    }
    eyes = [{"position_mm": [0.0, 0.0, 400.0]} | eye for eye in data.get("viewpoints", ())]
    defaults = {"scene": {}, "misalign": "", "warnings": [], "skipped": [], "preview": None}
    whole = completed("report", {**defaults, **data, **scored, "viewpoints": eyes})
    whole["timings"] = dict.fromkeys(("start", "mitsuba_render", "total"), 0.0) | whole["timings"]
    return msgspec.convert(whole, ReportDocument)


def _scored(views: Mapping[str, Any], names: Iterable[str]) -> dict[str, Any]:
    return {view: dict.fromkeys(names) | scores for view, scores in views.items()}
