"""Configuration files in the current folder, which numba and matplotlib would read."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

#: As both packages ask for them: by `os.path.exists` of the bare name. numba's can name a folder
#: whose compiled kernels are executed; matplotlib's changes pictures, and a FIFO would hang.
_NAMES = (".numba_config.yaml", "matplotlibrc")


@contextmanager
def configuration_hidden() -> Iterator[None]:
    """Hide these files from all packages of this process: a picture's folder configures nothing."""
    exists = os.path.exists

    def exists_elsewhere(path: Any) -> bool:
        return path not in _NAMES and exists(path)

    os.path.exists = exists_elsewhere
    try:
        yield
    finally:
        os.path.exists = exists
