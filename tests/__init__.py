"""Tests of all tiers; the settings of their processes."""

import os

# Waiting threads of GNU OpenMP and of OpenBLAS keep the processor busy. With more processes than
# cores, that took most of the time. OpenBLAS reads its variable when NumPy is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
