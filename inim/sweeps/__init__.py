"""A sweep: scenes, displays, algorithms, viewpoints and settings, multiplied into one table."""
