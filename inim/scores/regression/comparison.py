"""Comparison of a run with a baseline: verdict, checks, changed inputs, and images.

Rendered images are compared by Welch's t-test in every tile. Changes are in codes, steps of an
8-bit panel on the sRGB curve, of the tile's mean or of the root of its power. See
docs/theory/regression.md.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from inim.display import Display
from inim.scores.document_parts import Change, Check, Verdict
from inim.scores.regression.fingerprints import Fingerprint, compare_fingerprints, sampled_pixels
from inim.scores.regression.inputs import (
    changed_circumstances,
    changed_inputs,
    paired_algorithms,
)
from inim.scores.regression.run_statistics import RunStatistics
from inim.scores.regression.scores import compare_scores
from inim.scores.regression.tiles import TileStatistics
from inim.scores.regression.verdict import (
    FALSE_ALARM_RATE,
    FAMILY_RATE,
    judge,
    sidak,
    welch_half_width,
    welch_p_value,
    within,
)

#: One step of an 8-bit panel: a panel cannot show a smaller difference of a tile's mean.
SMALLEST_CODES = 1.0
#: Largest growth of the ground truth's standard error: 10 % fewer samples increase it by 5 %, half
#: of the samples by 41 %.
MAX_NOISE_RATIO = 1.25
# Tests per tile: three colours and the power.
_TESTS = 4


@dataclass(frozen=True)
class TileChange:
    """Changes between two images by tile; the last axis is R, G, B, power."""

    codes: np.ndarray  #: (R, C, 4) float64: change in 8-bit codes, candidate minus baseline.
    #: (R, C, 4) float64: largest change that passes, in the direction of the change.
    limit: np.ndarray
    half_width: np.ndarray  #: (R, C, 4) float64: half width of the change's interval.
    p_value: np.ndarray  #: (R, C, 4) float64

    @property
    def failed(self) -> np.ndarray:
        """Tiles that failed, (R, C) bool; tiles that are not finite fail."""
        failed: np.ndarray = ~(np.abs(self.codes) <= self.limit).all(axis=-1)
        return failed


def codes_from_linear(linear: np.ndarray) -> np.ndarray:
    """8-bit codes of linear values (IEC 61966-2-1), neither rounded nor clipped; odd about 0."""
    size = np.abs(np.asarray(linear, np.float64))
    curve = 1.055 * np.power(np.maximum(size, 0.0031308), 1 / 2.4) - 0.055
    codes: np.ndarray = np.copysign(255 * np.where(size <= 0.0031308, 12.92 * size, curve), linear)
    return codes


def tile_change(baseline: TileStatistics, candidate: TileStatistics, level: float) -> TileChange:
    """Compute the change of every tile, each tested at `level`.

    The t-test uses linear light, in which half images average. Its half width and the change are
    then converted to codes, from the baseline in the direction of the candidate.
    """
    old, old_error, old_freedom = _stack_power(baseline)
    new, new_error, new_freedom = _stack_power(candidate)
    errors = (old_error, old_freedom, new_error, new_freedom)
    half = welch_half_width(*errors, level)
    direction = np.where(new >= old, 1.0, -1.0)
    start = _codes(old)
    width = np.abs(_codes(old + direction * half) - start)
    limit = np.maximum(SMALLEST_CODES, width)
    return TileChange(_codes(new) - start, limit, width, welch_p_value(new - old, *errors))


def _stack_power(tiles: TileStatistics) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values, errors and degrees of freedom, (R, C, 4) float64: three colours and the power."""
    parts = (
        (tiles.mean, tiles.power[..., None]),
        (tiles.mean_error, tiles.power_error[..., None]),
        (tiles.freedom, tiles.freedom.min(axis=-1, keepdims=True)),
    )
    values, errors, freedom = (np.concatenate(p, axis=-1).astype(np.float64) for p in parts)
    return values, errors, freedom


def _codes(values: np.ndarray) -> np.ndarray:
    """Codes of three means and of the root of a power; an unbiased power may be negative."""
    root = np.copysign(np.sqrt(np.abs(values[..., 3:])), values[..., 3:])
    return codes_from_linear(np.concatenate([values[..., :3], root], axis=-1))


def compare_pictures(
    baseline: Mapping[str, TileStatistics], candidate: Mapping[str, TileStatistics]
) -> list[Check]:
    """Verdicts on the baseline's images by name, each on its worst tile.

    An image that the candidate lacks, or has in another size, fails.
    """
    tests = sum(_TESTS * tiles.power.size for tiles in baseline.values())
    level = sidak(FAMILY_RATE, tests)
    return [_verdict(name, old, candidate.get(name), level) for name, old in baseline.items()]


