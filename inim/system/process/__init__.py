"""Child processes, threads, signals and progress."""
