"""Quilts, and validation of a picture without a scene."""
