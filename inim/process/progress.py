"""Progress of a run, as a callback or as a bar in a notebook."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager

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
