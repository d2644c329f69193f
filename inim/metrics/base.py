"""What a metric is: a function of two pictures, and all that the rest of the program says of it.

`maps_of` computes metrics' maps only where two pictures differ, in bands of rows.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import numpy as np

from inim.errors import UsageError
from inim.image.color import srgb_from_linear
from inim.image.noisy_image import row_bands

_NAME = re.compile(r"[a-z][a-z0-9]*")
_UNIT = re.compile(r"[A-Za-z]*")


@dataclass(frozen=True)
class Viewing:
    """How a picture is seen, for metrics of perception.

    Attributes
    ----------
    pixels_per_degree : float
        Of the picture, at its middle.
    luminance_cd_m2 : float
        Of its white.
    """

    pixels_per_degree: float
    luminance_cd_m2: float

    @classmethod
    def of(cls, pixel_mm: float, eye_mm: Sequence[float], luminance_cd_m2: float) -> Viewing:
        """Of a picture with pixels of a size on the lens array, from an eye, display frame."""
        degree = 2 * math.hypot(*eye_mm) * math.tan(math.radians(0.5))
        return cls(degree / pixel_mm, luminance_cd_m2)


@dataclass(frozen=True)
class Metric:
    """A metric.

    Attributes
    ----------
    name : str
        Small letters and digits: ``ssim``.
    function : callable
        Of reference and test, (rows, columns, 3) float32 each, sRGB in 0..1: the score, or a
        (rows, columns) map whose mean is the score. A map tells noise from change more sharply.
    tolerance : float
        The smallest change that a regression check counts, in the score's unit.
    better : {"higher", "lower"}
    range : (float, float)
        Of scores. An infinite end allows infinite scores.
    label : str
        In reports; the name in capitals where it is empty.
    unit : str
        Of the score, in letters: ``dB``.
    digits : int
        After the point, in reports.
    reference : str
        The paper that defines it.
    of_eia : bool
        Whether it says something of a panel's pixels, too, which is no picture to a viewer.
    on_relic : bool
        Whether the score of the relic's region alone is reported, too. It needs a map.
    border : int
        Pixels along each side of a picture whose map's values do not count.
    of_mean : callable, optional
        From a map's mean to the score and its derivative, where the score is not the mean itself;
        derivative 0 where it has none.
    whole : callable, optional
        Of reference and test in linear RGB: the score of pictures too large for a map.
    reach : int, optional
        Pixels beyond its own on which a map's value depends. If it is given, the function sees
        only parts of pictures, those in which they differ.
    where_equal : float
        A map's value where all that it depends on is equal; needed with `reach`.
    dtype : type
        Of the map, with `reach`.
    least_px : int
        Least side of a picture that the function takes.
    settings : mapping of str to JSON value
        What it is pinned to, for whoever computes it again.
    viewed : bool
        Whether the function is one of (reference, test, `Viewing`): how the picture is seen. It
        scores views, then, and no picture that is seen nobody knows how.
    slow : bool
        Takes so long that its error is estimated from few evaluations, and is wide.
    heat_map : callable, optional
        Of the function's arguments: what is lost where, (rows, columns), shown from 0, black,
        to `heat_map_to`.
    heat_map_to : float
    """

    name: str
    function: Callable[..., Any]
    _: KW_ONLY
    tolerance: float
    better: str = "higher"
    range: tuple[float, float] = (0.0, 1.0)
    label: str = ""
    unit: str = ""
    digits: int = 4
    reference: str = ""
    of_eia: bool = False
    on_relic: bool = False
    border: int = 0
    of_mean: Callable[[float], tuple[float, float]] | None = None
    whole: Callable[[np.ndarray, np.ndarray], float] | None = None
    reach: int | None = None
    where_equal: float = 0.0
    dtype: type = np.float32
    least_px: int = 1
    settings: Mapping[str, Any] = field(default_factory=dict, hash=False)
    viewed: bool = False
    slow: bool = False
    heat_map: Callable[..., np.ndarray] | None = None
    heat_map_to: float = 1.0

    def __post_init__(self) -> None:
        """Raise `UsageError` unless the declaration makes sense."""
        if not self.label:
            object.__setattr__(self, "label", str(self.name).upper())
        wrong = [said for said, holds in self._claims().items() if not holds]
        if wrong:
            raise UsageError(f"metric {self.name!r}: {wrong[0]}")

    def _claims(self) -> dict[str, bool]:
        number = isinstance(self.tolerance, (int, float)) and math.isfinite(self.tolerance)
        return {
            "its name must be small letters and digits": bool(_NAME.fullmatch(str(self.name))),
            "its function must be one of (reference, test)": callable(self.function),
            "its tolerance must be a number above 0": number and self.tolerance > 0,
            "better is 'higher' or 'lower'": self.better in ("higher", "lower"),
            "its range must be (low, high)": len(self.range) == 2 and self.range[0] < self.range[1],
            "its unit must be letters": bool(_UNIT.fullmatch(self.unit)),
            "a metric that is viewed sees whole pictures: no reach, no EIAs": not self.viewed
            or (self.reach is None and not self.of_eia),
        }

    @property
    def key(self) -> str:
        """Name of its score in reports and tables, with the unit: ``psnr_db``."""
        return self._named()

    @property
    def to_reference_key(self) -> str:
        """The same of a score against the reference: ``psnr_to_reference_db``."""
        return self._named("to_reference")

    @property
    def on_relic_key(self) -> str:
        """The same of a score of the relic's region alone: ``psnr_on_relic_db``."""
        return self._named("on_relic")

    @property
    def on_relic_to_reference_key(self) -> str:
        """The same against the reference: ``psnr_on_relic_to_reference_db``."""
        return self._named("on_relic", "to_reference")

    def _named(self, *of: str) -> str:
        return "_".join(filter(None, (self.name, *of, self.unit.lower())))

    def counted(self, shape: tuple[int, int], region: np.ndarray | None = None) -> np.ndarray:
        """The pixels of a map that count, (rows, columns) bool: all but the border, of a region."""
        counted = np.zeros(shape, bool)
        counted[self._inner] = True if region is None else region[self._inner]
        return counted

    @property
    def _inner(self) -> tuple[slice, slice]:
        side = slice(self.border, -self.border or None)
        return side, side

    def score(self, local: np.ndarray, region: np.ndarray | None = None) -> float:
        """The score from a map, (rows, columns), or from the score itself, ().

        With a (rows, columns) bool region, from the pixels that it picks; NaN of no pixel.
        """
        if local.ndim:
            inner = local[self._inner]
            local = inner if region is None else inner[region[self._inner]]
        mean = float(local.mean(dtype=np.float64)) if local.size else math.nan
        return mean if self.of_mean is None else self.of_mean(mean)[0]


# Rows and columns of a picture.
_Part = tuple[slice, slice]


def maps_of(
    metrics: Sequence[Metric],
    reference: np.ndarray,
    test: np.ndarray,
    viewing: Viewing | None = None,
) -> dict[str, np.ndarray]:
    """What the metrics' scores are made of, by their keys.

    A relic stands before a black ground that is equal in both pictures. Where all that a filter
    reaches is equal, a map is as of equal pictures: whatever the weights, both sides of each
    comparison are the same numbers. So only the rest is filtered, a band of rows at a time.

    Parameters
    ----------
    metrics : sequence of Metric
    reference, test : (rows, columns, 3) float32, linear RGB
    viewing : Viewing, optional
        Without it, metrics that are `viewed` are left out.

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
    metrics = [metric for metric in metrics if viewing is not None or not metric.viewed]
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
            seen = (viewing,) if metric.viewed else ()
            value = metric.function(srgb_from_linear(reference), srgb_from_linear(test), *seen)
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
            if not known.all():  # seldom; takes longer, as it goes by a pixel's three
                bad += int(np.count_nonzero(~known.all(axis=-1)))
        if bad:
            raise UsageError(f"the {name} picture has {bad} pixels that are not finite")
