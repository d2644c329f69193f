"""Picture files: colour, depth, EIAs and light fields."""
