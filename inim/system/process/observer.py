"""Observers of a run (progress, rendering times, samples), and progress as a callback or a bar."""

import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
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


#: Receives the name of a stage and the finished share of the stages, 0..1.
OnStage = Callable[[str, float], object]


@contextmanager
def shown_progress(progress: OnStage | bool | None) -> Iterator[OnStage | None]:
    """Yield the callback, or that of a bar; None: a bar in notebooks only."""
    if callable(progress):
        yield progress
    elif _is_notebook() if progress is None else progress:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # without ipywidgets, the bar is plain text
            from tqdm.auto import tqdm
        with tqdm(total=1.0, leave=False, bar_format="{desc}: {percentage:3.0f}%|{bar}|") as bar:

            def show(stage: str, share: float) -> None:
                bar.n = share
                bar.set_description_str(stage)

            yield show
    else:
        yield None


def _is_notebook() -> bool:
    """True in a Jupyter kernel."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return shell is not None and "IPKernelApp" in shell.config
