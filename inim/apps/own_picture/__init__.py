"""Users' own pictures: colour and depth of a real camera, converted to the display frame.

`picture` is the conversion from start to end, `cameras` that of several cameras, and `light_field`
that of a 4D light field. The package uses NumPy and numba, and never imports the renderer.
"""
