"""Metrics: functions of two images, with their properties.

`maps_of` computes the maps of metrics only where two images differ, in bands of rows.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import numpy as np

from inim.image.color import srgb_from_linear
from inim.image.noisy_image import pseudo_values
from inim.system.errors import UsageError
from inim.system.row_bands import row_bands

_NAME = re.compile(r"[a-z][a-z0-9]*")
_UNIT = re.compile(r"[A-Za-z]*")


@dataclass(frozen=True)
class Viewing:
    """Viewing conditions of an image, for perceptual metrics."""

    pixels_per_degree: float  #: At the centre of the image.
    luminance_cd_m2: float  #: Luminance of white.
    #: White over black of the panel that shows the images; infinite if they contain its black.
    contrast: float = 1000

    @classmethod
    def of(cls, pixel_mm: float, eye_mm: Sequence[float], luminance_cd_m2: float) -> Viewing:
        """Conditions for pixels of a given size on the lens array, from an eye (display frame)."""
        degree = 2 * math.hypot(*eye_mm) * math.tan(math.radians(0.5))
        return cls(degree / pixel_mm, luminance_cd_m2)


@dataclass(frozen=True)
class Metric:
    """A metric of the difference between two images.

    Attributes
    ----------
    name : str
        Lower-case letters and digits: ``ssim``.
    function : callable
        Function of reference and test, (rows, columns, 3) float32 sRGB in 0..1. It returns the
        score, or a (rows, columns) map whose mean is the score. A map gives smaller errors.
    tolerance : float
        Smallest change that a regression check counts, in the score's unit.
    better : {"higher", "lower"}
    range : (float, float)
        Range of scores. An infinite end allows infinite scores.
    label : str
        Label in reports; default: the name in capitals.
    unit : str
        Unit of the score, in letters: ``dB``.
    digits : int
        Digits after the decimal point in reports.
    reference : str
        Paper that defines the metric.
    has_eia_score : bool
        True if the metric also applies to panel pixels.
    has_relic_score : bool
        True if the score restricted to the relic's region is also reported. It needs a map.
    border : int
        Width of the border of a map that does not count, in pixels.
    score_from_mean : callable, optional
        Returns the score and its derivative for a map's mean, if the score is not the mean; the
        derivative is 0 if there is none.
    noise_free : callable, optional
        Function of K replicates of reference and test, (K, rows, columns, 3) float32 sRGB, whose
        noise is independent. It returns (3 + K, rows, columns) float32: the map without noise, the
        same by a first-order estimate, the share of noise in the noisy map's denominator, and by
        how much the map falls if each replicate is left out. It needs a reach. Without it, the
        score is extrapolated from sub-averages of the replicates.
    remaining_bias : float
        Largest usual bias that the correction by two halves leaves, as a share of the correction of
        the map's mean. Intervals extend by it.
    whole_image_score : callable, optional
        Returns the score of images too large for a map, from reference and test in linear RGB.
    reach : int, optional
        Distance in pixels over which the map depends on the images. With a reach, the function
        receives only the parts of the images that differ.
    equal_value : float
        Value of a map where the images are equal; needed with `reach`.
    dtype : type
        Type of the map, with `reach`.
    min_size_px : int
        Smallest side of an image that the function accepts.
    settings : mapping of str to JSON value
        Fixed parameters, to reproduce the score elsewhere.
    takes_linear : bool
        True if the function takes linear RGB in 0..1 instead of sRGB.
    needs_viewing : bool
        True if the function has a third argument, `Viewing`. Such a metric applies to views only.
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
    has_eia_score: bool = False
    has_relic_score: bool = False
    border: int = 0
    score_from_mean: Callable[[float], tuple[float, float]] | None = None
    noise_free: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    remaining_bias: float = 0.6
    whole_image_score: Callable[[np.ndarray, np.ndarray], float] | None = None
    reach: int | None = None
    equal_value: float = 0.0
    dtype: type = np.float32
    min_size_px: int = 1
    settings: Mapping[str, Any] = field(default_factory=dict, hash=False)
    takes_linear: bool = False
    needs_viewing: bool = False

    def __post_init__(self) -> None:
        """Raise `UsageError` for an invalid declaration."""
        if not self.label:
            object.__setattr__(self, "label", str(self.name).upper())
        violations = [rule for rule, is_met in self._rules().items() if not is_met]
        if violations:
            raise UsageError(f"metric {self.name!r}: {violations[0]}")

    def _rules(self) -> dict[str, bool]:
        is_number = isinstance(self.tolerance, (int, float)) and math.isfinite(self.tolerance)
        return {
            "its name must be lower-case letters and digits": bool(_NAME.fullmatch(str(self.name))),
            "its function must be a function of (reference, test)": callable(self.function),
            "its tolerance must be a number above 0": is_number and self.tolerance > 0,
            "better must be 'higher' or 'lower'": self.better in ("higher", "lower"),
            "its range must be (low, high)": len(self.range) == 2 and self.range[0] < self.range[1],
            "its unit must be letters": bool(_UNIT.fullmatch(self.unit)),
            "with needs_viewing, reach and has_eia_score must not be set": not self.needs_viewing
            or (self.reach is None and not self.has_eia_score),
        }

    @property
    def key(self) -> str:
        """Key of the score in reports and tables, with the unit: ``psnr_db``."""
        return self._join_key()

    @property
    def to_reference_key(self) -> str:
        """Key of the score to the reference: ``psnr_to_reference_db``."""
        return self._join_key("to_reference")

    @property
    def on_relic_key(self) -> str:
        """Key of the score on the relic: ``psnr_on_relic_db``."""
        return self._join_key("on_relic")

    @property
    def on_relic_to_reference_key(self) -> str:
        """Key of the score on the relic to the reference: ``psnr_on_relic_to_reference_db``."""
        return self._join_key("on_relic", "to_reference")

    def _join_key(self, *parts: str) -> str:
        return "_".join(filter(None, (self.name, *parts, self.unit.lower())))

    def is_better(self, change: float) -> bool:
        """True if a score improves by a change."""
        return change > 0 if self.better == "higher" else change < 0

    def score_mask(self, shape: tuple[int, int], region: np.ndarray | None = None) -> np.ndarray:
        """Pixels of a map that count, (rows, columns) bool: a region without the border."""
        mask = np.zeros(shape, bool)
        mask[self._interior] = True if region is None else region[self._interior]
        return mask

    @property
    def _interior(self) -> tuple[slice, slice]:
        side = slice(self.border, -self.border or None)
        return side, side

    def score(self, values: np.ndarray, region: np.ndarray | None = None) -> float:
        """Score from a (rows, columns) map, or from a single value with the shape ().

        With a (rows, columns) bool region, only its pixels count; NaN if there are none.
        """
        if values.ndim:
            interior = values[self._interior]
            values = interior if region is None else interior[region[self._interior]]
        mean = float(values.mean(dtype=np.float64)) if values.size else math.nan
        return mean if self.score_from_mean is None else self.score_from_mean(mean)[0]


