"""Whole jobs: what the commands do, from files to files."""
