"""How a run shows itself on a terminal: results on stdout, a progress bar on stderr."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from inim.observer import Observer

__all__ = ["ConsoleObserver"]


class ConsoleObserver(Observer):
    """Prints result lines and draws one bar over all rays; the bar only on a terminal.

    Parameters
    ----------
    quiet : bool
        Neither lines nor bar.
    on_stage : callable
        Called with each stage's name.
    """

    def __init__(self, quiet: bool, on_stage: Callable[[str], None]) -> None:
        super().__init__()
        self._quiet = quiet
        self._on_stage = on_stage
        self._bar: Any = None

    def __enter__(self) -> ConsoleObserver:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def begin(self, total_rays: int) -> None:
        """See `Observer`."""
        from tqdm import tqdm

        if self._bar is not None:  # of an earlier round of samples
            self._bar.close()
        # disable=None: off when stderr is not a terminal.
        disable = True if self._quiet else None
        self._bar = tqdm(
            total=total_rays,
            unit="ray",
            unit_scale=True,
            disable=disable,
            leave=False,
            dynamic_ncols=True,
        )

    def stage(self, name: str) -> None:
        """See `Observer`."""
        self._on_stage(name)
        if self._bar is not None:
            self._bar.set_description(name)

    def rays(self, count: int) -> None:
        """See `Observer`."""
        if self._bar is not None:
            self._bar.update(count)

    def line(self, text: str) -> None:
        """See `Observer`."""
        if self._quiet:
            return
        if self._bar is not None:
            self._bar.clear()
        print(text, flush=True)
