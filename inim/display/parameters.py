"""Types of a display's parameters."""

from typing import Literal

CurvedSide = Literal["viewer", "panel"]
Lattice = Literal["square", "hexagonal", "lenticular"]
Aperture = Literal["square", "round"]
BetweenLenses = Literal["dark", "clear"]
Subpixels = Literal["none", "rgb-stripe", "pentile", "cells"]
CellPattern = Literal["single", "checkerboard", "columns", "rows", "rows-of-4", "staggered"]
#: Red's, green's and blue's centre, right and up of the pixel's in pixels, of each kind of pixel.
Cells = tuple[tuple[float, ...], ...]
#: Layers between lenses and panel, from the lenses on: thickness in mm, refractive index.
Layers = tuple[tuple[float, float], ...]
