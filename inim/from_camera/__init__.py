"""The user's own pictures: colour and depth of a real camera, brought into the display frame.

| module         | what it does                                                                   |
| -------------- | ------------------------------------------------------------------------------ |
| `color_file`   | reads the colour picture                                                       |
| `depth_file`   | reads the depth picture: numbers as stored, byte order looked at               |
| `depth_values` | what the numbers mean: unit, direction, what is missing; sanity checks         |
| `missing`      | fill rules for missing depth                                                   |
| `registration` | whether colour and depth belong together: sizes, shift                         |
| `camera`       | pinhole intrinsics                                                             |
| `depth_map`    | from distances to depths of the display, linear or reciprocal                  |
| `fit`          | place and size of the picture in the display frame                             |
| `tiles`        | its samples as tiles drawn into the orthographic cells of the display's picture |

All of it is NumPy and numba; nothing imports the renderer.
"""

from pathlib import Path

from inim.backend.numba_cache import settle_cache

# Before `tiles` imports numba, which refuses to start where it can keep nothing.
settle_cache(Path(__file__).parent)
