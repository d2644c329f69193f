"""Generators: from one RGB-D picture to an elemental image array.

A generator is one file with one function and one line in `GENERATORS`::

    sources(rgbd, display) -> (rows, columns) int32

For every panel pixel it names the picture's pixel whose colour is shown, as ``row * W + column``,
or `HOLE` where its ray meets nothing. Naming sources instead of colours keeps holes apart from
black, and lets algorithms be compared source by source.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from inim.display import Display
from inim.errors import UsageError
from inim.generators.sources import HOLE, NO_LENS, colour_of, hole_fraction
from inim.rgbd import RGBD

__all__ = [
    "GENERATORS",
    "HOLE",
    "NO_LENS",
    "check_algorithm",
    "colour_of",
    "find_sources",
    "generate",
    "hole_fraction",
]

Sources = NDArray[np.int32]


def _template(rgbd: RGBD, display: Display) -> Sources:
    from inim.generators.template import sources

    return sources(rgbd, display)


def _wang2024(rgbd: RGBD, display: Display) -> Sources:
    from inim.generators.wang2024 import sources

    return sources(rgbd, display)


# Loaded when used: numba takes half a second to import, and not every run needs it.
GENERATORS: dict[str, Callable[[RGBD, Display], Sources]] = {
    "template": _template,
    "wang2024": _wang2024,
}


def check_algorithm(name: str) -> None:
    """Raise `UsageError` unless a generator of that name exists."""
    if name not in GENERATORS:
        raise UsageError(f"algorithm {name!r}: use {' or '.join(sorted(GENERATORS))}")


def find_sources(rgbd: RGBD, display: Display, algorithm: str = "template") -> Sources:
    """Which pixel of the picture each panel pixel shows.

    Parameters
    ----------
    rgbd : RGBD
        Picture of H x W pixels in the display frame.
    display : Display
    algorithm : str
        A key of `GENERATORS`.

    Returns
    -------
    (rows, columns) int32
        ``row * W + column``, `HOLE` where the ray meets nothing, `NO_LENS` outside the array.

    Raises
    ------
    UsageError
        Unknown algorithm.
    """
    check_algorithm(algorithm)
    found = GENERATORS[algorithm](rgbd, display)
    found[display.rows.lens < 0, :] = NO_LENS
    found[:, display.columns.lens < 0] = NO_LENS
    return found


def generate(rgbd: RGBD, display: Display, algorithm: str = "template") -> NDArray[np.float32]:
    """The elemental image array of a picture.

    Parameters
    ----------
    rgbd : RGBD
        Colour and depth in the display frame.
    display : Display
    algorithm : {"template", "wang2024"}

    Returns
    -------
    (rows, columns, 3) float32, linear RGB; black at holes and outside the array. Use
    `find_sources` where black must be told from nothing.

    Raises
    ------
    UsageError
        Unknown algorithm.
    """
    return colour_of(find_sources(rgbd, display, algorithm), rgbd)
