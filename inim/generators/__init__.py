"""Generators: from one RGB-D picture to an elemental image array.

An algorithm is one file in this folder, or a function registered by another package; see
`inim.generators.registry`. It finds the sources of rays; samples, colours, fill and mask are steps
of all algorithms (`inim.generators.steps`). The engine of exact first hits is
`inim.generators.raycast`.
"""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from inim.display import Display, Viewpoint
from inim.generators.base import (
    HOLE,
    MASKED,
    MOST_OUTSIDE,
    NO_LENS,
    Generator,
    PanelRays,
    PictureShape,
    RaySearch,
    SourceFinder,
    SourceGenerator,
    Sources,
    check_mask,
    colour_of,
    each_ray,
    hole_fraction,
    outside_depth_range,
    outside_depth_text,
)
from inim.generators.options import COLOURS, FILLS, CommonOptions, choice, option
from inim.generators.registry import (
    DEFAULT,
    OPTIMAL,
    PICKUP,
    SCENE_ALGORITHMS,
    Algorithm,
    algorithm,
    algorithm_items,
    algorithm_names,
    algorithm_summary,
    find_algorithm,
    is_own,
    parse_algorithm,
    split_algorithm,
)
from inim.image.rgbd import RGBD, CameraRGBDs
from inim.render.scene_files.file import display_of
from inim.system.errors import OutOfMemoryError, UsageError
from inim.system.process.machine import memory_limit_bytes

__all__ = [
    "COLOURS",
    "FILLS",
    "HOLE",
    "MASKED",
    "NO_LENS",
    "OPTIMAL",
    "PICKUP",
    "SCENE_ALGORITHMS",
    "Algorithm",
    "CommonOptions",
    "Generator",
    "PanelRays",
    "RaySearch",
    "SourceFinder",
    "SourceGenerator",
    "Sources",
    "algorithm",
    "algorithm_items",
    "algorithm_names",
    "algorithm_summary",
    "choice",
    "colour_of",
    "each_ray",
    "find_algorithm",
    "find_sources",
    "generate",
    "hole_fraction",
    "is_own",
    "merge_cameras",
    "merge_colourings",
    "option",
    "parse_algorithm",
    "prepare",
    "split_algorithm",
    "warp_to_viewpoint",
]


def prepare(
    display: Display | str | Path,
    algorithm: str | Algorithm = DEFAULT,
    *,
    shape: PictureShape,
    pixel_mm: float,
    mask: np.ndarray | None = None,
    **options: Any,
) -> Generator:
    """Prepare a generator for pictures of one size on one display, reusable for a stream of them.

    Parameters
    ----------
    display : Display, str or Path
        A display, the name of a preset, or a display file.
    algorithm : str or Algorithm
        One of `algorithm_names`, optionally with options: ``"template:samples=4"``.
    shape : (rows, columns)
        Size of the pictures.
    pixel_mm : float
        Width of their pixels.
    mask : (rows, columns) bool, optional
        Panel pixels to generate. They have the same bits as without a mask; the others are
        black, with alpha 0, and `MASKED` among sources.
    **options
        Options of the algorithm, see its module, and those of all algorithms (`CommonOptions`).

    Raises
    ------
    UsageError
        Unknown algorithm or option, an invalid value of an option, or a mask of another size than
        the panel.
    """
    from inim.generators.steps import make_generator

    display = display_of(display)
    chosen = parse_algorithm(algorithm, **options)
    if mask is not None:
        check_mask(mask, display)
    _check_size(display, shape, pixel_mm)
    return make_generator(chosen, display, (shape[0], shape[1]), float(pixel_mm), mask)


def _check_size(display: Display, shape: PictureShape, pixel_mm: float) -> None:
    """Raise `UsageError` for a picture in which, or of which, no lens shows anything.

    Raises `OutOfMemoryError`: the EIA does not fit into memory.
    """
    (rows, columns), limit = display.eia_shape, memory_limit_bytes()
    if limit and rows * columns * _EIA_BYTES > limit:
        raise OutOfMemoryError(
            f"display {display.name}: an EIA of {columns} x {rows} pixels needs more than the "
            f"{limit / 2**30:.1f} GiB of memory; check pitch_mm = {display.pitch_mm:g} and "
            f"pixel_pitch_mm = {display.pixel_pitch_mm:g}, or use fewer lenses"
        )
    array_mm = max(display.width_mm, display.height_mm)
    if not 0 < pixel_mm <= array_mm:
        raise UsageError(
            f"pixel_mm = {pixel_mm:g}: a pixel of the picture must be above 0 mm and not wider "
            f"than the lens array, {array_mm:.4g} mm; correct the picture's pixel size, or fit it "
            "to this display"
        )
    picture_mm = max(shape) * pixel_mm
    # Rays of neighbouring panel pixels are a panel pixel apart at the distance of the gap.
    nearest_mm = min(map(abs, display.depth_range_mm))
    if picture_mm < display.pixel_pitch_mm * min(nearest_mm / display.gap_mm, 1):
        raise UsageError(
            f"pixel_mm = {pixel_mm:g}: the whole picture is {picture_mm:.3g} mm wide, less "
            "than the rays of a lens are apart; correct its pixel size, or fit it to this display"
        )


# Linear RGB of a panel pixel, and its source.
_EIA_BYTES = 16


