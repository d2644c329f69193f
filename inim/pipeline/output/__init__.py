"""Output of a validation: images, report data, statistics and baselines."""
