"""Reference input: an RGB-D picture that is equal on every machine, and its EIA's fingerprint.

The picture uses only integers and single divisions, which IEEE 754 rounds identically everywhere,
and contains common difficulties of generators. No two neighbours share a colour, so a pixel with
another source has another colour.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from inim.display import Display
from inim.image.rgbd import RGBD
from inim.scores.document_parts import Check
from inim.scores.regression.document import FingerprintRecord
from inim.scores.regression.verdict import FALSE_ALARM_RATE, binomial_interval
from inim.system.row_bands import row_bands

#: Share of the pixels that may change if an algorithm does not guarantee exact equality: rays that
#: graze an edge depend on a machine's rounding.
MAX_CHANGED = 1e-3
# Pixels of an EIA in a baseline, 3 bytes each.
_SAMPLES = 8192


@dataclass(frozen=True)
class Fingerprint:
    """Digest and sample of a generator's EIA of the reference input."""

    exact: bool  #: True if the algorithm guarantees equality.
    #: Digests of the picture and of the EIA's float32 values.
    input_sha256: str
    eia_sha256: str
    #: (n, 3) uint8: linear values times 255 of pixels spread evenly over the lensed panel.
    sample: np.ndarray

    def as_record(self) -> FingerprintRecord:
        """Return the JSON record for a baseline, without the sample."""
        return FingerprintRecord(
            exact=self.exact, input_sha256=self.input_sha256, eia_sha256=self.eia_sha256
        )

    @classmethod
    def of(cls, record: FingerprintRecord, sample: np.ndarray) -> Fingerprint:
        """Build from `as_record` and the sample; raises ValueError for an invalid sample."""
        if sample.ndim != 2 or sample.shape[1] != 3 or sample.dtype != np.uint8:
            raise ValueError(f"a sample of pixels is {sample.dtype} of shape {sample.shape}")
        return cls(record.exact, record.input_sha256, record.eia_sha256, sample)


def reference_input(display: Display, shape: tuple[int, int], pixel_mm: float) -> RGBD:
    """RGB-D picture of a given shape for a display, linear RGB in steps of 1/255.

    It shows a slope from the far to the near end of the depth range, a block near the viewer, thin
    upright bars, and a grid of holes.
    """
    rows, columns = shape
    r, c = np.arange(rows)[:, None], np.arange(columns)[None, :]
    # Depth in 64ths of the range, 2..62: inside the range under any rounding.
    level = 2 + (40 * c) // columns + 0 * r
    block = (r > rows // 3) & (r < rows // 2) & (c > columns // 4) & (c < (5 * columns) // 8)
    level = np.where(block, 56, level)
    bars = (r > (5 * rows) // 8) & (r < (7 * rows) // 8) & (c % 7 == 0)
    level = np.where(bars, 62, level)
    margin = np.minimum(np.minimum(r, rows - 1 - r), np.minimum(c, columns - 1 - c))
    holes = (r % 11 == 3) & (c % 13 == 5)
    covered = (margin >= min(shape) // 16) & ~holes
    low, high = display.depth_range_mm
    depth = np.where(covered, low + (high - low) * (level / 64.0), 0.0).astype(np.float32)
    color = np.where(covered[..., None], _colours(r * columns + c) / np.float32(255), np.float32(0))
    return RGBD(color.astype(np.float32), depth, covered, pixel_mm)


def _colours(index: np.ndarray) -> np.ndarray:
    """Three pseudorandom bytes for each integer. Source: Wang's integer hash, 1997."""
    x = index.astype(np.uint32)
    x = (x ^ np.uint32(61)) ^ (x >> np.uint32(16))
    x = x * np.uint32(9)
    x = x ^ (x >> np.uint32(4))
    x = x * np.uint32(0x27D4EB2D)
    x = x ^ (x >> np.uint32(15))
    parts = [(x >> np.uint32(shift)) & np.uint32(255) for shift in (0, 8, 16)]
    return np.stack(parts, axis=-1).astype(np.float32)


def picture_sha256(rgbd: RGBD) -> str:
    """Digest of colours, depths and coverage."""
    digest = hashlib.sha256()
    for array in (rgbd.color, rgbd.depth_mm, rgbd.covered):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def fingerprint(rgbd: RGBD, eia: np.ndarray, display: Display, *, exact: bool) -> Fingerprint:
    """Compute the fingerprint of a generator's EIA of the reference input.

    The EIA is (rows, columns, 3) float32; `exact` is True if the algorithm guarantees equality.
    """
    indices = sampled_pixels(display)
    values = np.nan_to_num(eia.reshape(-1, 3)[indices], nan=0.0, posinf=1.0, neginf=0.0)
    sample = np.rint(255 * np.clip(values, 0, 1)).astype(np.uint8)
    # Adding zero turns -0 into 0.
    digest = hashlib.sha256()
    for band in row_bands(*display.eia_shape):
        digest.update((eia[band] + np.float32(0)).tobytes())
    return Fingerprint(exact, picture_sha256(rgbd), digest.hexdigest(), sample)


def sampled_pixels(display: Display) -> np.ndarray:
    """Flat indices of the sampled panel pixels, spread evenly over the lensed ones."""
    lensed = np.flatnonzero(display.lensed)
    # Golden-section steps spread evenly (Weyl); without a common divisor they never repeat.
    step = max(1, round(lensed.size * (math.sqrt(5) - 1) / 2))
    while math.gcd(step, lensed.size) != 1:
        step += 1
    indices: np.ndarray = lensed[(np.arange(min(_SAMPLES, lensed.size)) * step) % lensed.size]
    return indices


def compare_fingerprints(
    baseline: Mapping[str, Fingerprint], candidate: Mapping[str, Fingerprint]
) -> list[Check]:
    """Verdicts on the baseline's generators: equality, or the share of changed pixels.

    An algorithm that the candidate lacks fails.
    """
    return [_verdict(name, old, candidate.get(name)) for name, old in baseline.items()]


def _verdict(name: str, old: Fingerprint, new: Fingerprint | None) -> Check:
    limit = 0.0 if old.exact else MAX_CHANGED
    value, interval, passed = math.nan, (math.nan, math.nan), False
    if new is None or new.sample.shape != old.sample.shape:
        detail = "the EIA of the reference input is missing or of another size"
    elif new.eia_sha256 == old.eia_sha256:
        value, interval, passed, detail = 0.0, (0.0, 0.0), True, "all values are equal"
    else:
        # Averages of several rays may round to either of two codes.
        changed = (np.abs(old.sample.astype(np.int16) - new.sample) > 1).any(axis=-1)
        count, trials = int(np.count_nonzero(changed)), len(changed)
        interval = binomial_interval(count, trials, FALSE_ALARM_RATE)
        passed = not old.exact and count / trials <= limit
        detail = f"{count} of {trials} sampled pixels"
        if old.exact:
            detail += "; the SHA-256 of the EIA differs, and this algorithm guarantees equality"
        # For an exact algorithm, a change outside the sample counts, too.
        value = max(count, 1) / trials if old.exact else count / trials
    return Check(
        name=f"{name}: changed pixels of the reference input",
        kind="pixels",
        value=100 * value,
        relation="<=",
        limit=100 * limit,
        interval=(100 * interval[0], 100 * interval[1]),
        passed=passed,
        unit="%",
        detail=detail,
    )
