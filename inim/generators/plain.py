"""Two ways to run the same kernel: compiled on all threads, or as plain Python on one.

Wang et al., Heritage Science 2024, doi 10.1186/s40494-024-01462-4, time algorithms written as plain
Python loops. To time that too, and to tell what an algorithm costs from what its language costs,
the kernels of the paper's algorithms are written in the part of Python that both interpreter and
numba run: loops, floats, flat sequences, `math`. Outer loops are compiled by ``numba.njit``, the
functions they call are marked ``register_jitable``, which leaves them plain; so the compiled
kernel's ``py_func`` is plain Python all the way down, with the same arithmetic to the bit.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["IMPLEMENTATIONS", "run"]

IMPLEMENTATIONS = ("compiled", "python")


def run(
    kernel: Any,
    implementation: str,
    shape: tuple[int, int],
    start: int,
    *arguments: Any,
) -> NDArray[np.int32]:
    """Fill a map of panel pixels by a kernel.

    Parameters
    ----------
    kernel : numba dispatcher
        Called with the arguments and, last, the map as a flat sequence to write into.
    implementation : {"compiled", "python"}
    shape : (rows, columns)
        Of the map.
    start : int
        What the map holds before.
    *arguments
        Numbers, flat arrays and named tuples of them. Plain Python sees lists: indexing an array
        would box a NumPy number each time. What a kernel writes to them is lost.

    Returns
    -------
    (rows, columns) int32
    """
    if implementation == "compiled":
        found = np.full(shape, start, np.int32)
        kernel(*arguments, found.ravel())
        return found
    flat = [start] * (shape[0] * shape[1])
    kernel.py_func(*map(_as_plain, arguments), flat)
    return np.array(flat, np.int32).reshape(shape)


def _as_plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, tuple):
        return type(value)(*map(_as_plain, value))
    return value
