"""Base classes of generators: prepared once for a display, then applied to RGB-D pictures.

Most generators report, for each panel pixel, the picture pixel that it shows: a source map
(`Sources`).

With a mask, for example of the pixels that a few viewpoints observe, only those panel pixels are
generated. Some generators take it (`SourceGenerator.mask`) and skip the other pixels. The others
run in full, and `Masked` sets the remaining pixels to black. Both give the same bits, because each
pixel depends only on its own ray and the picture.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cache
from types import FunctionType
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from inim.display import Display
from inim.display.pixels import CENTRE, PixelOffset
from inim.image.rgbd import RGBD
from inim.system.errors import UsageError
from inim.system.row_bands import row_bands

#: A larger share of a picture outside the depth range is most likely in another unit.
MOST_OUTSIDE = 0.5
#: A panel pixel whose ray meets no surface.
HOLE = -1
#: A panel pixel outside the lens array: dark by construction, not a hole.
NO_LENS = -2
#: A panel pixel outside the pixel mask.
MASKED = -3

# Indices and colours of so many pixels stay in a processor's cache.
_PIXELS_AT_ONCE = 2**15

#: (rows, columns) int32: ``row * W + column`` of the picture's pixel, `HOLE` or `NO_LENS`.
Sources = NDArray[np.int32]


def colour_of(sources: Sources, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
    """Colours of a source map, (rows, columns, channels) in the picture's type.

    Where there is no source: zeros, which is black in float and transparent black in RGBA.
    """
    channels = rgbd.color.shape[2]
    # One empty pixel at the end serves holes and unlensed pixels alike.
    hole_colour = np.zeros((1, channels), rgbd.color.dtype)
    palette = np.concatenate([rgbd.palette.reshape(-1, channels), hole_colour])
    if out is None:
        out = np.empty((*sources.shape, channels), palette.dtype)
    nowhere = len(palette) - 1
    for band in row_bands(sources.shape[0], sources.shape[1], _PIXELS_AT_ONCE):
        band_sources = sources[band]
        if band_sources.max(initial=HOLE) >= nowhere:
            raise UsageError(
                f"a source is {band_sources.max()}; this picture has 0 to {nowhere - 1}, and "
                f"{NO_LENS} and "
                f"{HOLE} mean none"
            )
        index = np.where(band_sources >= 0, band_sources, nowhere)
        # Not "raise", by which all of the output would be written twice.
        np.take(palette, index, axis=0, out=out[band], mode="clip")
    return out


def hole_fraction(sources: Sources) -> float:
    """Share of panel pixels under a lens, and inside the mask, without a source."""
    lensed = np.count_nonzero(sources > NO_LENS)
    return np.count_nonzero(sources == HOLE) / lensed if lensed else 0.0


#: Writes the sources of a slice of rows into an array of that many rows.
Search = Callable[[slice, Sources], None]
#: Rows, columns of a picture.
PictureShape = tuple[int, int]


@runtime_checkable
class Generator(Protocol):
    """Generator prepared for one display and one size of picture, reusable for a stream.

    A package that registers a generator (`inim.generators`) provides a callable
    ``prepare(display, shape, pixel_mm, **options)`` that returns one of these.
    """

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """Generate the EIA of a picture, with the dtype of its colour.

        Parameters
        ----------
        rgbd : RGBD
            Picture of the prepared shape and pixel size.
        out : array, optional
            Array for the result: (rows, columns, channels) of the colour's dtype.

        Returns
        -------
        (rows, columns, 3) float32 linear RGB, or (rows, columns, 4) uint8 sRGB with alpha 0 at
        holes.
        """
        ...


class Ray(NamedTuple):
    """One ray of every pixel: its start in the pixel, its colour channels and their sources."""

    pixel_offset: PixelOffset
    channels: tuple[int, ...]
    generator: SourceGenerator


class SourceGenerator(ABC):
    """Generator that reports the source of each panel pixel.

    Subclasses implement `find`. Sources distinguish holes from black and allow comparisons of
    algorithms pixel by pixel. They are those of the pixel's centre, even if several rays, or sub-
    pixels off the centre, determine its colour.

    Parameters
    ----------
    display : Display
    shape : (rows, columns)
        Size of the pictures.
    pixel_mm : float
        Width of their pixels.
    mask : (rows, columns) bool, optional
        Panel pixels to find; the others are `MASKED`.
    pixel_offset : PixelOffset
        Start of each ray in its pixel.
    """

    #: For those by others that do without this class's `__init__`.
    mask: np.ndarray | None = None
    pixel_offset: PixelOffset = CENTRE

    def __init__(
        self,
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        mask: np.ndarray | None = None,
        pixel_offset: PixelOffset = CENTRE,
    ) -> None:
        self.display = display
        self.shape = shape
        self.pixel_mm = pixel_mm
        self.mask = mask
        self.pixel_offset = pixel_offset

    @property
    def selected(self) -> np.ndarray:
        """Panel pixels under lenses, and in the mask, (rows, columns) bool."""
        lensed = self.display.lensed
        return lensed if self.mask is None else lensed & self.mask

    @abstractmethod
    def find(self, rgbd: RGBD) -> Sources:
        """Sources of all panel pixels; those outside the mask or lenses may hold anything."""

    def search(self, rgbd: RGBD) -> Search:
        """Function that finds the sources of some panel rows; see `sources`."""
        sources = self.sources(rgbd)

        def find_rows(rows: slice, out: Sources) -> None:
            out[...] = sources[rows]

        return find_rows

    def search_all(self, rays: Sequence[SourceGenerator], rgbd: RGBD) -> list[Search]:
        """Results of `search` of this and other generators, for the same picture."""
        return [ray.search(rgbd) for ray in rays]

    def sources(self, rgbd: RGBD) -> Sources:
        """``row * W + column`` of each panel pixel's source, `HOLE`, `NO_LENS` or `MASKED`."""
        self.check(rgbd)
        sources = self.find(rgbd)
        self.mark(slice(None), sources)
        return sources

    def mark(self, rows: slice, sources: Sources) -> None:
        """Mark sources of some panel rows outside the mask, and where there is no lens."""
        if self.mask is not None:
            sources[~self.mask[rows]] = MASKED
        if self.display.is_separable:  # whole rows and columns: faster than pixel by pixel
            sources[self.display.rows.lens[rows] < 0, :] = NO_LENS
            sources[:, self.display.columns.lens < 0] = NO_LENS
        else:
            sources[~self.display.lensed[rows]] = NO_LENS

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`."""
        return colour_of(self.sources(rgbd), rgbd, self.place(rgbd, out))

    def rays(self) -> list[Ray]:
        """The rays whose colours it shows; the mean of them, of several that show one colour."""
        return [Ray(self.pixel_offset, (0, 1, 2), self)]

    def shows_sources(self, rgbd: RGBD) -> bool:  # noqa: ARG002
        """True if the colours of its sources are the complete result for a picture."""
        return type(self).generate is SourceGenerator.generate

    def place(self, rgbd: RGBD, out: np.ndarray | None) -> NDArray[Any]:
        """Array for the result of a picture; see `check_out`."""
        return check_out(out, (*self.display.eia_shape, rgbd.color.shape[2]), rgbd.color.dtype)

    def check(self, rgbd: RGBD) -> None:
        """Raise `UsageError` for a picture of another size than prepared for."""
        if rgbd.shape != self.shape or rgbd.pixel_mm != self.pixel_mm:
            raise UsageError(
                f"picture of {rgbd.shape[0]} x {rgbd.shape[1]} pixels of {rgbd.pixel_mm:g} mm; "
                f"this generator was prepared for {self.shape[0]} x {self.shape[1]} of "
                f"{self.pixel_mm:g} mm: prepare another"
            )


def require_separable(display: Display, name: str) -> None:
    """Raise `UsageError` where a generator that counts rows and columns apart cannot serve."""
    if not display.is_separable:
        raise UsageError(
            f"{name}: needs pixels whose rows and columns are independent, and this display has "
            f"{display.not_separable_by}; use template or gu2020"
        )


def check_mask(mask: np.ndarray, display: Display) -> None:
    """Raise `UsageError` unless a mask is (rows, columns) bool of the panel."""
    if mask.dtype != bool or mask.shape != display.eia_shape:
        raise UsageError(
            f"mask is {mask.dtype} of shape {mask.shape}; it must be bool of the panel's "
            f"{display.eia_shape}"
        )


def check_out(out: np.ndarray | None, shape: tuple[int, ...], dtype: np.dtype) -> NDArray[Any]:
    """The array to write into: `out`, or a new one without it.

    Raises `UsageError` for another shape, type or layout, and for an array that is not writable.
    """
    if out is None:
        return np.empty(shape, dtype)
    if out.shape != shape or out.dtype != dtype:
        raise UsageError(
            f"out is {out.dtype} of shape {out.shape}; this picture and display need {dtype} of "
            f"shape {shape}"
        )
    if not (out.flags.c_contiguous and out.flags.writeable):
        raise UsageError("out must be writable and contiguous in C order")
    return out


class Masked:
    """A generator run in full, with only the pixels of a mask, (rows, columns) bool, shown."""

    def __init__(self, whole: Generator, mask: np.ndarray) -> None:
        self._whole, self.mask = whole, mask

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`."""
        eia = self._whole.generate(rgbd)  # it may keep one place to write to: leave that alone
        if out is None:
            out = np.empty_like(eia)
        else:
            check_out(out, eia.shape, eia.dtype)
        out[...] = np.where(self.mask[..., None], eia, np.zeros((), eia.dtype))
        return out


class MaskedSources(SourceGenerator):
    """`Masked` for a generator that reports its sources."""

    def __init__(self, whole: SourceGenerator, mask: np.ndarray) -> None:
        super().__init__(whole.display, whole.shape, whole.pixel_mm, mask)
        self._whole, self._shown = whole, Masked(whole, mask)

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        return self._whole.find(rgbd)

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`."""
        return self._shown.generate(rgbd, out)


