"""Picture buffers: two independent halves of a picture's samples, and pictures in bands of rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class HalfBuffers:
    """A rendered picture from two independent halves of its samples.

    The picture is their mean; the score of one half against the other is the noise floor, a
    cautious one, as each half is noisier than the mean.

    Attributes
    ----------
    first, second : (rows, columns, 3) float32, linear RGB
    """

    first: np.ndarray
    second: np.ndarray

    @property
    def image(self) -> np.ndarray:
        """Mean of the halves, (rows, columns, 3) float32."""
        # In place: of an 8K panel each array takes 0.4 GB.
        mean: np.ndarray = self.first + self.second
        mean /= 2
        return mean

    @property
    def noise(self) -> np.ndarray:
        """Half of their difference, (rows, columns, 3) float32."""
        half: np.ndarray = self.first - self.second
        half /= 2
        return half


# Pixels of a band: its temporaries, a few dozen bytes a pixel, take a few megabytes each, which are
# used again; larger ones come fresh from the system every time, which costs a quarter of the time.
_PIXELS = 2**18


def row_bands(rows: int, columns: int, pixels: int | None = None) -> Iterator[slice]:
    """Slices of rows from top to bottom, each of about as many pixels, one row at least."""
    step = max(1, (pixels or _PIXELS) // max(1, columns))
    return (slice(first, min(first + step, rows)) for first in range(0, rows, step))
