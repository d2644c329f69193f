"""`li2012`: forward mapping of every picture pixel through every lens, "one to many".

The method of Li et al. (2012) as Wang et al. describe and rival it, Heritage Science 2024, doi
10.1186/s40494-024-01462-4. Through the lens at x0, the picture pixel at X and depth z is shown by
the panel point x = x0 + (x0 - X) g / z (Eq. 1 of Wang et al. solved for x), as long as that lies in
the lens's own elemental image, |x - x0| <= Q / 2. The panel pixel that contains the point takes the
colour. Of several picture pixels that land on one panel pixel the nearest to the viewer, the
largest z, is kept; on a slope of a finely sampled picture that is not the one in the middle of the
panel pixel but the foremost at its rim. Depth conversion, linear or Li's reciprocal one, comes
before: the picture is in the display's depths.

A picture pixel is one point here, however large it appears: where the picture is magnified by more
than a panel pixel, and where a nearer surface gives way to a farther one, panel pixels stay empty,
and a farther surface may show through the gaps of a nearer one. The source map has them as `HOLE`.
The option `fill` paints some of them in the EIA; see `inim.generators.fill`.

What the description leaves open:

* A point on the border between two panel pixels belongs to the one nearer the panel's axis, and on
  the axis to the left or upper one; lenses own whole panel pixels, by their centres.
* Of picture pixels of equal z on one panel pixel, the one that lands nearest to that pixel's centre
  is kept; of these the one nearest to the picture's vertical axis, then to its horizontal one. A
  mirrored picture so gives the mirrored map, but for points exactly on an axis.
* At z = 0 a point is on the array and under every pixel of one lens at once: it is skipped. z < 0,
  virtual images, are mapped by the same formula.
* Colours are mapped to whole pixels: where a pixel's colours shine from places of their own
  (`Display.subpixels`), all are taken at the pixel's centre.
* Elemental images are rectangles along the panel's rows: a hexagonal lattice, and an array that is
  turned or tilted, are refused.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numba.extending import register_jitable

from inim.display import Display
from inim.generators.base import PictureShape, SourceGenerator, require_separable
from inim.generators.fill import FILLS, filled
from inim.generators.forward import ForwardAxis, forward_axes
from inim.generators.options import one_of
from inim.generators.plain import IMPLEMENTATIONS, run
from inim.generators.sources import HOLE, Sources, colour_of
from inim.rgbd import RGBD

__all__ = ["prepare"]


def prepare(
    display: Display,
    shape: PictureShape,
    pixel_mm: float,
    fill: str = "none",
    implementation: str = "compiled",
) -> SourceGenerator:
    """A generator by forward mapping; see the module's text.

    Parameters
    ----------
    display, shape, pixel_mm :
        See `inim.generators.prepare`.
    fill : {"none", "nearest", "biharmonic"}
        How `generate` paints holes inside the object. `sources` never fills: holes are reported
        as the mapping left them.
    implementation : {"compiled", "python"}
        The same result, by numba on all threads or by plain Python on one; the painting is not
        part of the method and the same for both.

    Raises
    ------
    UsageError
        An option of another value, or a display that is not separable.
    """
    how = one_of("fill", fill, FILLS)
    chosen = one_of("implementation", implementation, IMPLEMENTATIONS)
    require_separable(display, "li2012")
    return _Li2012(display, shape, pixel_mm, how, chosen)


class _Li2012(SourceGenerator):
    def __init__(
        self,
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        fill: str,
        implementation: str,
    ) -> None:
        super().__init__(display, shape, pixel_mm)
        self._fill = fill
        self._implementation = implementation

    def find(self, rgbd: RGBD) -> Sources:
        depth, x, y = self._mapping(rgbd)
        nearest = np.full(x.pixels * y.pixels, -np.inf)
        miss = np.full(x.pixels * y.pixels, np.inf)
        shape = self.display.eia_shape
        mapping = (depth, x, y, nearest, miss)
        return run(_map_all, self._implementation, shape, HOLE, *mapping)

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        out = self.place(rgbd, out)
        sources = self.sources(rgbd)
        if self._fill == "none":
            return colour_of(sources, rgbd, out)
        inside = (sources == HOLE) & self._sheet(rgbd)
        return filled(self._fill, sources, inside, rgbd, self.display, out)

    def _sheet(self, rgbd: RGBD) -> np.ndarray:
        """Panel pixels between the images of picture pixels that touch, see `_sheet_of_lens`."""
        shape = self.display.eia_shape
        mapping = self._mapping(rgbd)
        marked = run(_sheet_all, self._implementation, shape, HOLE, *mapping)
        return np.not_equal(marked, HOLE)

    def _mapping(self, rgbd: RGBD) -> tuple[np.ndarray, ForwardAxis, ForwardAxis]:
        """Depths, 0 for what has no place on the panel, and both axes of the mapping."""
        depth = np.where(rgbd.covered, rgbd.depth_mm.astype(np.float64), 0.0)
        placed = depth[depth != 0]
        depths = (float(placed.min()), float(placed.max())) if len(placed) else (0.0, 0.0)
        return depth.ravel(), *forward_axes(self.display, self.shape, self.pixel_mm, depths)


@numba.njit(parallel=True, cache=True, nogil=True)
def _map_all(depth, x, y, nearest, miss, found):  # type: ignore[no-untyped-def]
    """Gather the picture for every lens; no two lenses share a panel pixel."""
    for m in numba.prange(len(y.first)):
        for n in range(len(x.first)):
            _map_through_lens(depth, x, y, m, n, nearest, miss, found)


@register_jitable
def _map_through_lens(depth, x, y, m, n, nearest, miss, found):  # type: ignore[no-untyped-def]
    """Send all picture pixels in a lens's reach through it, nearest to the viewer on top."""
    for r in range(y.low[m], y.high[m]):
        for c in range(x.low[n], x.high[n]):
            z = depth[r * x.cells + c]
            if z == 0.0:
                continue
            across, down = _position(x, n, c, z), _position(y, m, r, z)
            i, j = _panel_pixel(across, x.pixels), _panel_pixel(down, y.pixels)
            if not (x.first[n] <= i < x.end[n] and y.first[m] <= j < y.end[m]):
                continue
            dx, dy = across - (i - (x.pixels - 1) / 2), down - (j - (y.pixels - 1) / 2)
            off, at = dx * dx + dy * dy, j * x.pixels + i
            rival = found[at]
            if z > nearest[at] or (
                z == nearest[at]
                and (off < miss[at] or (off == miss[at] and _nearer_axis(x, y, r, c, rival)))
            ):
                nearest[at], miss[at], found[at] = z, off, r * x.cells + c


