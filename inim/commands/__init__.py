"""Commands of the program, one per file; `inim.cli` describes such a module."""
