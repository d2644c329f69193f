"""Who sees how a run goes on, and what goes into rendering."""

from __future__ import annotations

__all__ = ["Observer"]


class Observer:
    """Sees how a run goes on and counts what it renders; the command line's prints and draws a bar.

    Attributes
    ----------
    render_seconds : float
        Spent inside the renderer so far.
    samples : int
        Traced there so far.
    """

    def __init__(self) -> None:
        self.render_seconds = 0.0
        self.samples = 0

    def begin(self, total_rays: int) -> None:
        """The number of rays the whole run will trace."""

    def stage(self, name: str) -> None:
        """A stage begins."""

    def rays(self, count: int) -> None:
        """So many rays of the total are done."""

    def line(self, text: str) -> None:
        """A result worth a line."""

    def warn(self, text: str) -> None:
        """Something that the user should know."""

    def rendered(self, seconds: float, samples: int = 0) -> None:
        """Add time spent inside the renderer, and samples traced in it."""
        self.render_seconds += seconds
        self.samples += samples
