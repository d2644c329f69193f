"""Validations of all combinations of a study's values, in one table."""
