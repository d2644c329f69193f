"""Run time against error: the time and the errors of each algorithm on a scene."""
