"""inim-bench: a benchmark of algorithms for elemental images."""
