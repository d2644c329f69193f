"""Mutations of JSON documents by their structure: keys and values of a tree, changed and written.

Most of them stay well formed, and what is wrong with them lies behind the reader's first look.
Other documents are changed byte by byte.
"""

import copy
import json
import random
from collections.abc import Iterator
from typing import Any

from tests.fuzz.mutations import mutated

_VALUES: tuple[Any, ...] = (
    0, 1, -1, 7, 0.5, -0.0, 1e308, 5e-324, 10**9, 2**31, 2**63, 2**64, -(2**63), 10**30, 10**400,
    float("nan"), float("inf"), None, True, False, "", " ", "0", "-1", "1e999", "../../etc/passwd",
    "/dev/zero", "..", "a/b", "a\\b", "\0", "\n", "\x1b[31m", "\ud800", "\u202e", "<script>",
    "x" * 300, "y" * 100_000, "centre", "template", "truth", "eia", "ssim", "left=0 0 1e9",
    [], {}, [[]], [None], [0] * 1000, {"": 0}, {"a": {"a": {}}},
)  # fmt: skip


def mutated_document(kind: str, specimens: tuple[bytes, ...], seed: str) -> bytes:
    """One of the specimens, changed in one to four places; a sixth of them byte by byte.

    Equal seeds give equal documents.
    """
    rng = random.Random(seed)
    data = rng.choice(specimens)
    if kind != "json" or rng.random() < 1 / 6:
        return mutated((data,), seed, kind)
    tree = json.loads(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        places = list(_places(tree))
        # Shallow places are few, and their changes have large effects.
        most = rng.choice((1, 2, 3, 99))
        shallow = [place for place in places if len(place) <= most]
        if shallow:
            _change(rng, tree, rng.choice(shallow), rng.choice(places))
    return json.dumps(tree, indent=1).encode(errors="surrogatepass")


def _places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths of all values in a tree."""
    items: Any = value.items() if isinstance(value, dict) else ()
    if isinstance(value, list):
        items = enumerate(value)
    for key, item in items:
        yield (*path, key)
        yield from _places(item, (*path, key))


def _value(tree: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        tree = tree[key]
    return tree


def _change(rng: random.Random, tree: Any, path: tuple[Any, ...], other: tuple[Any, ...]) -> None:
    """Change the value at a path, or its key; or replace it by a copy of another value."""
    holder, key = _value(tree, path[:-1]), path[-1]
    value, kind = holder[key], rng.randrange(8)
    if kind == 0:
        holder[key] = copy.deepcopy(_value(tree, other))
    elif kind == 1:
        del holder[key]
    elif kind == 2 and isinstance(holder, dict):
        holder[rng.choice((f"{key}x", str(key).upper(), ""))] = holder.pop(key)
    elif kind == 3 and isinstance(holder, list):
        holder[key:key] = [copy.deepcopy(value) for _ in range(rng.choice((1, 300)))]
    elif kind == 4:
        for _ in range(rng.choice((1, 3, 50, 200))):
            holder[key] = [holder[key]]
    else:  # of the same type, which a schema may allow, or of any
        alike = [other for other in _VALUES if type(other) is type(value)]
        holder[key] = copy.deepcopy(rng.choice(alike if alike and kind < 7 else _VALUES))
