"""Oracles: definitions in other arithmetic and by other methods."""
