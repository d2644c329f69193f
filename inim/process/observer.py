"""Observers of a run: its progress, its rendering times and its samples."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager


class Observer:
    """Observes a run and counts; the command line's version also prints and draws a bar.

    `timings` are the seconds of each stage, `render_seconds` and `samples` are counted in the
    renderer, and `started` is the time of creation by `time.perf_counter`.
    """

    def __init__(self) -> None:
        self.timings: dict[str, float] = {}
        self.render_seconds = 0.0
        self.samples = 0
        self.started = time.perf_counter()

    def begin(self, stages: Sequence[str]) -> None:
        """Receive the names of the stages of the run, or of the rest of it, in order."""

    def stage(self, name: str) -> None:
        """Record the start of a stage."""

    def line(self, text: str) -> None:
        """Print a line of results."""

    def record_rendering(self, seconds: float, samples: int = 0) -> None:
        """Record the rendering time and the sample count."""
        self.render_seconds += seconds
        self.samples += samples

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Time a stage; the times of equal names add up."""
        self.stage(name)
        started = time.perf_counter()
        yield
        self.timings[name] = self.timings.get(name, 0.0) + time.perf_counter() - started
