"""How accurately a display must be known: misalignments drawn at random, and what each costs."""
