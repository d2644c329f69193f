"""Scene files: stock Mitsuba XML with `inim.*` settings."""