def _verdict(name: str, old: TileStatistics, new: TileStatistics | None, level: float) -> Check:
    label = f"{name}: tiles against the baseline"
    if new is None or (new.shape, new.tile) != (old.shape, old.tile):
        state = "is missing" if new is None else f"has {new.shape[1]} x {new.shape[0]} pixels"
        detail = f"the image {state}; the baseline has {old.shape[1]} x {old.shape[0]}"
        return within(
            label, "picture", math.nan, math.nan, SMALLEST_CODES, unit="codes", detail=detail
        )
    change = tile_change(old, new, level)
    excess = np.nan_to_num(np.abs(change.codes) / change.limit, nan=np.inf, posinf=np.inf)
    worst = np.unravel_index(int(np.argmax(excess)), excess.shape)
    row, column, channel = (int(n) for n in worst)
    count = int(np.count_nonzero(change.failed))
    channel_name = "RGB"[channel] if channel < 3 else "contrast"
    top, left = row * new.tile[0], column * new.tile[1]
    bottom = min(top + new.tile[0], new.shape[0]) - 1
    right = min(left + new.tile[1], new.shape[1]) - 1
    return within(
        label,
        "picture",
        float(change.codes[worst]),
        float(change.half_width[worst]),
        SMALLEST_CODES,
        unit="codes",
        p_value=float(change.p_value[worst]),
        detail=f"{count} of {new.power.size} tiles changed; worst in {channel_name} at "
        f"rows {top} to {bottom}, columns {left} to {right}",
    )


def compare_noise(
    baseline: Mapping[str, TileStatistics], candidate: Mapping[str, TileStatistics]
) -> Check:
    """Verdict on the noise of the ground truth, which must not grow because it hides changes.

    The value is the median over tiles and colours of the ratio of standard errors; for an unchanged
    renderer it is the square root of the ratio of samples. The interval uses order statistics.
    """
    ratios_by_image = [_error_ratios(old, candidate.get(n)) for n, old in baseline.items()]
    ratios = np.sort(np.concatenate([np.empty(0), *ratios_by_image]))
    if ratios.size:
        value = float(np.median(ratios))
        interval, passed = _median_interval(ratios), bool(value <= MAX_NOISE_RATIO)
        detail = f"median over {ratios.size} tiles and colours of the ratio of standard errors"
    else:  # no light, or no noise
        passed = not any((tiles.mean_error > 0).any() for tiles in candidate.values())
        value = 1.0 if passed else math.inf
        interval, detail = (value, value), "no tile is noisy in both runs"
    return Check(
        name="ground truth: noise against the baseline",
        kind="noise",
        value=value,
        relation="<=",
        limit=MAX_NOISE_RATIO,
        interval=interval,
        passed=passed,
        unit="",
        detail=detail,
    )


def _error_ratios(old: TileStatistics, new: TileStatistics | None) -> np.ndarray:
    if new is None or new.mean_error.shape != old.mean_error.shape:
        return np.empty(0)
    noisy = (old.mean_error > 0) & (new.mean_error > 0)
    ratios: np.ndarray = (new.mean_error[noisy] / old.mean_error[noisy]).astype(np.float64)
    return ratios


def _median_interval(ordered: np.ndarray) -> tuple[float, float]:
    """Interval of a median. Source: David and Nagaraja, Order Statistics, 2003, section 7.1."""
    from scipy.special import bdtr

    probabilities = bdtr(np.arange(ordered.size), ordered.size, 0.5)
    k = int(np.searchsorted(probabilities, FALSE_ALARM_RATE / 2))
    return float(ordered[max(0, k - 1)]), float(ordered[min(ordered.size - 1, ordered.size - k)])


#: Prefix of images rendered without a generator: their noise is that of the ground truth.
TRUTH = "truth/"
# Difference images amplify changes by this factor; failed tiles are at least this bright.
_GAIN = 8.0
_MIN_BRIGHTNESS = 0.35
_BRIGHTER, _DARKER = np.array([1.0, 0.25, 0.05]), np.array([0.05, 0.3, 1.0])


@dataclass(frozen=True)
class Comparison:
    """Comparison of two runs."""

    verdict: Verdict
    checks: list[Check]
    inputs: list[Change]  #: Changed inputs.
    circumstances: list[Change]  #: Other differences.
    not_compared: list[str]  #: Pictures and scores of the baseline without a counterpart.
    baseline: RunStatistics  #: The part of the baseline that was compared.


