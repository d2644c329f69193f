"""Rays of a panel, the sources that they have in a picture, and the interface of generators.

Most algorithms find, for each panel pixel, the picture pixel that it shows: a source map
(`Sources`). `inim.generators.steps` makes elemental image arrays from sources.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from types import FunctionType
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from inim.display import Display
from inim.display.pixels import PixelOffset
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
        check_range(band_sources, nowhere)
        index = np.where(band_sources >= 0, band_sources, nowhere)
        # Not "raise", by which all of the output would be written twice.
        np.take(palette, index, axis=0, out=out[band], mode="clip")
    return out


def check_range(sources: Sources, pixels: int) -> None:
    """Raise `UsageError` unless sources are among the pixels of a picture, or negative."""
    if sources.max(initial=HOLE) >= pixels:
        raise UsageError(
            f"a source is {sources.max()}; this picture has 0 to {pixels - 1}, and {NO_LENS} and "
            f"{HOLE} mean none"
        )


def hole_fraction(sources: Sources) -> float:
    """Share of panel pixels under a lens, and inside the mask, without a source."""
    lensed = np.count_nonzero(sources > NO_LENS)
    return np.count_nonzero(sources == HOLE) / lensed if lensed else 0.0


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
    """One ray of every pixel: its start in the pixel, and the colour channels that it shows."""

    pixel_offset: PixelOffset
    channels: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class PanelRays:
    """Rays whose sources an algorithm finds: of every panel pixel, over pictures of one size.

    Attributes
    ----------
    display : Display
    shape : (rows, columns)
        Size of the pictures.
    pixel_mm : float
        Width of their pixels.
    offsets : tuple of PixelOffset
        Start of each ray in its pixel: one ray of every pixel for each offset.
    mask : (rows, columns) bool, optional
        Panel pixels whose sources are needed; those of the others may be anything.
    leave_holes : bool
        True if a fill follows: rays without a certain source are holes.
    """

    display: Display
    shape: PictureShape
    pixel_mm: float
    offsets: tuple[PixelOffset, ...]
    mask: np.ndarray | None = None
    leave_holes: bool = False

    @property
    def selected(self) -> np.ndarray:
        """Panel pixels under lenses, and in the mask, (rows, columns) bool."""
        lensed = self.display.lensed
        return lensed if self.mask is None else lensed & self.mask


#: Writes the sources of one ray, by its number, of a slice of panel rows into an array of these.
RaySearch = Callable[[int, slice, Sources], None]
#: Prepares a picture for all rays of `PanelRays`; the next picture takes its place.
SourceFinder = Callable[[RGBD], RaySearch]


def each_ray(rays: PanelRays, find: Callable[[RGBD, PixelOffset], Sources]) -> SourceFinder:
    """Finder of an algorithm that finds one ray of every pixel at a time.

    Parameters
    ----------
    rays : PanelRays
    find : function
        Sources, (rows, columns) int32, of a picture for one pixel offset. Panel pixels without a
        lens may have any.
    """

    def take(rgbd: RGBD) -> RaySearch:
        maps = [find(rgbd, offset) for offset in rays.offsets]
        for sources in maps:
            mark_unlensed(sources, rays.display)

        def search(ray: int, rows: slice, out: Sources) -> None:
            out[...] = maps[ray][rows]

        return search

    return take


def mark_unlensed(sources: Sources, display: Display) -> None:
    """Mark the panel pixels of a source map that have no lens."""
    if display.is_separable:  # whole rows and columns: faster than pixel by pixel
        sources[display.rows.lens < 0, :] = NO_LENS
        sources[:, display.columns.lens < 0] = NO_LENS
    else:
        sources[~display.lensed] = NO_LENS


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
    """

    #: For those by others that do without this class's `__init__`.
    mask: np.ndarray | None = None

    def __init__(
        self,
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        mask: np.ndarray | None = None,
    ) -> None:
        self.display = display
        self.shape = shape
        self.pixel_mm = pixel_mm
        self.mask = mask

    @abstractmethod
    def find(self, rgbd: RGBD) -> Sources:
        """Sources of all panel pixels; those outside the mask or lenses may hold anything."""

    def sources(self, rgbd: RGBD) -> Sources:
        """``row * W + column`` of each panel pixel's source, `HOLE`, `NO_LENS` or `MASKED`."""
        self.check(rgbd)
        sources = self.find(rgbd)
        self.mark(sources)
        return sources

    def mark(self, sources: Sources) -> None:
        """Mark the sources outside the mask, and where there is no lens."""
        if self.mask is not None:
            sources[~self.mask] = MASKED
        mark_unlensed(sources, self.display)

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`."""
        return colour_of(self.sources(rgbd), rgbd, self.place(rgbd, out))

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


def run_kernel(kernel: Any, turns: int, shape: tuple[int, int], *arguments: Any) -> Sources:
    """Fill a map of panel pixels, (rows, columns) int32, with a kernel, on several threads.

    The kernel is called with the first and the end of some turns of its outer loop, the arguments
    (numbers, arrays and named tuples of them), and the map as a flat array full of `HOLE`.
    """
    from inim.system.backend.kernels import share_rows

    filled = np.full(shape, HOLE, np.int32)
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
