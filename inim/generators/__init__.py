"""Generators: from one RGB-D picture to an elemental image array.

An algorithm is one file of this folder, or a function that another package announces; see
`inim.generators.registry`. What they have in common, rays through a picture's cells, is
`inim.generators.raycast`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from inim.display import Display
from inim.errors import UsageError
from inim.generators.base import (
    HOLE,
    MASKED,
    NO_LENS,
    Generator,
    PictureShape,
    SourceGenerator,
    Sources,
    check_mask,
    colour_of,
    hole_fraction,
    masked,
)
from inim.generators.registry import (
    DEFAULT,
    FILL,
    FILLS,
    MASK,
    PICKUP,
    Algorithm,
    AlgorithmProperties,
    algorithm,
    algorithm_items,
    algorithm_names,
    algorithm_summary,
    check_algorithm,
    find_algorithm,
    is_own,
    one_of,
    parse_algorithm,
    properties,
)
from inim.image.rgbd import RGBD

__all__ = [
    "FILLS",
    "HOLE",
    "MASKED",
    "NO_LENS",
    "PICKUP",
    "Algorithm",
    "AlgorithmProperties",
    "Generator",
    "SourceGenerator",
    "Sources",
    "algorithm",
    "algorithm_items",
    "algorithm_names",
    "algorithm_summary",
    "check_algorithm",
    "colour_of",
    "find_algorithm",
    "find_sources",
    "generate",
    "hole_fraction",
    "is_own",
    "parse_algorithm",
    "prepare",
    "properties",
]


def prepare(
    display: Display,
    algorithm: str = DEFAULT,
    *,
    shape: PictureShape,
    pixel_mm: float,
    mask: np.ndarray | None = None,
    **options: Any,
) -> Generator:
    """A generator ready for pictures of one size on one display; reusable for a stream of them.

    Parameters
    ----------
    display : Display
    algorithm : str
        One of `algorithm_names`, with options if need be: ``"template:samples=4"``.
    shape : (rows, columns)
        Of the pictures to come.
    pixel_mm : float
        Their pixel.
    mask : (rows, columns) bool, optional
        Panel pixels to make. They show what they would without it, bit for bit; the others are
        black, with alpha 0, and `MASKED` among sources. Algorithms that take a mask do the work of
        these pixels only (`properties`: ``takes_mask``); others are run in full.
    **options
        The algorithm's own, see its module; and for all that say where their colours come from
        ``fill``, "none", "hidden" or "all": what to show where a ray meets nothing, see
        `inim.generators.raycast.fill`. Their sources stay as they are without it.

    Raises
    ------
    UsageError
        Unknown algorithm or option, an option's value that makes no sense, or a mask that is not
        the panel's.
    """
    name, written = parse_algorithm(algorithm)
    found = find_algorithm(name)
    merged = {**written, **options}
    found.check_options(merged)
    fill = "none" if found.fills_itself else merged.pop(FILL, "none")
    filling = one_of(FILL, fill, FILLS) != "none"
    # What fills a hole may lie outside the mask.
    sparse = found.takes_mask and not filling
    if mask is not None:
        check_mask(mask, display)
        merged |= {MASK: mask} if sparse else {}

    def make(**more: Any) -> Generator:
        made = found.prepare(display, tuple(shape), float(pixel_mm), **merged, **more)
        if not isinstance(made, Generator):
            raise UsageError(
                f"algorithm {name!r} made a {type(made).__name__}, which cannot generate"
            )
        return made

    made = make()
    if filling:
        made = _filled(name, made, fill, make(leave_holes=True) if found.leaves_holes else made)
    return made if mask is None or sparse else masked(made, mask)


def _filled(name: str, made: Generator, fill: str, left: Generator) -> Generator:
    """A generator that fills the holes that another leaves."""
    from inim.generators.raycast.fill import Filled

    if not (isinstance(made, SourceGenerator) and isinstance(left, SourceGenerator)):
        raise UsageError(
            f"algorithm {name!r} does not say where its colours come from, and so not what is a "
            "hole; leave fill out"
        )
    return Filled(made, fill, left)


def find_sources(rgbd: RGBD, display: Display, algorithm: str = DEFAULT, **options: Any) -> Sources:
    """Which pixel of the picture each panel pixel shows at its centre.

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
        ``row * W + column``, `HOLE` where the ray meets nothing, `NO_LENS` outside the array, and
        `MASKED` outside a mask.

    Raises
    ------
    UsageError
        As `prepare`; or the algorithm does not say where its colours come from.
    """
    made = prepare(display, algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm, **options)
    if not isinstance(made, SourceGenerator):
        raise UsageError(f"algorithm {algorithm!r} does not say where its colours come from")
    return made.sources(rgbd)


def generate(
    rgbd: RGBD,
    display: Display,
    algorithm: str = DEFAULT,
    *,
    out: np.ndarray | None = None,
    **options: Any,
) -> np.ndarray:
    """The elemental image array of a picture, in its colour's type.

    Parameters
    ----------
    rgbd : RGBD
        Colour and depth in the display frame: float32 linear RGB (verification) or uint8 sRGB RGBA
        (display-ready).
    display : Display
    algorithm : str
        One of `algorithm_names`, with options if need be: ``"template:samples=4"``.
    out : array, optional
        Where to write the result.
    **options
        The algorithm's own, and ``fill``; see `prepare`.

    Returns
    -------
    (rows, columns, 3) float32 linear RGB, black at holes and outside the array; or
    (rows, columns, 4) uint8 sRGB, alpha 0 there. Use `find_sources` to distinguish black from
    nothing in linear RGB.

    Raises
    ------
    UsageError
        As `prepare`, or an `out` that does not fit.
    """
    made = prepare(display, algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm, **options)
    return made.generate(rgbd, out)
