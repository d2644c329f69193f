"""False alarms and power of the comparison with a baseline."""
