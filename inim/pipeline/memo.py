"""What a run need not do: results found again, and how that is told.

Every result that takes time is asked for here, with all that decides it. Equal parts make equal
results, bit for bit; so one that the store holds is taken from there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from inim.cache.digest import address_of, value_digest
from inim.cache.store import Record, Store

__all__ = ["Memo"]

_UNCHANGED = "nothing that decides it has changed since it was made"


class Memo:
    """Results by what decides them.

    Parameters
    ----------
    store : Store, optional
        Without one, everything is made.
    topic : str
        What successive runs have in common, such as the scene's path: tells what has changed.
    """

    def __init__(self, store: Store | None = None, topic: str = "") -> None:
        self._store = store
        self._topic = topic
        #: What was done and what was skipped, in order; see `inim.report.sections.skipped`.
        self.rows: list[dict[str, str]] = []

    def fork(self) -> Memo:
        """Another that finds the same results; what is told from now on is told to it alone."""
        other = Memo(self._store, self._topic)
        other.rows = [dict(row) for row in self.rows]
        return other

    def recall(
        self,
        product: str,
        parts: Mapping[str, Any],
        make: Callable[[], Record],
        *,
        told: Callable[[], tuple[str, str, str]] | None = None,
    ) -> Record:
        """A product, found again or made.

        Parameters
        ----------
        product : str
            What it is, for people, too.
        parts : mapping
            All that decides it, by names that can be read.
        make : callable
        told : callable, optional
            Called after `make`: what was done, what was skipped, why that is safe. Products
            without it are too small to be told of.
        """
        if self._store is None:
            made = make()
            if told:
                self.tell(product, *told())
            return made
        digests = {name: value_digest(value) for name, value in parts.items()}
        address, topic = address_of(product, digests), value_digest([self._topic, product])
        record = self._store.load(address)
        if record is not None:
            if told:
                self.tell(product, "read from the store", "all of it", _UNCHANGED)
                self._store.remember_parts(topic, digests)
            return record
        made = make()
        self._store.keep(address, made)
        if told:
            done, skipped, why = told()
            done = f"{done} ({_change(self._store.last_parts(topic), digests)})"
            self.tell(product, done, skipped, why)
            self._store.remember_parts(topic, digests)
        return made

    def knows(self, product: str, parts: Mapping[str, Any]) -> bool:
        """Whether `recall` would find a product now."""
        digests = {name: value_digest(value) for name, value in parts.items()}
        return self._store is not None and self._store.holds(address_of(product, digests))

    def tell(self, what: str, done: str, skipped: str, why: str) -> None:
        """Add a row to what was done and skipped; like ones are one row."""
        kind, _, name = what.partition(": ")
        for row in self.rows:
            alike = (row["done"], row["skipped"], row["why"]) == (done, skipped, why)
            if name and alike and row["what"].startswith(f"{kind}: "):
                row["what"] += f", {name}"
                return
        self.rows.append({"what": what, "done": done, "skipped": skipped, "why": why})


def _change(before: Mapping[str, str] | None, now: Mapping[str, str]) -> str:
    """Why a result had to be made."""
    if before is None:
        return "not made before"
    changed = [name for name in now if before.get(name) != now[name]]
    changed += [name for name in before if name not in now]
    return f"changed: {', '.join(changed)}" if changed else "the store had dropped it"
