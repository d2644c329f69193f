"""Scoreboard: light fields with true views."""
