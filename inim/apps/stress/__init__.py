"""Stress run: oracles and relations for any algorithm."""
