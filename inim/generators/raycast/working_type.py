"""The float type a kernel computes in: the same code, float64 by default, float32 to measure.

A kernel's type is that of its arguments, for which numba compiles it anew; `as_type_of` keeps whole
numbers and literals from widening it on the way. Single precision is what a port to hardware
without float64 would have: `inim.stress` says what it costs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from inim.errors import UsageError

__all__ = ["DTYPES", "as_type_of", "in_type"]

DTYPES = ("float64", "float32")


def as_type_of(like: Any, value: Any) -> Any:
    """`value` in the float type of `like`, in compiled kernels; in plain Python, as it is."""
    del like
    return value


@overload(as_type_of)
def _compiled_as_type_of(like, value):  # type: ignore[no-untyped-def]  # noqa: ARG001
    if like == types.float32:
        return lambda like, value: np.float32(value)  # noqa: ARG005
    return lambda like, value: value  # noqa: ARG005


def in_type(dtype: str, value: Any) -> Any:
    """A kernel's argument with its floats in a type; arrays and named tuples of them too.

    Raises
    ------
    UsageError
        A number that the type cannot hold: too large, or so small that it becomes zero.
    """
    if dtype == "float64":
        return value
    if isinstance(value, tuple):
        return type(value)(*(in_type(dtype, one) for one in value))
    if not isinstance(value, float) and not (
        isinstance(value, np.ndarray) and value.dtype.kind == "f"
    ):
        return value
    given = np.asarray(value)
    with np.errstate(over="ignore", under="ignore"):
        narrow = given.astype(dtype)
    lost = (np.isfinite(given) & ~np.isfinite(narrow)) | ((given != 0) & (narrow == 0))
    if lost.any():
        raise UsageError(
            f"dtype = {dtype!r} cannot hold {given[lost].flat[0]:g}; use float64, or lengths of "
            "another unit"
        )
    return narrow if isinstance(value, np.ndarray) else narrow[()]
