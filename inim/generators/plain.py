"""Kernels of the paper's algorithms: plain functions, compiled by numba when they are first run.

Wang et al., Heritage Science 2024, doi 10.1186/s40494-024-01462-4, time algorithms written as plain
Python loops. To time that too, and to tell what an algorithm costs from what its language costs,
the kernels are in the part of Python that both interpreter and numba run: loops over `prange`,
floats, flat arrays, `math`. With ``NUMBA_DISABLE_JIT=1`` in the environment they run uncompiled:
the same arithmetic to the bit.
"""

from __future__ import annotations

from functools import cache
from types import FunctionType
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Of a kernel's outer loop; compiled, its turns are shared among the threads.
prange = range


def run(kernel: Any, shape: tuple[int, int], start: int, *arguments: Any) -> NDArray[np.int32]:
    """Fill a map of panel pixels by a kernel.

    Parameters
    ----------
    kernel : function
        Called with the arguments and, last, the map as a flat array to write into.
    shape : (rows, columns)
        Of the map.
    start : int
        What the map holds before.
    *arguments
        Numbers, flat arrays and named tuples of them.

    Returns
    -------
    (rows, columns) int32
    """
    filled = np.full(shape, start, np.int32)
    compiled(kernel)(*arguments, filled.ravel())
    return filled


@cache
def compiled(kernel: FunctionType) -> Any:
    """A plain function compiled by numba, and with it the functions of this package it calls."""
    from inim.backend import kernels

    names = dict(kernel.__globals__)
    called = {name: names[name] for name in kernel.__code__.co_names if name in names}
    parallel = called.get("prange") is prange
    for name, value in called.items():
        if value is prange:
            names[name] = kernels.prange
        elif isinstance(value, FunctionType):
            names[name] = compiled(value)
    copy = FunctionType(kernel.__code__, names, kernel.__name__)
    copy.__qualname__ = kernel.__qualname__
    return kernels.compiled(copy, parallel=parallel)