@register_jitable
def _position(axis, lens, cell, z):  # type: ignore[no-untyped-def]
    """Where a picture pixel lands, in panel pixels from the panel's middle: see `ForwardAxis`."""
    return (axis.lens_z[lens] * z + (axis.lens_g[lens] - axis.pixel_g[cell])) / (axis.unit * z)


@register_jitable
def _panel_pixel(position, pixels):  # type: ignore[no-untyped-def]
    """The panel pixel that contains a position; outside 0..pixels-1 if none does.

    Counted outwards from the axis, so that the two halves of the panel mirror each other.
    """
    odd = pixels % 2
    # Bounded as a float: far positions would not fit an integer.
    outwards = math.ceil(min(abs(position) - 0.5 * odd, 1.0 * pixels))
    place = pixels // 2 - 1 + odd + outwards
    return place if position >= 0.0 else pixels - 1 - place


@register_jitable
def _nearer_axis(x, y, row, column, rival):  # type: ignore[no-untyped-def]
    """Whether a picture pixel is nearer to the vertical axis than another, then the horizontal."""
    mine = abs(2 * column + 1 - x.cells)
    other = abs(2 * (rival % x.cells) + 1 - x.cells)
    if mine != other:
        return mine < other
    return abs(2 * row + 1 - y.cells) < abs(2 * (rival // x.cells) + 1 - y.cells)


@numba.njit(parallel=True, cache=True, nogil=True)
def _sheet_all(depth, x, y, marked):  # type: ignore[no-untyped-def]
    """Lay the sheet over every elemental image."""
    for m in numba.prange(len(y.first)):
        for n in range(len(x.first)):
            _sheet_of_lens(depth, x, y, m, n, marked)


@register_jitable
def _sheet_of_lens(depth, x, y, m, n, marked):  # type: ignore[no-untyped-def]
    """Mark the panel pixels between the images of each two by two picture pixels that touch.

    As if the picture were a rubber sheet, pinned to the panel points of its pixels and torn
    wherever one of the four is uncovered: what it hides is object, what shows through the tears is
    background. Each patch is widened to whole rows and columns.
    """
    for r in range(max(y.low[m] - 1, 0), min(y.high[m], y.cells - 1)):
        for c in range(max(x.low[n] - 1, 0), min(x.high[n], x.cells - 1)):
            at = r * x.cells + c
            a, b, d, e = depth[at], depth[at + 1], depth[at + x.cells], depth[at + x.cells + 1]
            # Uncovered, or on both sides of the array, between which there is no sheet.
            if min(a, b, d, e) <= 0.0 <= max(a, b, d, e):
                continue
            west, east = _extent(x, n, c, a, d, b, e)
            north, south = _extent(y, m, r, a, b, d, e)
            for j in range(max(north, y.first[m]), min(south + 1, y.end[m])):
                for i in range(max(west, x.first[n]), min(east + 1, x.end[n])):
                    marked[j * x.pixels + i] = 0


@register_jitable
def _extent(axis, lens, cell, z0, z1, z2, z3):  # type: ignore[no-untyped-def]
    """Panel pixels of the four: two with index `cell`, two with the next."""
    p0 = _panel_pixel(_position(axis, lens, cell, z0), axis.pixels)
    p1 = _panel_pixel(_position(axis, lens, cell, z1), axis.pixels)
    p2 = _panel_pixel(_position(axis, lens, cell + 1, z2), axis.pixels)
    p3 = _panel_pixel(_position(axis, lens, cell + 1, z3), axis.pixels)
    return min(p0, p1, p2, p3), max(p0, p1, p2, p3)
