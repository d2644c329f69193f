"""How far a run has come and how long it will go on, from what its steps should take."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

# Found in a cache: it says nothing of how fast this machine works.
_SKIPPED_BELOW = 0.05
# A step whose rays nobody counts stops here until it is over.
_MOST_BY_TIME = 0.9
# This share of all is believed to go as fast as planned, until it is known better.
_BELIEVED = 0.1
# Until it is over, a late step tells of the rest as if it took so many times its plan at most.
_MOST_LATE = 2.0
# Kernels are compiled before a step's first ray: of the step's pace, few rays tell nothing.
_TELLS_FROM = 0.25


class Step(NamedTuple):
    """A part of a run.

    Attributes
    ----------
    name : str
        Of its stage.
    seconds : float
        What it should take, on two processors of 2020; only ratios count once a run goes on.
    rays : int
        That it traces; 0 where its progress shows in nothing but time.
    """

    name: str
    seconds: float
    rays: int = 0


class Forecast:
    """Follows a run along its planned steps; its share done never falls.

    Parameters
    ----------
    steps : sequence of Step
        In their order.
    begins_at : float
        The share of the run that was done before.
    clock : callable
        Seconds that pass.
    """

    def __init__(
        self,
        steps: Sequence[Step],
        begins_at: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._steps, self._begins_at, self._clock = list(steps), begins_at, clock
        self._total = sum(step.seconds for step in steps) or 1.0
        self._now, self._since, self._rays = -1, clock(), 0
        # Of steps that are over: what they should have taken, and that of those not skipped with
        # what these took.
        self._over = self._planned = self._taken = 0.0
        self._share = begins_at

    def stage(self, name: str) -> None:
        """A stage begins; one that is not planned belongs to the step in progress."""
        for place in range(self._now + 1, len(self._steps)):
            if self._steps[place].name == name:
                self._go_to(place)
                return

    def rays(self, count: int) -> None:
        """So many rays more of the step in progress are done."""
        self._rays += count

    @property
    def share(self) -> float:
        """What is done of the whole, 0..1."""
        done = (self._over + self._in_step()) / self._total
        self._share = max(self._share, self._begins_at + (1 - self._begins_at) * min(done, 1.0))
        return self._share

    @property
    def left_s(self) -> float:
        """What the rest takes at the pace so far [s]."""
        return self._pace() * max(self._total - self._over - self._in_step(), 0.0)

    def _go_to(self, place: int) -> None:
        step = self._step
        took = self._clock() - self._since
        if took > _SKIPPED_BELOW * step.seconds:
            self._planned, self._taken = self._planned + step.seconds, self._taken + took
        self._over = sum(each.seconds for each in self._steps[:place])
        self._now, self._since, self._rays = place, self._clock(), 0

    @property
    def _step(self) -> Step:
        return self._steps[self._now] if self._now >= 0 else Step("", 0.0)

    def _in_step(self) -> float:
        """Planned seconds of the step in progress that are done."""
        step = self._step
        if step.rays:
            return step.seconds * min(self._rays / step.rays, 1.0)
        took = (self._clock() - self._since) / self._pace_before()
        return min(took, _MOST_BY_TIME * step.seconds)

    def _pace_before(self) -> float:
        """Seconds that a planned second took in the steps before."""
        believed = _BELIEVED * self._total
        return (believed + self._taken) / (believed + self._planned)

    def _pace(self) -> float:
        """The same with the step in progress, once it tells something."""
        step, done = self._step, self._in_step()
        took, before = self._clock() - self._since, self._pace_before()
        counted = step.rays and done > _TELLS_FROM * step.seconds
        if not counted and took < step.seconds * before:
            return before
        if not counted:  # late, but perhaps by its own plan only
            took = min(took, _MOST_LATE * step.seconds * before)
        believed = _BELIEVED * self._total
        return (believed + self._taken + took) / (believed + self._planned + done)
