"""What a validation writes: pictures, report data, statistics and baselines."""
