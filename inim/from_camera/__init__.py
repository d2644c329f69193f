"""The user's own pictures: colour and depth of a real camera, brought into the display frame.

| module          | what it does                                                                  |
| --------------- | ----------------------------------------------------------------------------- |
| `picture`       | all of it: two files that belong together become an RGB-D picture             |
| `picture_files` | reads the colour and the depth picture: numbers as stored, byte order checked |
| `depth_values`  | what the numbers mean: unit, direction, what is missing and how it is filled  |
| `fit`           | its place, size and depths in the display frame; the camera as a pinhole      |
| `framing`       | what of a picture is shown, chosen by its depth: subject, range and place     |
| `depth_photo`   | photographs with depth inside: HEIC, dynamic depth, GDepth, Apple             |
| `tiles`         | its samples as tiles, drawn into the cells of the display's picture           |
| `light_field`   | EIAs of a 4D light field: of its centre view, or of all its views             |

All of it is NumPy and numba; nothing imports the renderer.
"""
