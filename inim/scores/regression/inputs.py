"""Changes between the declared inputs of two runs, by name, and their circumstances."""

import json
import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import msgspec

from inim.scores.document_parts import Change, Circumstances, RunInputs

# Derived lengths may differ in the last bits between machines.
_SAME_LENGTH = 1e-9
# Limits of a value's text.
_MAX_CHARACTERS, _MAX_DIGITS = 60, 9
_SHA256_DIGITS = 64
# Inputs with their own comparison, and those that follow from others.
_SEPARATE, _DERIVED = ("elements", "files", "algorithms"), {"display as derived": "display"}
_ALWAYS_NEW = ("created",)
_Values = Mapping[str, Any]


def changed_inputs(before: RunInputs, after: RunInputs) -> list[Change]:
    """List all inputs that differ, in the order scene, display, settings, algorithms."""
    old, new = msgspec.to_builtins(before), msgspec.to_builtins(after)
    changes = [*_changed_elements(before, after)]
    names = [name for name in {**old, **new} if name not in _SEPARATE]
    differing = [name for name in names if not _is_same(old.get(name), new.get(name))]
    for name in differing:
        if _DERIVED.get(name) not in differing:
            changes += _changed_values(name, old.get(name), new.get(name))
    pairs = paired_algorithms(before.algorithms, after.algorithms)
    for name in before.algorithms:
        if pairs.get(name) != name:
            changes.append(_change(f"algorithm {_base(name)}", name, pairs.get(name)))
    added = [name for name in after.algorithms if name not in pairs.values()]
    return changes + [_change(f"algorithm {_base(name)}", None, name) for name in added]


def paired_algorithms(before: Iterable[str], after: Iterable[str]) -> dict[str, str]:
    """Algorithms of the later run, by those of the earlier one.

    Algorithms with equal options are pairs; then those that differ in options, if there is one on
    each side.
    """
    before, after = list(before), list(after)
    pairs = {name: name for name in before if name in after}
    rest: dict[str, tuple[list[str], list[str]]] = defaultdict(lambda: ([], []))
    for side, names in enumerate((before, after)):
        for name in names:
            if name not in pairs:
                rest[_base(name)][side].append(name)
    return pairs | {old[0]: new[0] for old, new in rest.values() if len(old) == len(new) == 1}


def _base(algorithm: str) -> str:
    """Name of an algorithm without its options."""
    return algorithm.partition(":")[0]


def _changed_elements(before: RunInputs, after: RunInputs) -> Iterator[Change]:
    """Changed elements of the scene; those inside an element that appears or vanishes are left out.

    A changed file has its name.
    """
    old, new = before.elements, after.elements
    one_sided = old.keys() ^ new.keys()
    for name in {**old, **new}:
        if name.rpartition(" / ")[0] in one_sided or old.get(name) == new.get(name):
            continue
        values = old.get(name), new.get(name)
        files = before.files.get(values[0] or ""), after.files.get(values[1] or "")
        label = f"scene: {name}"
        if files[1]:
            label = f"file {files[1].name} ({name.rpartition(' / ')[0]})"
        texts = [
            ", ".join(filter(None, (f"{file.name} {_text(value)}", file.facts)))
            if file
            else _text(value)
            for file, value in zip(files, values, strict=True)
        ]
        previews = [file.preview if file else "" for file in files]
        yield Change(
            name=label,
            baseline=texts[0] if name in old else None,
            candidate=texts[1] if name in new else None,
            previews=(previews[0], previews[1]),
        )


def _changed_values(name: str, old: Any, new: Any) -> Iterator[Change]:
    """Changes of a value; of a table, of its entries."""
    if not (isinstance(new, Mapping) and isinstance(old, Mapping)):
        yield _change(name, old, new)
        return
    for key in {**old, **new}:
        if not _is_same(old.get(key), new.get(key)):
            yield from _changed_values(f"{name}: {key}", old.get(key), new.get(key))


def _change(name: str, old: Any, new: Any) -> Change:
    texts = [None if value is None else _text(value) for value in (old, new)]
    return Change(name=name, baseline=texts[0], candidate=texts[1])


def _is_same(before: Any, after: Any) -> bool:
    """True if two values of an input are equal; lengths may differ by rounding."""
    match before, after:
        case Mapping(), Mapping():
            return before.keys() == after.keys() and all(
                _is_same(value, after[key]) for key, value in before.items()
            )
        case ((list() | tuple()), (list() | tuple())):
            return len(before) == len(after) and all(map(_is_same, before, after))
        case (float(), int() | float()) | (int(), float()):
            return math.isclose(before, after, rel_tol=_SAME_LENGTH, abs_tol=_SAME_LENGTH)
    return type(before) is type(after) and bool(before == after)


def _text(value: Any) -> str:
    if isinstance(value, str):
        return f"{value[:12]}…" if len(value) == _SHA256_DIGITS else value[:_MAX_CHARACTERS]
    if isinstance(value, float):
        return f"{value:.{_MAX_DIGITS}g}"
    if isinstance(value, (list, tuple)):  # a viewpoint: position, pupil and focus
        text = f"[{', '.join(_text(item) for item in value if item is not None)}]"
    else:
        text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _MAX_CHARACTERS else f"{text[: _MAX_CHARACTERS - 1]}…"


def changed_circumstances(before: Circumstances, after: Circumstances) -> list[Change]:
    """List changes that excuse nothing: code, versions, samples, seed, machine."""
    old, new = map(_flat, map(msgspec.to_builtins, (before, after)))
    return [
        Change(name=name, baseline=old.get(name), candidate=new.get(name))
        for name in {**old, **new}
        if old.get(name) != new.get(name) and name not in _ALWAYS_NEW
    ]


def _flat(circumstances: _Values) -> dict[str, Any]:
    packages = {f"package {k}": v for k, v in circumstances["packages"].items()}
    return {k: v for k, v in circumstances.items() if k != "packages"} | packages
