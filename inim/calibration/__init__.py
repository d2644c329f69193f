"""A real display's parameters, from photographs of patterns that it shows."""
