"""Stress: where an algorithm's numbers are worst, for anybody's algorithm.

Each is compared with the exact first hits of displays and pictures that are hard on arithmetic, and
with itself when its depth is off by a little (`checks`), and checked by relations that need no
oracle (`relations`). The project's own study of its generators and lens models, from which the
limits of `inim.inspection.accuracy_limits` are taken, is `reports/stress/study`.
"""
