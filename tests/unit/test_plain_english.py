"""Names and first lines of docstrings in plain English.

Expected: in the package, the reports' scripts and the tests, no variable, argument or class
attribute has a name without content, and no docstring opens with a fragment. In the package
no two classes share a name. `tests/plain_english.ini` is the only list of rejected words.
"""

import ast
import configparser
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LISTS = configparser.ConfigParser()
LISTS.read_string((ROOT / "tests/plain_english.ini").read_text("utf-8"))
WORDS = {kind: frozenset(words.split()) for kind, words in LISTS["words"].items()}
PACKAGE = sorted((ROOT / "inim").rglob("*.py"))
REPORTS = sorted((ROOT / "reports").rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))


@cache
def nodes(source: str) -> list[ast.AST]:
    """All nodes of a module."""
    return list(ast.walk(ast.parse(source)))


def problems(source: str) -> Iterator[str]:
    """Line and text of each rejected name and docstring opening of a module."""
    for node in nodes(source):
        name = ""
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            name = node.id
        elif isinstance(node, ast.arg):
            name = node.arg
        if name.strip("_") in WORDS["names"] and not name.startswith("__"):
            yield f"{node.lineno}: name {name!r}"
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first_word = (ast.get_docstring(node) or " ").split(" ")[0].strip(".,:;\n")
            if first_word in WORDS["openings"]:
                yield f"{getattr(node, 'lineno', 1)}: docstring opens with {first_word!r}"


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("found = 1", ["1: name 'found'"]),
        ("def area(one, radius_mm): pass", ["1: name 'one'"]),
        ("for _seen in views: pass", ["1: name '_seen'"]),
        ('"""What renders."""', ["1: docstring opens with 'What'"]),
        ('def area():\n    """Of a circle."""', ["1: docstring opens with 'Of'"]),
        ('def area(radius_mm):\n    """Area of a circle, mm²."""\n    return 3 * radius_mm', []),
    ],
)
def test_rejected_words_are_reported_with_their_line(source, expected):
    assert list(problems(source)) == expected


def test_names_and_first_lines_are_plain():
    assert PACKAGE and REPORTS and TESTS
    report = [
        f"{file.relative_to(ROOT)}:{problem}"
        for file in (*PACKAGE, *REPORTS, *TESTS)
        for problem in problems(file.read_text("utf-8"))
        if f"{file.relative_to(ROOT)}:{problem.split(chr(39))[1]}" not in WORDS["allowed"]
    ]
    assert report == []


def shared_class_names(sources: dict[str, str]) -> dict[str, list[str]]:
    """Files of each class name that several of them define; a leading underscore does not count."""
    files: dict[str, list[str]] = {}
    for file, source in sources.items():
        for node in nodes(source):
            if isinstance(node, ast.ClassDef):
                files.setdefault(node.name.lstrip("_"), []).append(file)
    return {name: places for name, places in files.items() if len(places) > 1}


def test_a_class_name_is_used_once():
    samples = {"a": "class Part: pass", "b": "class _Part: pass\nclass Plan: pass"}
    assert shared_class_names(samples) == {"Part": ["a", "b"]}
    sources = {str(file.relative_to(ROOT)): file.read_text("utf-8") for file in PACKAGE}
    assert shared_class_names(sources) == {}
