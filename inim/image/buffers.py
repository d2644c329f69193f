"""Images in bands of rows."""

from __future__ import annotations

from collections.abc import Iterator

# Pixels of a band: its temporaries, a few dozen bytes a pixel, take a few megabytes each, which are
# used again; larger ones come fresh from the system every time, which costs a quarter of the time.
_PIXELS = 2**18


def row_bands(rows: int, columns: int, pixels: int | None = None) -> Iterator[slice]:
    """Slices of rows from top to bottom, each of about as many pixels, one row at least."""
    step = max(1, (pixels or _PIXELS) // max(1, columns))
    return (slice(first, min(first + step, rows)) for first in range(0, rows, step))
