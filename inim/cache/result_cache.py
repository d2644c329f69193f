"""Results of stages, found again by the digest of what decides them.

Equal parts make equal results, bit for bit; so a result that the store holds is taken from there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from inim.cache.digest import address_of, value_digest
from inim.cache.store import Record, Store


class ResultCache:
    """A store, and what successive runs have in common.

    Parameters
    ----------
    store : Store, optional
        Without one, nothing is found and nothing kept.
    topic : str
        Such as the scene's path: tells what has changed since the last run on it.
    """

    def __init__(self, store: Store | None = None, topic: str = "") -> None:
        self._store = store
        self._topic = topic

    def holds(self, product: str, parts: Mapping[str, Any]) -> bool:
        """Whether `find` has a result now."""
        return self._store is not None and self._store.holds(address_of(product, _digests(parts)))

    def find_or_make(
        self,
        product: str,
        parts: Callable[[], Mapping[str, Any]],
        make: Callable[[], Any],
        kinds: Iterable[type] = (),
        *,
        explain: bool = True,
    ) -> tuple[Any, str | None]:
        """A result, found or made, and why it was made.

        Parameters
        ----------
        product : str
            What it is, for people, too.
        parts : callable
            All that decides it, by names that people can read; not called without a store.
        make : callable
        kinds : iterable of type
            The dataclasses that the result is made of.
        explain : bool
            Keep the parts, to say next time which of them changed.

        Returns
        -------
        result
        why : str or None
            Why it had to be made, such as "changed: seed"; None where it was found, "" where
            nobody knows.
        """
        if self._store is None:
            return make(), ""
        digests = _digests(parts())
        address, topic = address_of(product, digests), value_digest([self._topic, product])
        record = self._store.load(address)
        if record is None:
            made = make()
            self._store.keep(address, _packed(made))
            why = _change(self._store.last_parts(topic), digests) if explain else ""
        else:
            made, why = _unpacked(record, kinds), None
        if explain:
            self._store.remember_parts(topic, digests)
        return made, why


def _digests(parts: Mapping[str, Any]) -> dict[str, str]:
    return {name: value_digest(value) for name, value in parts.items()}


def _change(before: Mapping[str, str] | None, now: Mapping[str, str]) -> str:
    if before is None:
        return "not made before"
    changed = [name for name in now if before.get(name) != now[name]]
    changed += [name for name in before if name not in now]
    return f"changed: {', '.join(changed)}" if changed else "the store had dropped it"


def _packed(value: Any) -> Record:
    """Arrays, each once, and the tree of everything else for JSON."""
    arrays: dict[str, np.ndarray] = {}
    names: dict[int, str] = {}

    def tree(part: Any) -> Any:
        if isinstance(part, np.ndarray):
            name = names.setdefault(id(part), f"a{len(names)}")
            arrays[name] = part
            return {"array": name}
        if is_dataclass(part) and not isinstance(part, type):
            return {
                type(part).__name__: {f.name: tree(getattr(part, f.name)) for f in fields(part)}
            }
        if isinstance(part, tuple | list):
            return {"list": [tree(one) for one in part]}
        if isinstance(part, dict):
            return {"dict": {name: tree(one) for name, one in part.items()}}
        return part

    return Record(arrays, tree(value))


def _unpacked(record: Record, kinds: Iterable[type]) -> Any:
    known = {kind.__name__: kind for kind in kinds}

    def value(part: Any) -> Any:
        if not isinstance(part, dict):
            return part
        ((kind, held),) = part.items()
        if kind == "array":
            return record.arrays[held]
        if kind == "list":
            return tuple(value(one) for one in held)
        whole = {name: value(one) for name, one in held.items()}
        return whole if kind == "dict" else known[kind](**whole)

    return value(record.facts)
