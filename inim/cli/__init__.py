"""Entry points, and the commands that validate scenes and compare reports."""
