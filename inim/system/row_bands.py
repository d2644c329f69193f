"""Bands of rows of images that fit into a processor's cache."""

from collections.abc import Iterator

# Pixels of a band: its temporaries, a few dozen bytes a pixel, take a few megabytes each, which are
# used again; larger ones come fresh from the system every time, which costs a quarter of the time.
_PIXELS = 2**18


def row_bands(rows: int, columns: int, pixels: int | None = None) -> Iterator[slice]:
    """Slices of rows from top to bottom, each of about `pixels` pixels and at least one row."""
    step = max(1, (pixels or _PIXELS) // max(1, columns))
    return (slice(first, min(first + step, rows)) for first in range(0, rows, step))
