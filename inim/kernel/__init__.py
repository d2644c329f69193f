"""Everything that touches Mitsuba and Dr.Jit, behind one folder.

Importing a module of this folder loads the renderer; choose a backend first
(`inim.backend.activate`), which `inim.kernel.variant.use` does.
"""
