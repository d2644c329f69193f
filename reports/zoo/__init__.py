"""Public files, with expectations from other programs."""
