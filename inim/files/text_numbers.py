"""Numbers out of text files, a whole block at a time."""

from __future__ import annotations

import warnings

import numpy as np

__all__ = ["numbers_in"]


def numbers_in(text: bytes) -> np.ndarray | None:
    """All whitespace-separated numbers of a text as float64; None if anything else is there."""
    try:
        with warnings.catch_warnings():
            # Older NumPy warns at the first token that is no number, newer NumPy raises.
            warnings.simplefilter("error", DeprecationWarning)
            numbers: np.ndarray = np.fromstring(text.decode("ascii"), np.float64, sep=" ")
            return numbers
    except (ValueError, DeprecationWarning):
        return None
