"""The progress of a sweep: which unit is where, drawn live on a terminal, a line each elsewhere."""

from __future__ import annotations

import shutil
import sys
import threading
import time
from dataclasses import dataclass, field

_REDRAW_S = 0.2
_NARROWEST = 40


@dataclass
class _Running:
    label: str
    stage: str = "start"
    where: str = ""
    since: float = field(default_factory=time.monotonic)


class Progress:
    """Who is at work on what, how much is done, and how long the rest will take.

    Its methods may be called from any thread.

    Parameters
    ----------
    total : int
        Units that are left to do.
    quiet : bool
        Neither lines nor a table.
    """

    def __init__(self, total: int, *, quiet: bool = False) -> None:
        self._total, self._quiet = total, quiet
        self._screen = not quiet and sys.stderr.isatty()
        self._running: dict[str, _Running] = {}
        self._lock = threading.RLock()
        self._done = self._failed = 0
        self._started = time.monotonic()
        self._drawn = 0
        self._drawn_at = 0.0

    def began(self, unit: str, label: str, where: str = "") -> None:
        """A unit is in work; named again, it was begun anew if it is elsewhere."""
        with self._lock:
            if unit not in self._running or self._running[unit].where != where:
                self._running[unit] = _Running(label, where=where)
        self.draw()

    def stage(self, unit: str, stage: str) -> None:
        """It has come to a stage."""
        with self._lock:
            if unit in self._running and stage:
                self._running[unit].stage = stage
        self.draw()

    def ended(self, unit: str, label: str, error: str = "") -> None:
        """It is done, or has failed with a sentence."""
        with self._lock:
            run = self._running.pop(unit, None)
            self._done += 1
            self._failed += bool(error)
            took = f"{time.monotonic() - run.since:7.1f} s" if run else " " * 9
            count = f"[{self._done:{len(str(self._total))}}/{self._total}]"
            self.say(f"{count} {took}  {label}{f'  FAILED: {error}' if error else ''}")

    def say(self, line: str) -> None:
        """A line that stays."""
        with self._lock:
            if self._quiet:
                return
            self._erase()
            try:
                print(line, flush=True)
            except OSError:  # the reader left, or its disk is full; the results are what counts
                self._quiet, self._screen = True, False
            self.draw(now=True)

    def draw(self, *, now: bool = False) -> None:
        """Draw the table anew, on a terminal, and not too often."""
        with self._lock:
            moment = time.monotonic()
            if not self._screen or not (now or moment - self._drawn_at > _REDRAW_S):
                return
            self._erase()
            width = max(_NARROWEST, shutil.get_terminal_size().columns) - 1
            lines = [line[:width] for line in self.lines(moment)]
            sys.stderr.write("".join(f"{line}\n" for line in lines))
            sys.stderr.flush()
            self._drawn, self._drawn_at = len(lines), moment

    def lines(self, moment: float) -> list[str]:
        """The table as text: a line for each unit in work, and one for the whole."""
        with self._lock:
            rows = [
                (run.label, run.stage, f"{moment - run.since:.0f} s", run.where)
                for run in self._running.values()
            ]
            widths = [max((len(row[i]) for row in rows), default=0) for i in range(4)]
            table = [
                "  ".join(
                    cell.ljust(width) for cell, width in zip(row, widths, strict=True)
                ).rstrip()
                for row in rows
            ]
            left = self._total - self._done - len(rows)
            words = (
                f"{self._done} of {self._total} done, {len(rows)} in work, {max(left, 0)} waiting"
            )
            if self._failed:
                words += f", {self._failed} FAILED"
            if self._done:
                per_unit = (moment - self._started) / self._done
                words += f"; about {clock_words(per_unit * (self._total - self._done))} left"
            return [*table, words]

    def close(self) -> None:
        """Take the table away; lines stay."""
        with self._lock:
            self._erase()
            self._screen = False

    def _erase(self) -> None:
        if self._drawn:
            # Up to the table's first line, and clear from there down.
            sys.stderr.write(f"\x1b[{self._drawn}F\x1b[J")
            sys.stderr.flush()
            self._drawn = 0


def clock_words(seconds: float) -> str:
    """A duration in the two units that say most."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02} min" if hours else f"{minutes} min {rest:02} s"
