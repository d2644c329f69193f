"""Mesh and splat files."""
