"""Scene files, meshes, and all code that uses Mitsuba and Dr.Jit."""
