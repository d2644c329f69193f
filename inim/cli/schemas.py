"""JSON Schemas of all documents, by name."""

from importlib import import_module
from typing import Any

from inim.apps import APPS
from inim.system.document import document_schema

# Module and class of each document; the module loads on demand.
_CLASSES = {
    "report": "inim.report.document:ReportDocument",
    "compare": "inim.scores.regression.document:CompareDocument",
    "baseline": "inim.scores.regression.document:BaselineDocument",
} | {
    name: f"inim.apps.{folder}.document:{declaration}"
    for folder, app in APPS.items()
    for name, declaration in app.get("documents", {}).items()
}
#: Names of the documents.
NAMES = tuple(_CLASSES)


def schema(name: str) -> dict[str, Any]:
    """The JSON Schema of a document, complete in itself.

    * `name`: one of `NAMES`.

    Raises `ValueError`: another name.
    """
    if name not in _CLASSES:
        raise ValueError(f"schema {name!r}: use {' or '.join(NAMES)}")
    module, _, declaration = _CLASSES[name].partition(":")
    return document_schema(getattr(import_module(module), declaration), f"inim.{name}/1")
