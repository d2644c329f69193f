"""Regression checks: comparison of a run with a baseline, with verdicts as data.

This package neither renders nor prints nor writes reports. A change fails if noise does not explain
it *and* it is large enough to count. A missing or nonfinite value fails. Changed inputs are named,
and scores and light decide. docs/theory/regression.md lists what is stored and tested.
"""
