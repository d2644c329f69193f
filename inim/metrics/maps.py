"""Maps of how two pictures differ, computed only where they do, in bands of rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from inim.buffers import row_bands
from inim.color import srgb_from_linear
from inim.errors import UsageError
from inim.metrics.base import Metric

__all__ = ["check_alike", "maps_of"]

# Rows and columns of a picture.
_Part = tuple[slice, slice]


def maps_of(
    metrics: Sequence[Metric], reference: np.ndarray, test: np.ndarray
) -> dict[str, np.ndarray]:
    """What the metrics' scores are made of, by their keys.

    A relic stands before a black ground that is equal in both pictures. Where all that a filter
    reaches is equal, a map is as of equal pictures: whatever the weights, both sides of each
    comparison are the same numbers. So only the rest is filtered, a band of rows at a time.

    Parameters
    ----------
    metrics : sequence of Metric
    reference, test : (rows, columns, 3) float32, linear RGB

    Returns
    -------
    dict of str to array
        (rows, columns) each; () of a metric that has no map.

    Raises
    ------
    UsageError
        The pictures cannot be compared, or another package's metric failed.
    """
    check_alike(reference, test)
    rows, columns = shape = reference.shape[:2]
    partial = [(metric, metric.reach) for metric in metrics if metric.reach is not None]
    found: dict[str, np.ndarray] = {
        m.key: np.full(shape, m.where_equal, m.dtype) for m, _ in partial
    }
    reach = max((reach for _, reach in partial), default=0)
    least = max((metric.least_px for metric, _ in partial), default=1)
    near = _grown(_unlike(reference, test), reach, (rows, columns))
    for band in row_bands(near[0].stop - near[0].start, near[1].stop - near[1].start):
        part = slice(near[0].start + band.start, near[0].start + band.stop), near[1]
        # With what filters reach beyond it, seams do not show.
        around = _grown(part, reach, (rows, columns), least)
        inside = _within(part, around)
        shown = srgb_from_linear(reference[around]), srgb_from_linear(test[around])
        for metric, _ in partial:
            found[metric.key][part] = metric.function(*shown)[inside]
    for metric in metrics:
        if metric.reach is None:
            # Converted anew for each: another package's function may write into them.
            value = metric.function(srgb_from_linear(reference), srgb_from_linear(test))
            found[metric.key] = np.asarray(value)
    return {metric.key: found[metric.key] for metric in metrics}


def _unlike(reference: np.ndarray, test: np.ndarray) -> _Part:
    """The smallest part of two pictures that has all their differences; empty without any."""
    rows, columns = reference.shape[:2]
    in_row, in_column = np.zeros(rows, bool), np.zeros(columns, bool)
    for band in row_bands(rows, columns):
        unlike = reference[band] != test[band]
        in_row[band] = unlike.any(axis=(1, 2))
        in_column |= unlike.any(axis=0).any(axis=-1)
    if not in_row.any():
        return slice(0, 0), slice(0, 0)
    (top, bottom), (left, right) = (np.flatnonzero(one)[[0, -1]] for one in (in_row, in_column))
    return slice(int(top), int(bottom) + 1), slice(int(left), int(right) + 1)


def _grown(part: _Part, by: int, shape: tuple[int, int], least: int = 1) -> _Part:
    """A part with what lies about it in a picture of that shape, no side less than `least`."""
    if part[0].stop == part[0].start:
        return part
    found = []
    for side, size in zip(part, shape, strict=True):
        first = max(0, min(side.start - by, size - least))
        found.append(slice(first, min(size, max(side.stop + by, first + least))))
    return found[0], found[1]


def _within(part: _Part, whole: _Part) -> _Part:
    """Where a part of the picture lies in another that holds it."""
    rows, columns = (
        slice(inner.start - outer.start, inner.stop - outer.start)
        for inner, outer in zip(part, whole, strict=True)
    )
    return rows, columns


def check_alike(reference: np.ndarray, test: np.ndarray) -> None:
    """Raise `UsageError` unless two pictures have one shape, three colours and finite values."""
    if reference.shape != test.shape or reference.ndim != 3 or reference.shape[2] != 3:
        raise UsageError(
            f"pictures of shape {reference.shape} and {test.shape} cannot be compared; "
            "both must be (rows, columns, 3)"
        )
    for name, image in (("reference", reference), ("test", test)):
        bad = 0
        for band in row_bands(*image.shape[:2]):
            known = np.isfinite(image[band])
            if not known.all():  # seldom: a pixel's three are looked at in turn, which takes longer
                bad += int(np.count_nonzero(~known.all(axis=-1)))
        if bad:
            raise UsageError(f"the {name} picture has {bad} pixels that are not finite")
