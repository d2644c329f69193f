"""Exact first hits in rational numbers: the definition of `template` and `layered`.

Validations of users' own pictures and `inim.apps.stress.run` score algorithms against this oracle.
It shares no code with the generators: it collects and sorts all border crossings of a ray, whereas
the generators walk from cell to cell. Nothing is rounded, so the definition decides ties
(docs/theory/templates.md). Lengths are the numbers that a person wrote (`Display.exact_mm`), a
float32 depth is exactly its value, and only the backs of columns are float32 arithmetic, by
definition.

`tests/oracle.py` checks this oracle with a second rational oracle, written independently with
another method. Both must agree.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise, product

import numpy as np

from inim.display import Display
from inim.display.layouts import LensAxis
from inim.display.pixels import CENTRE, PixelOffset
from inim.generators.base import HOLE, Sources
from inim.image.rgbd import RGBD, Layer, LayeredRGBD

# Panel pixels that are followed in fractions, a millisecond or two each; a share of one in a
# hundred is known to a quarter of it.
_MOST_PIXELS = 2000

#: Row and column ``v0 + dv z, u0 + du z`` of a ray: v0, dv, u0, du.
Line = tuple[Fraction, Fraction, Fraction, Fraction]


@dataclass(frozen=True)
class ExactHits:
    """Exact sources of some panel pixels by the definition of a first hit, in rational numbers.

    * `pixels`, (n, 2) int: row and column of each.
    * `sources`, (n,) int64: ``(layer * H + row) * W + column``, or `HOLE`.
    """

    pixels: np.ndarray
    sources: np.ndarray

    def wrong_share(self, sources: Sources) -> float:
        """Share of them that a source map has otherwise."""
        sources_at_pixels = sources[self.pixels[:, 0], self.pixels[:, 1]]
        return float((sources_at_pixels != self.sources).mean())


@dataclass(frozen=True)
class AxisRays:
    """Rays of one panel axis: ``cell(z) = start + slope z`` in picture cells; lens -1: none."""

    lens: tuple[int, ...]
    start: tuple[Fraction, ...]
    slope: tuple[Fraction, ...]


def why_no_oracle(rgbd: RGBD, display: Display) -> str | None:
    """Reason why a validation has no exact hits for a picture on a display; None if it has."""
    if not display.is_separable:
        return (
            "the exact oracle counts rows and columns apart, and this display has "
            f"{display.not_separable_by}"
        )
    if isinstance(rgbd, LayeredRGBD):
        return "the exact oracle knows one layer, and this picture has more"
    return None


def exact_hits(
    rgbd: RGBD, display: Display, columns: str = "surface", most: int = _MOST_PIXELS
) -> ExactHits:
    """Exact first hits of panel pixels under lenses: of all, or of a random sample of them.

    * `display`: separable.
    * `columns`, {"surface", "solid", "layers"}: see `column_layers`.
    """
    pixels = lensed_pixels(display)
    if len(pixels) > most:
        pixels = pixels[np.random.default_rng(0).choice(len(pixels), most, replace=False)]
    down, across = axis_rays(display, rgbd)
    lines = ((down.start[r], down.slope[r], across.start[c], across.slope[c]) for r, c in pixels)
    return ExactHits(pixels, first_hits_of(lines, rgbd, display, columns))


def column_layers(rgbd: RGBD, columns: str) -> tuple[tuple[Layer, ...], bool]:
    """Solids of a picture's columns, and whether the background continues behind them.

    * `columns`, {"surface", "solid", "layers"}: as of `template:columns=`; or those of a layered
      depth image, "surface" of other pictures.
    """
    if columns == "layers" and isinstance(rgbd, LayeredRGBD):
        return rgbd.layers, False
    no_back = np.full(rgbd.shape, -np.inf, np.float32)
    back = no_back if columns == "solid" else _surface_backs(rgbd)
    return (Layer(rgbd.color, rgbd.depth_mm, back, rgbd.covered),), columns != "solid"


def _surface_backs(rgbd: RGBD) -> np.ndarray:
    """The lowest of the eight neighbours that are joined to each pixel, or ten pixels behind it."""
    rows, columns = rgbd.shape
    depth = np.where(rgbd.covered, rgbd.depth_mm, np.float32(np.nan))
    padded = np.pad(depth, 1, constant_values=np.nan)
    back = depth - np.float32(10 * rgbd.pixel_mm)
    for down, right in product((0, 1, 2), repeat=2):
        beside = padded[down : down + rows, right : right + columns]
        steepest = np.float32(20 * rgbd.pixel_mm * math.hypot(down - 1, right - 1))
        back = np.where(depth - beside <= steepest, np.fmin(back, beside), back)
    return back


# -- rays ---------------------------------------------------------------------------------------


def _owners(axis: LensAxis) -> tuple[int, ...]:
    """Lens over each pixel: the elemental image that holds its centre, -1 outside."""
    owners = []
    for i in range(axis.pixels):
        from_axis = (Fraction(2 * i + 1 - axis.pixels, 2) * axis.pixel - axis.shift) / axis.cell
        place = from_axis + Fraction(axis.lenses, 2)
        lens = math.floor(place)
        if lens == place and from_axis >= 0:
            lens -= 1
        owners.append(lens if 0 <= lens < axis.lenses else -1)
    return tuple(owners)


def lensed_pixels(display: Display) -> np.ndarray:
    """Row and column of every panel pixel under a lens, (n, 2); of a separable display."""
    down, across = (np.array(_owners(display.layout.axis(sign))) >= 0 for sign in (-1, +1))
    return np.argwhere(down[:, None] & across[None, :])


def axis_rays(
    display: Display, rgbd: RGBD, pixel_offset: PixelOffset = CENTRE
) -> tuple[AxisRays, AxisRays]:
    """Exact rays of all panel rows and all columns of a separable display.

    A ray with an offset in its pixel keeps that pixel's lens.
    """
    gap, cell = display.exact_mm(display.gap_mm), display.exact_mm(rgbd.pixel_mm)
    return (
        _rays(display.layout.axis(-1), gap, rgbd.shape[0], cell, pixel_offset[0]),
        _rays(display.layout.axis(+1), gap, rgbd.shape[1], cell, pixel_offset[1]),
    )


def _rays(
    panel: LensAxis, gap: Fraction, cells: int, cell: Fraction, pixel_offset: Fraction
) -> AxisRays:
    """Rays of one axis by Eq. 1, X(z) = x0 + (x0 - x) z / g, in cells, right or down."""
    start, slope = [], []
    owners = _owners(panel)
    for i, owner in enumerate(owners):
        x = (Fraction(2 * i + 1 - panel.pixels, 2) + pixel_offset) * panel.pixel
        x0 = Fraction(2 * owner + 1 - panel.lenses, 2) * panel.pitch + panel.shift
        start.append(x0 / cell + Fraction(cells, 2))
        slope.append((x0 - x) / (gap * cell))
    return AxisRays(owners, tuple(start), tuple(slope))


# -- hits ---------------------------------------------------------------------------------------


def first_hits_of(
    lines: Iterable[Line], rgbd: RGBD, display: Display, columns: str = "surface"
) -> np.ndarray:
    """Source of each ray, (n,) int64: ``(layer * H + row) * W + column``, or `HOLE`."""
    low, high = map(display.exact_mm, display.depth_range_mm)
    low = min(low, Fraction(display.traced_range_mm[0]))  # exact: it may be a float32
    columns_of_picture = column_layers(rgbd, columns)
    return np.array([_first_hit(line, *columns_of_picture, low, high) for line in lines], np.int64)


def _first_hit(
    line: Line, layers: tuple[Layer, ...], continues: bool, low: Fraction, high: Fraction
) -> int:
    first = layers[0]
    rows, columns = first.covered.shape
    passed_over, behind = HOLE, False
    for entry, end, r, c in _spans(line, low, high):
        if not (0 <= r < rows and 0 <= c < columns):
            continue
        for number, layer in enumerate(layers):
            if not layer.covered[r, c] or float(layer.front_mm[r, c]) < end:
                continue
            if entry is None or float(layer.back_mm[r, c]) <= entry:
                return int((number * rows + r) * columns + c)
        if not first.covered[r, c]:
            passed_over = HOLE
        elif float(first.front_mm[r, c]) < end:
            passed_over = int(r * columns + c)
        else:
            behind = True
    return passed_over if behind and continues else HOLE


def _spans(
    line: Line, low: Fraction, high: Fraction
) -> Iterator[tuple[Fraction | None, Fraction, int, int]]:
    """Depth at which a ray enters a cell, None in front of all, and leaves it; row and column."""
    v0, dv, u0, du = line
    ends = sorted({low, high, *_meets(v0, dv, low, high), *_meets(u0, du, low, high)}, reverse=True)
    for top, end in pairwise(ends):
        middle = (top + end) / 2
        entry = None if top == high else top
        yield entry, end, math.floor(v0 + dv * middle), math.floor(u0 + du * middle)


def _meets(start: Fraction, slope: Fraction, low: Fraction, high: Fraction) -> list[Fraction]:
    """Depths strictly inside the range at which a ray meets borders."""
    if slope == 0:
        return []
    a, b = sorted((start + slope * low, start + slope * high))
    return [(k - start) / slope for k in range(math.floor(a) + 1, math.ceil(b))]
