"""Check of names and first lines of docstrings: `python -m tests.plain_english`.

In the package, the reports' scripts and the tests, no variable, argument or class attribute has a
name without content, and no docstring opens with a fragment. In the package no two classes share a
name. `tests/plain_english.ini` is the only list of rejected words.
"""

import ast
import configparser
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LISTS = configparser.ConfigParser()
LISTS.read_string((ROOT / "tests/plain_english.ini").read_text("utf-8"))
WORDS = {kind: frozenset(words.split()) for kind, words in LISTS["words"].items()}
#: Modules with a name and a docstring to reject and a class name to compare.
SAMPLES = {
    "inim/a.py": "def area(one, radius_mm): pass\nclass Part: pass",
    "inim/b.py": '"""Of a circle."""\nfor _seen in views: pass\nclass _Part: pass',
}


def problems(sources: dict[str, str]) -> Iterator[str]:
    """File, line and text of each rejected name and docstring opening, by file."""
    classes: dict[str, str] = {}
    for file, source in sources.items():
        for node in ast.walk(ast.parse(source)):
            place = f"{file}:{getattr(node, 'lineno', 1)}"
            name = ""
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                name = node.id
            elif isinstance(node, ast.arg):
                name = node.arg
            is_allowed = name.startswith("__") or f"{file}:{name}" in WORDS["allowed"]
            if name.strip("_") in WORDS["names"] and not is_allowed:
                yield f"{place}: name {name!r}"
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                first_word = (ast.get_docstring(node) or " ").split(" ")[0].strip(".,:;\n")
                if first_word in WORDS["openings"]:
                    yield f"{place}: docstring opens with {first_word!r}"
            if isinstance(node, ast.ClassDef) and file.startswith("inim/"):
                other = classes.setdefault(node.name.lstrip("_"), file)
                if other != file:
                    yield f"{place}: class {node.name} is also in {other}"


def main() -> int:
    """Print all problems; return the exit code."""
    if len(list(problems(SAMPLES))) != 4:
        print("plain_english: a sample with four problems passes")
        return 1
    files = [file for part in ("inim", "reports", "tests") for file in (ROOT / part).rglob("*.py")]
    sources = {str(file.relative_to(ROOT)): file.read_text("utf-8") for file in sorted(files)}
    report = list(problems(sources))
    print(*report, sep="\n", end="\n" if report else "")
    return int(bool(report))


if __name__ == "__main__":
    sys.exit(main())