def outside_depth_range(rgbd: RGBD, display: Display) -> float:
    """Share of a picture's covered pixels that lie outside a display's depth range."""
    low, high = display.depth_range_mm
    depth = rgbd.depth_mm[rgbd.covered]
    return float(((depth < low) | (depth > high)).mean()) if depth.size else 0.0


def outside_depth_text(rgbd: RGBD, display: Display) -> str:
    """Message that a picture exceeds a display's depth range, with the remedy."""
    low, high = display.depth_range_mm
    depth = rgbd.depth_mm[rgbd.covered]
    return (
        f"{outside_depth_range(rgbd, display):.0%} of it is outside the display's depth range, "
        f"{low:.4g} to {high:.4g} mm: its depths are {depth.min():.4g} to {depth.max():.4g}, in "
        "millimetres towards the viewer; fit it to this display with `inim generate --save-rgbd`"
    )


def check_array(array: Any, shape: tuple[int, ...], kind: str) -> None:
    """Raise `ValueError` unless a generator's result is an array of this shape and type."""
    if not isinstance(array, np.ndarray) or array.shape != shape or array.dtype != kind:
        result = f"{getattr(array, 'dtype', type(array).__name__)} {np.shape(array)}"
        raise ValueError(f"the result is {result}; this display needs {kind} {shape}")