def compare(
    baseline: RunStatistics, candidate: RunStatistics, *, allow_changed_inputs: bool = False
) -> Comparison:
    """Compare the images, noise, scores and EIAs of the reference input of two runs.

    If inputs differ, only what both runs have is compared, scores and light decide, and changed
    ones pass with `allow_changed_inputs`.
    """
    inputs = changed_inputs(baseline.inputs, candidate.inputs)
    not_compared: list[str] = []
    if inputs:
        pairs = paired_algorithms(baseline.inputs.algorithms, candidate.inputs.algorithms)
        baseline, not_compared = _comparable_part(_renamed(baseline, pairs), candidate)
    noise = compare_noise(_truth_tiles(baseline), _truth_tiles(candidate))
    assert noise.value is not None
    checks = [
        *compare_pictures(baseline.pictures, candidate.pictures),
        *([] if inputs else [noise]),
        *compare_scores(baseline.scores, candidate.scores, noise.value),
        *compare_fingerprints(baseline.fingerprints, candidate.fingerprints),
    ]
    verdict, checks = judge(
        checks, inputs_changed=bool(inputs), allow_changed_inputs=allow_changed_inputs
    )
    circumstances = changed_circumstances(baseline.circumstances, candidate.circumstances)
    return Comparison(verdict, checks, inputs, circumstances, not_compared, baseline)


def _renamed(run: RunStatistics, pairs: Mapping[str, str]) -> RunStatistics:
    """Statistics of a run under the algorithms' names of another run."""

    def name_of(name: str) -> str:
        return "/".join(pairs.get(part, part) for part in name.split("/"))

    return replace(
        run,
        pictures={name_of(name): tiles for name, tiles in run.pictures.items()},
        scores={name_of(name): scores for name, scores in run.scores.items()},
        fingerprints={name_of(name): value for name, value in run.fingerprints.items()},
    )


def _comparable_part(
    baseline: RunStatistics, candidate: RunStatistics
) -> tuple[RunStatistics, list[str]]:
    """Statistics of a baseline with a counterpart in a candidate, and the names of the others."""
    pictures, scores, fingerprints = candidate.pictures, candidate.scores, candidate.fingerprints
    old_pictures = {
        name: old
        for name, old in baseline.pictures.items()
        if name in pictures and (pictures[name].shape, pictures[name].tile) == (old.shape, old.tile)
    }
    old_scores = {
        scored: {name: score for name, score in by_name.items() if name in scores[scored]}
        for scored, by_name in baseline.scores.items()
        if scored in scores
    }
    old_fingerprints = {
        name: old
        for name, old in baseline.fingerprints.items()
        if name in fingerprints and fingerprints[name].input_sha256 == old.input_sha256
    }
    others = [
        *(f"picture {name}" for name in baseline.pictures if name not in old_pictures),
        *(f"scores of {name}" for name in baseline.scores if name not in old_scores),
        *(f"reference input of {n}" for n in baseline.fingerprints if n not in old_fingerprints),
    ]
    part = replace(
        baseline, pictures=old_pictures, scores=old_scores, fingerprints=old_fingerprints
    )
    return part, others


def _truth_tiles(run: RunStatistics) -> dict[str, TileStatistics]:
    return {name: tiles for name, tiles in run.pictures.items() if name.startswith(TRUTH)}


def tile_pictures(
    baseline: TileStatistics, candidate: TileStatistics
) -> tuple[np.ndarray, np.ndarray]:
    """Images of the baseline's tiles and of their change, (rows, columns, 3) float32, linear RGB.

    Red tiles became brighter, blue tiles darker. Tiles that passed are at a tenth of the intensity.
    """
    change = tile_change(baseline, candidate, sidak(FAMILY_RATE, 4 * baseline.power.size))
    codes = np.nan_to_num(change.codes, nan=255.0)
    largest = np.argmax(np.abs(codes), axis=-1)[..., None]
    largest_change = np.take_along_axis(codes, largest, axis=-1)[..., 0]
    size = np.minimum(1.0, _GAIN * np.abs(largest_change) / 255)
    size = np.where(change.failed, np.maximum(size, _MIN_BRIGHTNESS), 0.1 * size)
    colour = np.where((largest_change > 0)[..., None], _BRIGHTER, _DARKER) * size[..., None]
    return _enlarge(np.nan_to_num(baseline.mean), baseline), _enlarge(colour, baseline)


def _enlarge(values: np.ndarray, tiles: TileStatistics) -> np.ndarray:
    image = np.repeat(np.repeat(values, tiles.tile[0], axis=0), tiles.tile[1], axis=1)
    cropped: np.ndarray = image[: tiles.shape[0], : tiles.shape[1]].astype(np.float32)
    return cropped


def changed_pixels(old: Fingerprint, new: Fingerprint, display: Display) -> np.ndarray:
    """Image of the sampled pixels of the reference input's EIA: grey if equal, red if changed."""
    image = np.zeros((*display.eia_shape, 3), np.float32)
    flat = image.reshape(-1, 3)
    changed = (np.abs(old.sample.astype(np.int16) - new.sample) > 1).any(axis=-1)
    indices = sampled_pixels(display)
    flat[indices] = 0.2
    flat[indices[changed]] = _BRIGHTER
    return image
