"""Properties of a display, computed from its numbers without rendering.

Closed forms (`geometry`) describe the design. Spots and light shares are traced
through the misaligned lens array (`spots`, `crosstalk`). `findings` combines
them; `output` and `figure` present them.
"""
