"""Generate the reference pages, the gallery's cards, and the virtual display of the front page.

`python docs/generate.py` writes them into docs/generated. Every build of the site does this first.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import yaml
from PIL import Image

import inim
from inim.apps.sweep.table import columns_as_markdown
from inim.cli.main import COMMANDS
from inim.cli.schemas import NAMES, schema
from inim.display.settings import setting_table
from inim.pipeline.stages.method import algorithm_table
from inim.report.view_page import view_eia

sys.path.insert(0, str(Path(__file__).parents[1]))  # the project's own folders
from reports.gallery.examples import cards, examples_with, read_examples

#: Examples on the front page.
_FRONT = ("relics", "algorithms", "zone", "inspect", "looking-glass", "museum-room")

__all__ = ["write"]


def write(docs: Path) -> None:
    """Write every generated page below `docs`/generated."""
    folder = docs / "generated"
    folder.mkdir(exist_ok=True)
    examples = read_examples()
    for name, text in {
        "settings.md": setting_table(),
        "commands.md": _commands(),
        "algorithms.md": f"```text\n{algorithm_table()}\n```",
        "documents.md": _documents(),
        "gallery-cards.md": cards(examples),
        "front-cards.md": cards([e for e in examples if e.name in _FRONT]),
        "python-names.md": _python_names(),
        "citation.md": _citation(docs.parent / "CITATION.cff"),
        "sweep-columns.md": columns_as_markdown(),
    }.items():
        path, text = folder / name, text.rstrip() + "\n"
        if not path.exists() or path.read_text("utf-8") != text:  # unchanged pages are not rebuilt
            path.write_text(text, "utf-8")
    _write_virtual_display(docs / "images" / "goblet-eia.webp", folder / "site")


def _write_virtual_display(eia: Path, folder: Path) -> None:
    """Write the virtual display of a compressed EIA into a folder that the site copies."""
    folder.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary, Image.open(eia) as image:
        codes = Path(temporary, "goblet and coin.png")
        image.convert("RGB").save(codes)
        view_eia(codes, folder / "virtual-display.html", "fine", most_bytes=500_000)


def _python_names() -> str:
    """Table of all public names with their first sentences."""
    names = "\n   ".join(f"inim.{name}" for name in inim.__all__ if name != "__version__")
    return f"```{{eval-rst}}\n.. autosummary::\n   :nosignatures:\n\n   {names}\n```"


def _citation(path: Path) -> str:
    """BibTeX entry of the project."""
    entry = yaml.safe_load(path.read_text("utf-8"))
    fields = {
        "title": f"{{{entry['title']}}}",
        "author": f"{{{entry['authors'][0]['name']}}}",
        "version": entry["version"],
    }
    lines = "".join(f"  {name} = {{{value}}},\n" for name, value in fields.items())
    return f"```bibtex\n@software{{inim,\n{lines}}}\n```"


def gallery_links(call: str, pattern: str) -> str:
    """Links to the gallery's examples of a function or command, or an empty string.

    `pattern` is the markup of a link, with fields for title and target.
    """
    return ", ".join(pattern.format(e.title, f"example-{e.name}") for e in examples_with(call))


def _commands() -> str:
    """Help texts of all commands."""
    os.environ["COLUMNS"] = "88"
    parts = []
    for name, module in COMMANDS.items():
        command = import_module(module).COMMANDS[name]
        parser = argparse.ArgumentParser(prog=f"inim {name}")
        command.add_arguments(parser)
        text = f"{parser.format_help()}\nexample:\n  {command.example}\n"
        parts += [f"## inim {name}", command.summary, f"```text\n{text}```"]
        links = gallery_links(f"inim {name}", "[{}](#{})")
        parts += [f"Gallery: {links}"] if links else []
    return "\n\n".join(parts)


#: A shared part with more properties than this has a separate table.
_MOST_PROPERTIES = 10


def _documents() -> str:
    """Tables of the keys, types and meanings of each schema."""
    documents = [schema(name) for name in NAMES]
    shared: dict[str, Any] = {}
    for document in documents:
        shared |= document.get("$defs", {})
    large = [name for name, part in shared.items() if _is_large(part)]
    sections = [(d["title"], d["description"], d) for d in documents]
    sections += [(f"Part: {n}", shared[n].get("description", ""), shared[n]) for n in sorted(large)]
    head = "| key | type | meaning |\n| --- | --- | --- |"
    return "\n".join(
        f"## {title}\n\n{text}\n\n{head}\n" + "\n".join(_rows(part, shared, "")) + "\n"
        for title, text, part in sections
    )


def _is_large(part: Mapping[str, Any]) -> bool:
    return len(part.get("properties", {})) > _MOST_PROPERTIES


def _rows(part: Mapping[str, Any], shared: Mapping[str, Any], path: str) -> Iterator[str]:
    """Rows for the properties of an object and, with their paths, of nested objects."""
    for key, member in part.get("properties", {}).items():
        yield from _row(member, shared, f"{path}.{key}" if path else key)
    values = part.get("additionalProperties")
    if isinstance(values, dict) and values:
        yield from _row(values, shared, f"{path}.NAME" if path else "NAME")


def _row(part: Mapping[str, Any], shared: Mapping[str, Any], path: str) -> Iterator[str]:
    whole = _resolve(part, shared)
    meaning = " ".join(str(whole.get("description", "")).split()).replace("|", "\\|")
    name = _reference_name(part)
    if name and _is_large(shared[name]):
        yield f"| `{path}` | [{name}](#part-{name.lower()}) | {meaning} |"
        return
    yield f"| `{path}` | {_type(whole, shared)} | {meaning} |"
    yield from _rows(whole, shared, path)
    items = whole.get("items")
    if isinstance(items, dict):
        yield from _rows(_resolve(items, shared), shared, f"{path}[]")


def _reference_name(part: Mapping[str, Any]) -> str:
    """Name of the shared part in a reference, or an empty string."""
    return str(part.get("$ref", "")).rpartition("/")[2]


def _resolve(part: Mapping[str, Any], shared: Mapping[str, Any]) -> dict[str, Any]:
    """Merge a part with the shared part that it refers to; its own texts take precedence."""
    if "anyOf" in part:  # a value or null
        values = [_resolve(option, shared) for option in part["anyOf"]]
        kinds = " or ".join(_type(value, shared) for value in values)
        return values[0] | {k: v for k, v in part.items() if k != "anyOf"} | {"kinds": kinds}
    name = _reference_name(part)
    return (_resolve(shared[name], shared) if name else {}) | dict(part)


def _type(whole: Mapping[str, Any], shared: Mapping[str, Any]) -> str:
    if "kinds" in whole:
        return str(whole["kinds"])
    if "enum" in whole:
        return " or ".join("null" if value is None else f"`{value}`" for value in whole["enum"])
    kinds = whole.get("type", "any")
    kinds = [kinds] if isinstance(kinds, str) else kinds
    if kinds == ["array"] and isinstance(whole.get("items"), dict):
        return f"array of {_type(_resolve(whole['items'], shared), shared)}"
    return " or ".join(kinds)


if __name__ == "__main__":
    write(Path(__file__).parent)
