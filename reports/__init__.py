"""Studies of this project, and their results."""
