"""Pages made of the program itself: settings, commands, algorithms, sweep columns, documents.

`python docs/generate.py` writes them into docs/generated, as each build of the site does first.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from inim.cli import COMMANDS
from inim.documents import NAMES, schema
from inim.pipeline.stages.method import algorithm_table
from inim.settings import setting_table
from inim.sweep.table import columns_as_markdown

sys.path.insert(0, str(Path(__file__).parents[1]))  # the project's own folders
from reports.gallery.page import gallery_page

__all__ = ["write"]


def write(docs: Path) -> None:
    """Write every generated page below `docs`/generated."""
    folder = docs / "generated"
    folder.mkdir(exist_ok=True)
    for name, text in {
        "settings.md": setting_table(),
        "commands.md": _commands(),
        "algorithms.md": f"```text\n{algorithm_table()}\n```",
        "documents.md": _documents(),
        "gallery.md": gallery_page(docs.parent),
        "sweep-columns.md": columns_as_markdown(),
    }.items():
        path, text = folder / name, text.rstrip() + "\n"
        if not path.exists() or path.read_text("utf-8") != text:  # else pages are made anew
            path.write_text(text, "utf-8")


def _commands() -> str:
    """The help of every command, as its parser prints it."""
    os.environ["COLUMNS"] = "88"
    parts = []
    for name, module in COMMANDS.items():
        command = import_module(f"inim.commands.{module}").COMMANDS[name]
        parser = argparse.ArgumentParser(prog=f"inim {name}")
        command.add_arguments(parser)
        parts.append(f"## inim {name}\n\n{command.summary}\n\n```text\n{parser.format_help()}```\n")
    return "\n".join(parts)


#: A part of several documents with more properties than this has a table of its own.
_MOST_PROPERTIES = 10


def _documents() -> str:
    """A table for each schema: what keys there are, of which type, and what they mean."""
    documents = [schema(name) for name in NAMES]
    shared: dict[str, Any] = {}
    for one in documents:
        shared |= one.get("$defs", {})
    large = [name for name, part in shared.items() if _is_large(part)]
    sections = [(one["title"], one["description"], one) for one in documents]
    sections += [(f"Part: {n}", shared[n].get("description", ""), shared[n]) for n in sorted(large)]
    head = "| key | type | meaning |\n| --- | --- | --- |"
    return "\n".join(
        f"## {title}\n\n{said}\n\n{head}\n" + "\n".join(_rows(part, shared, "")) + "\n"
        for title, said, part in sections
    )


def _is_large(part: Mapping[str, Any]) -> bool:
    return len(part.get("properties", {})) > _MOST_PROPERTIES


def _rows(part: Mapping[str, Any], shared: Mapping[str, Any], path: str) -> Iterator[str]:
    """A row for each property of an object; those of objects below it, by their paths."""
    for key, stated in part.get("properties", {}).items():
        yield from _row(stated, shared, f"{path}.{key}" if path else key)
    others = part.get("additionalProperties")
    if isinstance(others, dict) and others:
        yield from _row(others, shared, f"{path}.NAME" if path else "NAME")


def _row(stated: Mapping[str, Any], shared: Mapping[str, Any], path: str) -> Iterator[str]:
    whole = _resolved(stated, shared)
    meaning = " ".join(str(whole.get("description", "")).split()).replace("|", "\\|")
    name = _referred(stated)
    if name and _is_large(shared[name]):
        yield f"| `{path}` | [{name}](#part-{name.lower()}) | {meaning} |"
        return
    yield f"| `{path}` | {_type(whole, shared)} | {meaning} |"
    yield from _rows(whole, shared, path)
    items = whole.get("items")
    if isinstance(items, dict):
        yield from _rows(_resolved(items, shared), shared, f"{path}[]")


def _referred(stated: Mapping[str, Any]) -> str:
    """Name of the shared part that is referred to, or nothing."""
    return str(stated.get("$ref", "")).rpartition("/")[2]


def _resolved(stated: Mapping[str, Any], shared: Mapping[str, Any]) -> dict[str, Any]:
    """A part with what it refers to in it; its own words go first."""
    if "anyOf" in stated:  # a value or null
        values = [_resolved(one, shared) for one in stated["anyOf"]]
        kinds = " or ".join(_type(one, shared) for one in values)
        return values[0] | {k: v for k, v in stated.items() if k != "anyOf"} | {"kinds": kinds}
    name = _referred(stated)
    return (_resolved(shared[name], shared) if name else {}) | dict(stated)


def _type(whole: Mapping[str, Any], shared: Mapping[str, Any]) -> str:
    if "kinds" in whole:
        return str(whole["kinds"])
    if "enum" in whole:
        return " or ".join("null" if one is None else f"`{one}`" for one in whole["enum"])
    kinds = whole.get("type", "any")
    kinds = [kinds] if isinstance(kinds, str) else kinds
    if kinds == ["array"] and isinstance(whole.get("items"), dict):
        return f"array of {_type(_resolved(whole['items'], shared), shared)}"
    return " or ".join(kinds)


if __name__ == "__main__":
    write(Path(__file__).parent)
