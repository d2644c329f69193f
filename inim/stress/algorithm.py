"""What the checks need of any algorithm, whoever wrote it: what it shows, and what it promises."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from inim.display import Display
from inim.generators import SourceGenerator, colour_of, prepare, properties
from inim.rgbd import RGBD
from inim.stress.pictures import solids_of

__all__ = ["Show", "colours_of", "eia_of", "input_of", "is_first_hit", "shown"]

# What panel pixels show of a picture, as `shown` says it: (rows, columns, 3).
Show = Callable[[RGBD, Display, str], np.ndarray]


def is_first_hit(algorithm: str) -> bool:
    """Whether an algorithm's definition is the first hit of each ray, so that one answer is right.

    It is then held to `inim.generators.oracle`, and to relations that follow from it alone.
    """
    return properties(algorithm).exact


def input_of(rgbd: RGBD, display: Display, algorithm: str) -> RGBD:
    """The picture itself, or one with layers made of it for an algorithm that reads them."""
    return solids_of(rgbd, display) if properties(algorithm).reads_layers else rgbd


def shown(rgbd: RGBD, display: Display, algorithm: str, **options: Any) -> np.ndarray:
    """What each panel pixel shows, to be compared with what it shows of another picture.

    Returns
    -------
    (rows, columns, 3) float
        The colours of its sources, which tell holes from black, where the algorithm names them;
        otherwise its EIA.
    """
    picture = input_of(rgbd, display, algorithm)
    made = prepare(display, algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm, **options)
    if isinstance(made, SourceGenerator):
        return colours_of(made.sources(picture), rgbd)
    return made.generate(picture)


def colours_of(sources: np.ndarray, rgbd: RGBD) -> np.ndarray:
    """Colours of sources: what two pictures with their pixels at other places share.

    Each layer has its own, and so have holes and pixels without a lens.
    """
    flat = rgbd.color.reshape(-1, 3)
    layer, cell = np.divmod(np.maximum(sources, 0), len(flat))
    found: np.ndarray = np.where(
        (sources >= 0)[..., None], flat[cell] + 2.0 * layer[..., None], sources[..., None] - 5.0
    )
    return found


def eia_of(rgbd: RGBD, display: Display, algorithm: str) -> tuple[np.ndarray, np.ndarray]:
    """What tells two answers apart, (rows, columns, n), and the linear EIA.

    Sources where the algorithm names them, with the EIA of their colours; otherwise its EIA twice.
    """
    made = prepare(display, algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm)
    if isinstance(made, SourceGenerator):
        sources = made.sources(rgbd)
        return sources[..., None], colour_of(sources, rgbd)
    eia = made.generate(rgbd)
    return eia, eia
