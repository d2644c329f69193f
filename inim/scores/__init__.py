"""Metrics, statistics of regression, and checks."""
