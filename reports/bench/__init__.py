"""Studies of run times."""
