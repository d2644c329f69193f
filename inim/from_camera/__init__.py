"""Users' own pictures: colour and depth of a real camera, converted to the display frame.

| module          | contents                                                                      |
| --------------- | ----------------------------------------------------------------------------- |
| `picture`       | conversion of a colour and a depth file to an RGB-D picture, start to end     |
| `picture_files` | reads the colour and the depth picture: numbers as stored, byte order checked |
| `depth_values`  | interpretation of depth: unit, direction, missing values and their filling    |
| `fit`           | position, size and depths in the display frame; the pinhole camera            |
| `framing`       | automatic crop and depth range, chosen by the subject's depth                 |
| `depth_photo`   | photographs with depth inside: HEIC, dynamic depth, GDepth, Apple             |
| `tiles`         | rendering of samples, as tiles, into the cells of the display's picture       |
| `light_field`   | EIAs of a 4D light field: from its centre view, or from all its views         |

The package uses NumPy and numba, and never imports the renderer.
"""
