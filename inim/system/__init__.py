"""Errors, processes, caches, the renderer library, other packages' plugins, and documents."""