def run_kernel(
    kernel: Any, turns: int, shape: tuple[int, int], start: int, *arguments: Any
) -> NDArray[np.int32]:
    """Fill a map of panel pixels, (rows, columns) int32, with a kernel, on several threads.

    The kernel is called with the first and the end of some turns of its outer loop, the arguments
    (numbers, flat arrays and named tuples of them), and the map as a flat array, whose initial
    value is `start`.
    """
    from inim.system.backend.kernels import share_rows

    filled = np.full(shape, start, np.int32)
    share_rows(compile_kernel(kernel), turns, *arguments, filled.ravel())
    return filled


@cache
def compile_kernel(kernel: FunctionType) -> Any:
    """A plain function compiled by numba, and with it the functions of this package it calls.

    Wang et al., Heritage Science 2024, doi 10.1186/s40494-024-01462-4, time algorithms written as
    plain Python loops. The kernels of the paper's algorithms are in the part of Python that both
    interpreter and numba run. With ``NUMBA_DISABLE_JIT=1`` in the environment they run uncompiled:
    the same arithmetic to the bit.
    """
    from inim.system.backend import kernels

    names = dict(kernel.__globals__)
    for name in kernel.__code__.co_names:
        if isinstance(value := names.get(name), FunctionType):
            names[name] = compile_kernel(value)
    copy = FunctionType(kernel.__code__, names, kernel.__name__)
    copy.__qualname__ = kernel.__qualname__
    return kernels.compiled(copy)
