"""The picture files of a run, written while the run goes on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from pathlib import Path
from typing import Any

import numpy as np

from inim.files.image import write_exr, write_png

__all__ = ["PictureFiles"]

# Pictures that wait are held in memory, so large ones are waited for: a quarter of a gigabyte.
_WAITING_BYTES = 2**28


class PictureFiles:
    """Writes pictures in a thread of its own: packing them takes as long as scoring them.

    Parameters
    ----------
    folder : Path
    attributes : mapping of str to str
        Of every EXR file.
    """

    def __init__(self, folder: Path, attributes: Mapping[str, str]) -> None:
        self.attributes = attributes
        self._folder = folder
        self._thread = ThreadPoolExecutor(1, "pictures")
        self._waiting: list[tuple[Future[None], int]] = []

    def save(self, name: str, linear: np.ndarray) -> None:
        """Write a picture, (rows, columns, 3) linear RGB that stays as it is, as PNG and EXR.

        Raises
        ------
        FileError
            Where this or an earlier one cannot be written; see `settle` for the last ones.
        """

        def write() -> None:
            write_png(self._folder / f"{name}.png", linear)
            write_exr(self._folder / f"{name}.exr", linear, self.attributes)

        self.write(write, linear.nbytes)

    def write(self, write: Callable[[], None], size: int) -> None:
        """Call what writes a file, which holds so many bytes of memory until then."""
        while self._waiting and (
            self._waiting[0][0].done() or sum(held for _, held in self._waiting) > _WAITING_BYTES
        ):
            self._waiting.pop(0)[0].result()
        # With this thread's context, which knows the store in use.
        task: Any = copy_context().run
        self._waiting.append((self._thread.submit(task, write), size))
        if size > _WAITING_BYTES:
            self.settle()

    def settle(self) -> None:
        """Wait until all is written."""
        while self._waiting:
            self._waiting.pop(0)[0].result()
