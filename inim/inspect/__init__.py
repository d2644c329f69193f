"""What a display can do, worked out from its numbers alone: nothing is rendered.

Closed forms (`geometry`) are those of the display as designed; spots and light shares are traced
through the lens array as it really lies (`spots`, `crosstalk`). `findings` puts them
together; `output` and `figure` show them.
"""
