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
