"""Tolerances of a display: random misalignments and their effect on the score."""