def mean_of_products(images: np.ndarray) -> np.ndarray:
    """Mean of the products of different images, (K, rows, columns): the mean squared, no noise."""
    total = images.sum(axis=0)
    mean: np.ndarray = total * total - (images * images).sum(axis=0)
    return mean / (len(images) * (len(images) - 1))


def left_out_changes(images: np.ndarray) -> np.ndarray:
    """Changes of `mean_of_products` by each image: how much it falls without it, (K, ...)."""
    total, count = images.sum(axis=0), len(images)
    sums = images * (total - images)
    change: np.ndarray = 2 / (count - 2) * (sums / (count - 1) - mean_of_products(images))
    return change


# Rows and columns of an image.
_Window = tuple[slice, slice]


def maps_of(
    metrics: Sequence[Metric],
    reference: np.ndarray,
    test: np.ndarray,
    viewing: Viewing | None = None,
) -> dict[str, np.ndarray]:
    """Compute the maps of metrics, by their keys, for images in linear RGB, (rows, columns, 3)
    float32.

    A map is (rows, columns), or () for a metric without a map. A relic is in front of a black
    background that is equal in both images. Where everything within the reach of a filter is equal,
    the map has the value for equal images exactly, because both sides of each comparison are the
    same numbers. So only the rest is filtered, in bands of rows.

    Without `viewing`, metrics with `needs_viewing` are left out. Raises `UsageError` if the images
    cannot be compared, or if another package's metric fails.
    """
    check_images(reference, test)
    metrics = [metric for metric in metrics if viewing is not None or not metric.needs_viewing]
    rows, columns = shape = reference.shape[:2]
    local = [(metric, metric.reach) for metric in metrics if metric.reach is not None]
    maps: dict[str, np.ndarray] = {m.key: np.full(shape, m.equal_value, m.dtype) for m, _ in local}
    reach = max((reach for _, reach in local), default=0)
    min_size = max((metric.min_size_px for metric, _ in local), default=1)
    window = _expand(_difference_window(reference, test), reach, (rows, columns))
    for part, outer, inner in _parts(window, reach, (rows, columns), min_size):
        images: dict[bool, list[np.ndarray]] = {}
        for metric, _ in local:
            if metric.takes_linear not in images:
                images[metric.takes_linear] = _converted(metric, reference[outer], test[outer])
            maps[metric.key][part] = metric.function(*images[metric.takes_linear])[inner]
    for metric in metrics:
        if metric.reach is None:
            # New images for each metric: another package's function may write into them.
            conditions = (viewing,) if metric.needs_viewing else ()
            values = metric.function(*_converted(metric, reference, test), *conditions)
            maps[metric.key] = np.asarray(values)
    return {metric.key: maps[metric.key] for metric in metrics}


def _converted(metric: Metric, *images: np.ndarray) -> list[np.ndarray]:
    """Images in linear RGB as a metric takes them."""
    if metric.takes_linear:
        return [np.clip(image, np.float32(0), np.float32(1)) for image in images]
    return [srgb_from_linear(image) for image in images]


