"""Regression checks: comparison of a run with a baseline, with verdicts as data.

This package neither renders nor prints nor writes reports. It compares:

| compared                | stored in the baseline         | verdict                           |
| ----------------------- | ------------------------------ | --------------------------------- |
| rendered images, EIAs   | tiles' means, power, errors    | Welch's t-test per tile, Sidak    |
| scores                  | plain score, error, bias       | t-interval of the change          |
| noise of ground truth   | tiles' errors                  | median ratio                      |
| generators' EIAs        | SHA-256, a sample of pixels    | equality, or share that changed   |
| times                   | ratios to the reference kernel | rank-sum interval of the slowdown |

A change fails if noise does not explain it *and* it is large enough to count. A missing or
nonfinite value fails. Runs under different conditions are not compared.
"""

from inim.regression.comparison import (
    changed_circumstances,
    changed_pixels,
    check_comparable,
    check_times,
    compare,
    drift,
    is_steady,
    kernel_times,
    log_ratios,
    tile_pictures,
)
from inim.regression.fingerprints import Fingerprint, fingerprint, reference_input
from inim.regression.run_statistics import (
    BASELINE,
    CANDIDATE,
    RunStatistics,
    read_statistics,
    write_statistics,
)
from inim.regression.scores import ScoreEstimate, is_above, score_interval, view_scores
from inim.regression.tiles import TileStatistics, eia_tile, tile_statistics, view_tile
from inim.regression.verdict import Verdict, all_passed

__all__ = [
    "BASELINE",
    "CANDIDATE",
    "Fingerprint",
    "RunStatistics",
    "ScoreEstimate",
    "TileStatistics",
    "Verdict",
    "all_passed",
    "changed_circumstances",
    "changed_pixels",
    "check_comparable",
    "check_times",
    "compare",
    "drift",
    "eia_tile",
    "fingerprint",
    "is_above",
    "is_steady",
    "kernel_times",
    "log_ratios",
    "read_statistics",
    "reference_input",
    "score_interval",
    "tile_pictures",
    "tile_statistics",
    "view_scores",
    "view_tile",
    "write_statistics",
]
