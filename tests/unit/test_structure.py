"""The package's modules import one another in one direction, functions' own imports included."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Set

import grimp
import pytest


def circles(imports: Mapping[str, Set[str]]) -> list[list[str]]:
    """Groups of modules that reach one another: strong components of two or more (Tarjan 1972)."""
    number: dict[str, int] = {}
    lowest: dict[str, int] = {}
    open_modules: list[str] = []
    found: list[list[str]] = []

    def visit(module: str) -> None:
        number[module] = lowest[module] = len(number)
        open_modules.append(module)
        for other in sorted(imports[module]):
            if other not in number:
                visit(other)
                lowest[module] = min(lowest[module], lowest[other])
            elif other in open_modules:
                lowest[module] = min(lowest[module], number[other])
        if lowest[module] == number[module]:
            first = open_modules.index(module)
            group = sorted(open_modules[first:])
            del open_modules[first:]
            if len(group) > 1:
                found.append(group)

    before = sys.getrecursionlimit()
    sys.setrecursionlimit(10_000)
    try:
        for module in sorted(imports):
            if module not in number:
                visit(module)
    finally:
        sys.setrecursionlimit(before)
    return found


@pytest.mark.parametrize(
    ("imports", "expected"),
    [
        ({"a": {"b", "c"}, "b": {"c"}, "c": set()}, []),
        ({"a": {"b"}, "b": {"a"}, "c": {"a"}}, [["a", "b"]]),
        (
            {"a": {"b"}, "b": {"c"}, "c": {"a", "d"}, "d": {"e"}, "e": {"d"}},
            [["d", "e"], ["a", "b", "c"]],
        ),
    ],
)  # fmt: skip
def test_circles_are_found_where_there_are_some(imports, expected):
    assert circles(imports) == expected


def test_no_import_circle():
    graph = grimp.build_graph("inim", exclude_type_checking_imports=True, cache_dir=None)
    assert len(graph.modules) > 100, "or this test looks at nothing"
    imports = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    assert circles(imports) == []
