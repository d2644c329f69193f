"""A metric for inim: the mean absolute difference of two images."""

import numpy as np

from inim.scores.metrics import Metric


def absolute_difference(reference, test):
    """Map, (rows, columns), of the difference of two (rows, columns, 3) sRGB images."""
    return np.abs(reference - test).mean(axis=-1)


metric = Metric("mad", absolute_difference, better="lower", range=(0, 1), tolerance=0.002)
