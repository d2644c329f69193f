"""JSON Schemas (draft 2020-12) of the documents, generated from their declarations."""

from __future__ import annotations

import inspect
from dataclasses import fields
from importlib import import_module
from typing import Any

import msgspec

from inim.display import Display
from inim.settings import Settings

_DRAFT = "https://json-schema.org/draft/2020-12/schema"
# Class of each document, in the module of the document's name, which loads on demand.
_CLASSES = {
    "report": "ReportDocument",
    "picture": "PictureDocument",
    "compare": "CompareDocument",
    "baseline": "BaselineDocument",
    "bench": "BenchDocument",
    "calibration": "CalibrationDocument",
    "inspect": "InspectDocument",
    "patterns": "PatternsDocument",
    "photo": "PhotoDocument",
    "stress": "StressDocument",
    "tolerate": "ToleranceDocument",
    "unit": "UnitDocument",
}
#: Names of the documents.
NAMES = tuple(_CLASSES)


def schema(name: str) -> dict[str, Any]:
    """The JSON Schema of a document, complete in itself.

    Parameters
    ----------
    name : str
        One of `NAMES`.

    Raises
    ------
    ValueError
        Another name.
    """
    if name not in _CLASSES:
        raise ValueError(f"schema {name!r}: use {' or '.join(NAMES)}")
    declaration = getattr(import_module(f"inim.documents.{name}"), _CLASSES[name])
    _, parts = msgspec.json.schema_components([declaration], ref_template="#/$defs/{name}")
    own = parts.pop(declaration.__name__)
    for dataclass in (Display, Settings):
        if dataclass.__name__ in parts:
            _describe(parts[dataclass.__name__], dataclass)
    title, _, description = str(inspect.getdoc(declaration)).partition("\n\n")
    tag = declaration.__struct_config__.tag
    head = {
        "$schema": _DRAFT,
        "$id": f"urn:{(tag or f'inim.{name}/1').replace('.', ':').replace('/', ':')}",
        "title": title.removesuffix("."),
        "description": " ".join(description.split()),
    }
    return head | {k: v for k, v in own.items() if k not in head} | {"$defs": parts}


def _describe(part: dict[str, Any], dataclass: type) -> None:
    """Describe the fields of a display or of settings as the table of settings does."""
    part["description"] = str(inspect.getdoc(dataclass)).partition("\n")[0]
    meanings = {f.name: f.metadata["meaning"] for f in fields(Settings)} | {"name": "its name"}
    for name, value in part["properties"].items():
        value["description"] = f"{meanings[name][:1].upper()}{meanings[name][1:]}."
