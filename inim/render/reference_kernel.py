"""Reference kernel of all timings: one gather of four bytes per panel pixel, by Dr.Jit.

Milliseconds depend on the machine as much as on the algorithm. Every time is therefore also given
in kernel times, as a multiple of the least work that could be called generating an EIA: each panel
pixel loads one RGBA value of the picture, at the intersection of its ray with the central depth
plane, and stores it. No depth is read. The kernel computes the address from the pixel's index, so
the gather is the only load.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from inim.display import Display
from inim.render import variant
from inim.render.library import dr, mi


def _axis_address(
    display: Display, pixels: int, lenses: int, cells: int, pixel_mm: float
) -> Callable[[Any], Any]:
    """Function from panel columns (or rows, downwards) to picture columns.

    Pixel `i` is ``s = i + 0.5 - pixels / 2`` panel pixels from the axis, under lens
    ``n = s per_lens + lenses / 2``, whose centre is ``c = (n + 0.5 - lenses / 2)`` pitches from it;
    its ray meets the central depth plane (the middle of the depth range, if that is infinite) in
    picture column ``c cells_per_pitch + (c pixels_per_pitch - s) travel + cells / 2``. Rays that
    leave the picture take its outermost pixel.
    """
    panel, pitch, cell = map(display.exact_mm, (display.pixel_pitch_mm, display.pitch_mm, pixel_mm))
    plane_mm = display.central_depth_mm
    if not math.isfinite(plane_mm):
        plane_mm = sum(display.depth_range_mm) / 2
    per_lens = float(panel / display.exact_mm(display.elemental_image_pitch_mm))
    pixels_per_pitch, cells_per_pitch = float(pitch / panel), float(pitch / cell)
    travel = float(panel / cell) * plane_mm / display.gap_mm

    def address(index: Any) -> Any:
        place = mi.Float(index) + (0.5 - pixels / 2)
        lens = dr.floor(place * per_lens + lenses / 2)
        centre = dr.clip(lens, 0, lenses - 1) + (0.5 - lenses / 2)
        # Two small terms rather than one difference of large ones: less is lost to rounding.
        across = (centre * pixels_per_pitch - place) * travel
        column = dr.floor(centre * cells_per_pitch + across + cells / 2)
        return mi.UInt32(dr.clip(column, 0, cells - 1))

    return address


class ReferenceKernel:
    """One gather per panel pixel, ready to be timed.

    * `color`, (H, W, 4) uint8: the display-ready picture.
    """

    def __init__(self, color: np.ndarray, display: Display, pixel_mm: float) -> None:
        variant.use("llvm")  # the generators run on the CPU, so must what they are measured by
        self.shape = display.eia_shape
        (rows, columns), (lens_rows, lens_columns) = display.eia_shape, display.layout.grid
        self._width = color.shape[1]
        self._row = _axis_address(display, rows, lens_rows, color.shape[0], pixel_mm)
        self._column = _axis_address(display, columns, lens_columns, self._width, pixel_mm)
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
        return self._row(row) * self._width + self._column(column)


@contextmanager
def drjit_threads(count: int) -> Iterator[None]:
    """Set Dr.Jit's number of threads, including the caller's, and restore it afterwards."""
    before = dr.thread_count()
    dr.set_thread_count(count)
    try:
        yield
    finally:
        dr.set_thread_count(before)
