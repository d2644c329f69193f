"""Examples of the gallery, whose page docs/gallery.md has their texts, pictures and code."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "gallery.md"
_EXAMPLE = re.compile(
    r"^\(example-(?P<name>[\w-]+)\)=\n### (?P<title>[^\n]+)\n(?P<body>.*?)(?=^\(example-|^## |\Z)",
    re.M | re.S,
)
_PICTURE = re.compile(r"^!\[(.+)\]\((images/gallery/.+)\)$", re.M)
_CODE = re.compile(r"^```(sh|python)\n(.*?)^```$", re.M | re.S)


@dataclass(frozen=True)
class Example:
    """A picture and the code that writes it as ``NAME.png`` or into a folder under this name."""

    name: str  #: The page's target is ``example-NAME``.
    title: str
    description: str  #: Text for readers who do not see the picture.
    picture: str  #: Path of the committed picture, relative to docs.
    language: str  #: Of the code: sh or python.
    code: str


def read_examples() -> list[Example]:
    """Read all examples of the page, each with one picture and one block of code."""
    examples = []
    for match in _EXAMPLE.finditer(PAGE.read_text("utf-8")):
        ((description, picture),) = _PICTURE.findall(match["body"])
        ((language, code),) = _CODE.findall(match["body"])
        name, title = match["name"], match["title"]
        examples.append(Example(name, title, description, picture, language, code))
    return examples


def cards(examples: Sequence[Example]) -> str:
    """MyST Markdown of a grid of the examples' pictures, which link to the examples."""
    items = [
        f":::{{grid-item-card}} {example.title}\n:link: example-{example.name}\n:link-type: ref\n"
        f":img-top: {example.picture}\n:img-alt: {example.description}\n:::"
        for example in examples
    ]
    grid = "::::{grid} 2 2 3 3\n:gutter: 2\n:class-container: gallery"
    return "\n\n".join([grid, *items, "::::"])


def examples_with(call: str) -> list[Example]:
    """Examples whose code has a function, such as `inim.generate`, or a command."""
    pattern = re.compile(rf"\b{re.escape(call)}\b")
    return [example for example in read_examples() if pattern.search(example.code)]
