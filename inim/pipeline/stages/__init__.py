"""Stages of a validation, one file each, with caching and timing."""
