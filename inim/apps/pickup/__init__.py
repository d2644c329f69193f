"""EIAs from raw pictures and from photographs through a lens array."""
