"""Stress: where an algorithm's numbers are worst, for anybody's algorithm.

Each is set against the exact first hits of displays and pictures that are hard on arithmetic
(`first_hits`), against relations that need no oracle (`relations`), and against itself when its
depth is off by a little (`jitter`). The project's own study of its generators and lens models,
from which the limits of `inim.accuracy_limits` are taken, is `reports/stress/study`.
"""
