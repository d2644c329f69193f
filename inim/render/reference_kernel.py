"""Reference kernel of all timings: one gather of four bytes per panel pixel, by Dr.Jit.

Milliseconds depend on the machine as much as on the algorithm. Every time is therefore also given
in kernel times, as a multiple of the least work that could be called generating an EIA: each panel
pixel loads one RGBA value of the picture, at the intersection of its ray with the central depth
plane, and stores it. No depth is read. The kernel computes the address from the pixel's index, so
the gather is the only load.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from inim.display import Display
from inim.display.pixels import exact_length
from inim.generators.base import PictureShape
from inim.render import variant


@dataclass(frozen=True)
class AxisAddress:
    """Map from a panel column (or row, downwards) to a picture column, with floor().

    Pixel `i` is ``s = i + 0.5 - pixels / 2`` panel pixels from the axis, under lens
    ``n = s per_lens + lenses / 2``, whose centre is ``c = (n + 0.5 - lenses / 2)`` pitches from it;
    its ray meets the plane in picture column
    ``c cells_per_pitch + (c pixels_per_pitch - s) travel + cells / 2``.

    Attributes
    ----------
    pixels, lenses, cells : int
        Panel pixels, lenses and picture pixels along the axis.
    per_lens : float
        Elemental images per panel pixel.
    pixels_per_pitch, cells_per_pitch : float
        Panel and picture pixels per lens pitch.
    travel : float
        Sideways movement of a ray in picture pixels per panel pixel of offset from its lens centre.
    """

    pixels: int
    lenses: int
    cells: int
    per_lens: float
    pixels_per_pitch: float
    cells_per_pitch: float
    travel: float


def plane_mm(display: Display) -> float:
    """The central depth plane; the middle of the depth range where that is infinite."""
    low, high = display.depth_range_mm
    centre = display.central_depth_mm
    return centre if math.isfinite(centre) else (low + high) / 2


def axis_addresses(
    display: Display, shape: PictureShape, pixel_mm: float
) -> tuple[AxisAddress, AxisAddress]:
    """Addressing of rows and of columns for a picture of `shape` with pixels of `pixel_mm`."""
    panel, pitch, cell = map(exact_length, (display.pixel_pitch_mm, display.pitch_mm, pixel_mm))
    lenses = (display.lens_rows, display.lens_columns)
    rows, columns = (
        AxisAddress(
            pixels,
            count,
            cells,
            float(panel / exact_length(display.elemental_image_pitch_mm)),
            float(pitch / panel),
            float(pitch / cell),
            float(panel / cell) * plane_mm(display) / display.gap_mm,
        )
        for pixels, count, cells in zip(display.eia_shape, lenses, shape, strict=True)
    )
    return rows, columns


class ReferenceKernel:
    """One gather per panel pixel, ready to be timed.

    Parameters
    ----------
    color : (H, W, 4) uint8
        The display-ready picture.
    display : Display
    pixel_mm : float
        Of the picture.
    """

    def __init__(self, color: np.ndarray, display: Display, pixel_mm: float) -> None:
        variant.use("llvm")  # the generators run on the CPU, so must what they are measured by
        self.shape = display.eia_shape
        self._rows, self._columns = axis_addresses(display, color.shape[:2], pixel_mm)
        words = np.ascontiguousarray(color).view(np.uint32)
        self._picture = mi.UInt32(words.ravel())
        dr.eval(self._picture)

    def run(self) -> Any:
        """Gather once, to the end: (rows * columns,) device array of RGBA words."""
        value = dr.gather(mi.UInt32, self._picture, self._address())
        dr.eval(value)
        dr.sync_thread()
        return value

    def addresses(self) -> np.ndarray:
        """Gather addresses, (rows, columns) uint32: ``row * W + column`` of the picture."""
        return np.asarray(self._address()).reshape(self.shape)

    def _address(self) -> Any:
        index = dr.arange(mi.UInt32, self.shape[0] * self.shape[1])
        # Literals, not run-time values: dividing by a known number needs no division.
        row, column = index // self.shape[1], index % self.shape[1]
        return _along(self._rows, row) * self._columns.cells + _along(self._columns, column)


@contextmanager
def drjit_threads(count: int) -> Iterator[None]:
    """Set Dr.Jit's number of threads, including the caller's, and restore it afterwards."""
    before = dr.thread_count()
    dr.set_thread_count(count)
    try:
        yield
    finally:
        dr.set_thread_count(before)


def _along(axis: AxisAddress, index: Any) -> Any:
    """See `AxisAddress`; rays that leave the picture take its outermost pixel."""
    place = mi.Float(index) + (0.5 - axis.pixels / 2)
    lens = dr.floor(place * axis.per_lens + axis.lenses / 2)
    centre = dr.clip(lens, 0, axis.lenses - 1) + (0.5 - axis.lenses / 2)
    # Two small terms rather than one difference of large ones: less is lost to rounding.
    across = (centre * axis.pixels_per_pitch - place) * axis.travel
    cell = dr.floor(centre * axis.cells_per_pitch + across + axis.cells / 2)
    return mi.UInt32(dr.clip(cell, 0, axis.cells - 1))
