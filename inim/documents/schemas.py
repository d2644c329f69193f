"""JSON Schemas (draft 2020-12) of the documents, generated from their declarations."""

from __future__ import annotations

import inspect
from importlib import import_module
from typing import Any

import msgspec

import inim.schemas

_DRAFT = "https://json-schema.org/draft/2020-12/schema"
# Class of each document, in the module of the document's name, which loads on demand.
_CLASSES: dict[str, str] = {}
#: Names of the documents.
NAMES = inim.schemas.NAMES


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
        return inim.schemas.schema(name)  # not converted yet
    declaration = getattr(import_module(f"inim.documents.{name}"), _CLASSES[name])
    _, parts = msgspec.json.schema_components([declaration], ref_template="#/$defs/{name}")
    own = parts.pop(declaration.__name__)
    title, _, description = str(inspect.getdoc(declaration)).partition("\n\n")
    tag = declaration.__struct_config__.tag
    head = {
        "$schema": _DRAFT,
        "$id": f"urn:{(tag or f'inim.{name}/1').replace('.', ':').replace('/', ':')}",
        "title": title.removesuffix("."),
        "description": " ".join(description.split()),
    }
    return head | {k: v for k, v in own.items() if k not in head} | {"$defs": parts}
