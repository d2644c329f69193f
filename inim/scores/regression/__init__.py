"""Regression checks: comparison of a run with a baseline, with verdicts as data.

This package neither renders nor prints nor writes reports. A change fails if noise does not explain
it *and* it is large enough to count. A missing or nonfinite value fails. Runs under different
conditions are not compared. docs/theory/regression.md lists what is stored and tested.
"""
