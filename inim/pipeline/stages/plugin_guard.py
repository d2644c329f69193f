"""Generators by others: whatever they do, the user gets a picture that fits or one clear line."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from inim.display import Display
from inim.errors import UsageError
from inim.generators import (
    NO_LENS,
    Generator,
    SourceGenerator,
    colour_of,
    is_own,
    parse_algorithm,
)
from inim.image.rgbd import RGBD
from inim.plugins import blame


@contextmanager
def blamed(name: str, doing: str) -> Iterator[None]:
    """`inim.plugins.blame`, of another package's generator; errors of inim's own stay as they are.

    Raises
    ------
    UsageError
        In place of any exception but want of memory.
    """
    bare = parse_algorithm(name)[0]
    if is_own(bare):
        yield
        return
    with blame(f"algorithm {name!r}", doing, also=(f"algorithm {bare!r}",)):
        yield


def run_generator(
    name: str,
    generator: Generator,
    rgbd: RGBD,
    display: Display,
    mask: np.ndarray | None = None,
) -> tuple[np.ndarray, float, np.ndarray | None]:
    """Let a generator make its EIA, and check what it made.

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
        What it took.
    empty : (rows, columns) bool, or None
        Panel pixels that show nothing, of those in the mask; None where the generator does not say.

    Raises
    ------
    UsageError
        It raised, or made something that is no EIA for this display.
    """
    started = time.perf_counter()
    # Sources are found once, where the colours are no more than theirs.
    if mask is None and isinstance(generator, SourceGenerator) and generator.shows_sources(rgbd):
        sources = _sources(name, generator, rgbd, display)
        eia = colour_of(sources, rgbd)
        return eia, time.perf_counter() - started, sources < 0
    with blamed(name, "generate"):
        eia = generator.generate(rgbd)
    seconds = time.perf_counter() - started
    check_made(name, eia, (*display.eia_shape, 3), "float32")
    if not isinstance(generator, SourceGenerator):
        return eia, seconds, None
    empty = _sources(name, generator, rgbd, display, mask) < 0
    return eia, seconds, empty if mask is None else empty & mask


def _sources(
    name: str, generator: Any, rgbd: RGBD, display: Display, mask: np.ndarray | None = None
) -> np.ndarray:
    with blamed(name, "sources"):
        sources = generator.sources(rgbd)
    check_made(name, sources, display.eia_shape, "int32")
    colors, masked = rgbd.palette, sources if mask is None else sources[mask]
    low, high = (int(masked.min()), int(masked.max())) if masked.size else (NO_LENS, NO_LENS)
    pixels = colors.shape[0] * colors.shape[1]
    if low < NO_LENS or high >= pixels:
        raise UsageError(
            f"algorithm {name!r} names sources {low} to {high}; this picture has 0 to {pixels - 1},"
            f" and {NO_LENS} and -1 mean none"
        )
    return np.asarray(sources)


def check_made(name: str, made: Any, shape: tuple[int, ...], kind: str) -> None:
    """Raise `UsageError` unless what an algorithm made is an array of this shape and type."""
    if not isinstance(made, np.ndarray):
        raise UsageError(
            f"algorithm {name!r} made a {type(made).__name__}; it must be a {kind} array of shape "
            f"{shape}"
        )
    if made.shape != shape or made.dtype != kind:
        raise UsageError(
            f"algorithm {name!r} made {made.dtype} of shape {made.shape}; this display needs "
            f"{kind} of shape {shape}"
        )