def noise_free_maps(
    metrics: Sequence[Metric], reference: np.ndarray, test: np.ndarray
) -> dict[str, np.ndarray]:
    """Compute `Metric.noise_free` of replicates in linear RGB, (K, rows, columns, 3) float32.

    Returns maps by key. Where all replicates are equal, they have the value for equal images
    exactly.
    """
    count, *shape, _ = reference.shape
    rows, columns = shape
    maps = {metric.key: np.zeros((3 + count, rows, columns), np.float32) for metric in metrics}
    for metric in metrics:
        maps[metric.key][:2] = metric.equal_value
    reach = max((metric.reach or 0 for metric in metrics), default=0)
    window = _difference_window(np.moveaxis(reference, 0, 2), np.moveaxis(test, 0, 2))
    window = _expand(window, reach, (rows, columns))
    for part, outer, inner in _parts(window, reach, (rows, columns), 1, images=count):
        replicates = [_srgb_replicates(stack[(slice(None), *outer)]) for stack in (reference, test)]
        for metric in metrics:
            values = metric.noise_free(*replicates)  # type: ignore[misc]
            maps[metric.key][(slice(None), *part)] = values[(slice(None), *inner)]
    return maps


def _srgb_replicates(replicates: np.ndarray) -> np.ndarray:
    """Pseudo-values of sRGB: they average to the sRGB of the mean, without its bias."""
    count, total = len(replicates), replicates.sum(axis=0)
    without_each = (srgb_from_linear((total - image) / (count - 1)) for image in replicates)
    return pseudo_values(srgb_from_linear(total / count), without_each)


def _parts(
    window: _Window, reach: int, shape: tuple[int, int], min_size: int, images: int = 1
) -> Iterator[tuple[_Window, _Window, _Window]]:
    """Bands of a window; each with the part within reach of it, and its position in this part."""
    top, columns = window[0].start, window[1].stop - window[1].start
    for band in row_bands(window[0].stop - top, columns * images):
        part = slice(top + band.start, top + band.stop), window[1]
        # Including the reach of all filters, so that bands join without seams.
        outer = _expand(part, reach, shape, min_size)
        yield part, outer, _position_within(part, outer)


def _difference_window(reference: np.ndarray, test: np.ndarray) -> _Window:
    """Smallest window that contains all differences of two images; empty if they are equal.

    Images are (rows, columns, ...).
    """
    rows, columns = reference.shape[:2]
    in_row, in_column = np.zeros(rows, bool), np.zeros(columns, bool)
    for band in row_bands(rows, columns):
        differs = (reference[band] != test[band]).any(axis=tuple(range(2, reference.ndim)))
        in_row[band] = differs.any(axis=1)
        in_column |= differs.any(axis=0)
    if not in_row.any():
        return slice(0, 0), slice(0, 0)
    (top, bottom), (left, right) = (np.flatnonzero(mask)[[0, -1]] for mask in (in_row, in_column))
    return slice(int(top), int(bottom) + 1), slice(int(left), int(right) + 1)


def _expand(window: _Window, margin: int, shape: tuple[int, int], min_size: int = 1) -> _Window:
    """Expand a window by a margin within an image, to at least `min_size` along each side."""
    if window[0].stop == window[0].start:
        return window
    sides = []
    for side, size in zip(window, shape, strict=True):
        first = max(0, min(side.start - margin, size - min_size))
        sides.append(slice(first, min(size, max(side.stop + margin, first + min_size))))
    return sides[0], sides[1]


def _position_within(window: _Window, outer: _Window) -> _Window:
    """Position of a window within another that contains it."""
    rows, columns = (
        slice(inner.start - whole.start, inner.stop - whole.start)
        for inner, whole in zip(window, outer, strict=True)
    )
    return rows, columns


def check_images(reference: np.ndarray, test: np.ndarray) -> None:
    """Raise `UsageError` unless two images are floats of one shape, with three finite colours."""
    if reference.shape != test.shape or reference.ndim != 3 or reference.shape[2] != 3:
        raise UsageError(
            f"images of shape {reference.shape} and {test.shape} cannot be compared; "
            "both must be (rows, columns, 3)"
        )
    for name, image in (("reference", reference), ("test", test)):
        if not np.issubdtype(image.dtype, np.floating):
            raise UsageError(
                f"the {name} image is {image.dtype}; give linear RGB as floats: convert 8-bit sRGB "
                "with inim.image.color.linear_from_srgb(image[..., :3] / 255)"
            )
        count = 0
        for band in row_bands(*image.shape[:2]):
            finite = np.isfinite(image[band])
            if not finite.all():  # reducing by pixel takes longer, and is rarely needed
                count += int(np.count_nonzero(~finite.all(axis=-1)))
        if count:
            raise UsageError(
                f"the {name} image has {count} pixels that are not finite; replace them"
            )
