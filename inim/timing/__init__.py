"""Times that can be compared: methods in turn, warm, in multiples of a reference kernel.

What else a machine does (other programs, clock rates, heat) changes from second to second. Run in
turn, round after round, all methods and the reference kernel suffer it alike, and their ratios
stay. A ratio's unit is the yardstick: one run of `inim.render.reference_kernel`.

Generators are timed on the display-ready picture, 8-bit sRGB with alpha as a player has it, and
write their EIA into place. A method of another package is timed like any other.
"""
