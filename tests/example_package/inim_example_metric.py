"""A metric for inim: the mean absolute difference of two pictures."""

import numpy as np

from inim.metrics import Metric


def absolute_difference(reference, test):
    """Of two (rows, columns, 3) sRGB pictures: a map, (rows, columns), whose mean is the score."""
    return np.abs(reference - test).mean(axis=-1)


metric = Metric("mad", absolute_difference, better="lower", range=(0, 1), tolerance=0.002)
