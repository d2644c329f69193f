"""A generator's EIA of a picture, with its time and its empty pixels."""

from __future__ import annotations

import time

import numpy as np

from inim.display import Display
from inim.generators import Generator, SourceGenerator, colour_of, foreign_errors
from inim.generators.base import check_array
from inim.image.rgbd import RGBD


def run_generator(
    name: str,
    generator: Generator,
    rgbd: RGBD,
    display: Display,
    mask: np.ndarray | None = None,
) -> tuple[np.ndarray, float, np.ndarray | None]:
    """Generate an EIA.

    Parameters
    ----------
    name : str
        What to call it in an error.
    generator : Generator
    rgbd : RGBD
        In float32.
    display : Display
    mask : (rows, columns) bool, optional
        Panel pixels it was prepared for.

    Returns
    -------
    eia : (rows, columns, 3) float32
        Linear RGB; it may hold values that are not finite.
    seconds : float
        The time that took.
    empty : (rows, columns) bool, or None
        Panel pixels that show nothing, of those in the mask; None where the generator does not say.

    Raises
    ------
    UsageError
        Another package's generator failed, or its result does not fit the display.
    """
    started = time.perf_counter()
    with foreign_errors(name):
        # Sources are computed once, where the colours are no more than theirs.
        source = generator if isinstance(generator, SourceGenerator) else None
        if source is not None and mask is None and source.shows_sources(rgbd):
            sources = _sources(source, rgbd, display)
            eia = colour_of(sources, rgbd)
            return eia, time.perf_counter() - started, sources < 0
        eia = generator.generate(rgbd)
        seconds = time.perf_counter() - started
        check_array(eia, (*display.eia_shape, 3), "float32")
        if source is None:
            return eia, seconds, None
        empty = _sources(source, rgbd, display) < 0
        return eia, seconds, empty if mask is None else empty & mask


def _sources(generator: SourceGenerator, rgbd: RGBD, display: Display) -> np.ndarray:
    sources = generator.sources(rgbd)
    check_array(sources, display.eia_shape, "int32")
    return sources
