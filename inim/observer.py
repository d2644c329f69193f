"""Who hears how a run goes on."""

from __future__ import annotations

__all__ = ["Listener"]


class Listener:
    """Hears how a run goes on; the command line's version prints and draws a bar."""

    def begin(self, total_rays: int) -> None:
        """The number of rays the whole run will trace."""

    def stage(self, name: str) -> None:
        """A stage begins."""

    def rays(self, count: int) -> None:
        """So many rays more are done."""

    def line(self, text: str) -> None:
        """A result worth a line."""
