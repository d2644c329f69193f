"""Accuracy study."""