def _check_picture(rgbd: RGBD, display: Display) -> None:
    """Raise for an invalid picture or colours that are not finite; warn about depths in another
    unit.
    """
    if not isinstance(rgbd, RGBD):
        raise UsageError(
            f"rgbd: is a {type(rgbd).__name__}; give an inim.RGBD, such as "
            "RGBD(color, depth_mm, covered, pixel_mm)"
        )
    is_float = rgbd.color.dtype != np.uint8
    if is_float and (bad := np.count_nonzero(~np.isfinite(rgbd.palette).all(axis=-1))):
        raise UsageError(
            f"rgbd: {bad} pixels have colours that are not finite; mend them, such as with "
            "numpy.nan_to_num"
        )
    if outside_depth_range(rgbd, display) > MOST_OUTSIDE:
        warnings.warn(f"rgbd: {outside_depth_text(rgbd, display)}", stacklevel=3)


def find_sources(
    rgbd: RGBD, display: Display | str | Path, algorithm: str | Algorithm = DEFAULT, **options: Any
) -> Sources:
    """Find the picture pixel that each panel pixel shows at its centre.

    Parameters
    ----------
    rgbd : RGBD
        Picture of H x W pixels in the display frame.
    display : Display
    algorithm, **options :
        See `prepare`.

    Returns
    -------
    (rows, columns) int32
        ``row * W + column``, `HOLE` if the ray has no hit, `NO_LENS` outside the array, and
        `MASKED` outside a mask.

    Raises
    ------
    UsageError
        As for `prepare`; or the algorithm does not report its sources.
    """
    generator = prepare(display, algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm, **options)
    if not isinstance(generator, SourceGenerator):
        raise UsageError(
            f"algorithm {str(algorithm)!r} does not report its sources; use one that does, such as "
            f"{DEFAULT!r}"
        )
    return generator.sources(rgbd)


def generate(
    rgbd: RGBD | CameraRGBDs,
    display: Display | str | Path,
    algorithm: str | Algorithm = DEFAULT,
    *,
    out: np.ndarray | None = None,
    mask: np.ndarray | None = None,
    **options: Any,
) -> np.ndarray:
    """Generate the elemental image array of a picture, with the dtype of its colour.

    Parameters
    ----------
    rgbd : RGBD or CameraRGBDs
        Colour and depth in the display frame: float32 linear RGB (verification) or uint8 sRGB RGBA
        (display-ready). A warning appears if most of it is outside the depth range. Pictures of
        several cameras are merged first (`merge_cameras`); `cameras` and `layered` use all of
        their surfaces.
    display : Display, str or Path
        A display, the name of a preset, or a display file.
    algorithm : str or Algorithm
        One of `algorithm_names`, optionally with options: ``"template:samples=4"``.
    out : array, optional
        Array for the result.
    mask : (rows, columns) bool, optional
        Panel pixels to generate; see `inim.generators.prepare`.
    **options
        Options of the algorithm, such as ``samples=4``; see `inim.generators.prepare`.

    Returns
    -------
    (rows, columns, 3) float32 linear RGB, black at holes and outside the array; or
    (rows, columns, 4) uint8 sRGB, with alpha 0 there. Use `find_sources` to distinguish black from
    holes in linear RGB.

    Raises
    ------
    UsageError
        As for `prepare`; an invalid picture or colours that are not finite; or an `out`
        of another shape or dtype.
    """
    display = display_of(display)
    if isinstance(rgbd, CameraRGBDs):
        rgbd = merge_cameras(rgbd, display)
    _check_picture(rgbd, display)
    shape, pixel_mm = rgbd.shape, rgbd.pixel_mm
    generator = prepare(display, algorithm, shape=shape, pixel_mm=pixel_mm, mask=mask, **options)
    return generator.generate(rgbd, out)


def merge_cameras(
    pictures: CameraRGBDs, display: Display | str | Path, pixels_per_pitch: float = 5
) -> RGBD:
    """Merge the RGB-D pictures of several cameras into one layered depth image.

    Parameters
    ----------
    pictures : CameraRGBDs
    display : Display, str or Path
        A display, the name of a preset, or a display file.
    pixels_per_pitch : float
        Resolution of the result, in pixels per lens pitch.

    Returns
    -------
    LayeredRGBD
        Or RGBD, for a single picture.

    Raises
    ------
    FileError
        The pictures contradict each other, as with a wrong pose.
    """
    return merge_colourings([pictures], display, pixels_per_pitch)[0]


def merge_colourings(
    colourings: Sequence[CameraRGBDs], display: Display | str | Path, pixels_per_pitch: float
) -> list[RGBD]:
    """Merge versions of the same pictures, which differ in colour only; see `merge_cameras`."""
    from inim.generators.raycast.merge import merge

    display = display_of(display)
    pixel_mm = display.capture_pixel_mm(pixels_per_pitch)
    return merge(colourings, display, display.capture_shape(pixels_per_pitch), pixel_mm)


def warp_to_viewpoint(
    rgbd: RGBD, display: Display, eye: Viewpoint, pixels_per_lens: int
) -> tuple[np.ndarray, np.ndarray]:
    """Render a linear float32 picture from a viewpoint through the window of the lens array.

    Each ray shows the first of the picture's columns that it hits, with the thickness of the
    visible surface: the surface model of `template`, seen from another viewpoint, which is taken as
    a point.

    Returns
    -------
    view : (rows, columns, 3) float32
        Linear RGB, black where all rays miss.
    share : (rows, columns) float32
        Share of each pixel's rays that hit the picture.
    """
    from inim.generators.raycast.view import trace_view

    return trace_view(rgbd, display, eye, pixels_per_lens)
