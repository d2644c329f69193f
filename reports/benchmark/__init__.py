"""The published board of inim-bench, its statistics, and an outside program."""
