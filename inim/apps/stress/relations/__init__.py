"""Relations by topic."""
