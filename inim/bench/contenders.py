"""Contenders: an algorithm with its options, prepared to write a display-ready EIA into place."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from inim.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.display import Display
from inim.errors import UsageError
from inim.generators import (
    HOLE,
    NO_LENS,
    Generator,
    SourceGenerator,
    Sources,
    check_algorithm,
    prepare,
    properties,
)
from inim.generators.raycast.supersampling import Supersampled
from inim.rgbd import RGBD, LayeredRGBD

__all__ = [
    "DEFAULT",
    "Contender",
    "available",
    "chosen",
    "display_ready",
    "hole_share",
    "is_interpreted",
    "linear_picture",
    "prepared",
    "wrong_source_share",
]

#: What is measured where nothing is named: every algorithm, and the settings that cost time.
DEFAULT = (
    "template",
    "template:samples=2",
    "template:samples=4",
    "wang2024",
    "wang2024:matching=ray",
    "gu2020",
    "gu2020:step_mm=0.2",
    "li2012",
    "li2012:fill=nearest",
)
# What a name is tried on: as small as a display gets.
_TRIAL = Display(1.0, 3.0, 3.3, 0.25, 1, 1)


@dataclass(frozen=True)
class Contender:
    """A prepared algorithm with the picture it reads and the place it writes to.

    Attributes
    ----------
    name : str
        With its options, as on the command line.
    generator : Generator
    rgbd : RGBD
        Display-ready.
    out : (rows, columns, 4) uint8
        The EIA, after a run.
    prepare_s : float
        Seconds that preparing took, once per display and picture size.
    """

    name: str
    generator: Generator
    rgbd: RGBD
    out: np.ndarray
    prepare_s: float

    def run(self) -> None:
        """Generate once: what is timed."""
        self.generator.generate(self.rgbd, self.out)

    def sources(self) -> Sources | None:
        """Which pixels of the front the colours come from; None if that does not say it."""
        if isinstance(self.generator, SourceGenerator) and not isinstance(self.rgbd, LayeredRGBD):
            return self.generator.sources(self.rgbd)
        return None

    def averaged_share(self) -> float | None:
        """Share of the panel's pixels whose rays meet unlike things; None of those with one ray."""
        if not isinstance(self.generator, Supersampled):
            return None
        sources = self.generator.samples(self.rgbd)
        return float((sources != sources[0]).any(axis=0).mean())


def available(names: Iterable[str]) -> tuple[list[str], list[str]]:
    """Those of `names` that exist here, and a note on each that does not."""
    found, notes = [], []
    for name in names:
        try:
            prepare(_TRIAL, name, shape=(4, 4), pixel_mm=0.25)
        except (UsageError, ImportError) as error:
            notes.append(f"left out: {error}")
        else:
            found.append(name)
    return found, notes


def prepared(name: str, rgbd: RGBD, display: Display, mask: np.ndarray | None = None) -> Contender:
    """Prepare one algorithm for a display-ready picture.

    Parameters
    ----------
    name : str
        With its options.
    rgbd : RGBD
    display : Display
    mask : (rows, columns) bool, optional
        Panel pixels asked for; all if None.

    Raises
    ------
    UsageError
        Unknown algorithm or option.
    """
    start = time.perf_counter()
    made = prepare(display, name, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm, mask=mask)
    taken = time.perf_counter() - start
    out = np.zeros((*display.eia_shape, 4), np.uint8)  # written once: its pages are there
    return Contender(name, made, rgbd, out, taken)


def is_interpreted(name: str) -> bool:
    """Whether an algorithm runs in plain Python, as the paper's did: it compiles nothing."""
    return properties(name).interpreted


def display_ready(rgbd: RGBD) -> RGBD:
    """A linear picture as a player has it: 8-bit sRGB with alpha, clear where nothing is."""
    rgba = _rgba(rgbd.color, rgbd.covered)
    if not isinstance(rgbd, LayeredRGBD):
        return RGBD(rgba, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
    deeper = [replace(layer, color=_rgba(layer.color, layer.covered)) for layer in rgbd.deeper]
    return replace(rgbd, color=rgba, deeper=tuple(deeper))


def _rgba(color: np.ndarray, covered: np.ndarray) -> np.ndarray:
    rgba = np.zeros((*covered.shape, 4), np.uint8)
    rgba[..., :3] = srgb_to_uint8(srgb_from_linear(color))
    rgba[..., 3] = 255
    rgba[~covered] = 0
    return rgba


def linear_picture(rgba: np.ndarray) -> np.ndarray:
    """A display-ready EIA as a dark panel shows it: linear RGB, float32."""
    linear = linear_from_srgb(rgba[..., :3].astype(np.float32) / 255)
    return np.where(rgba[..., 3:] > 0, linear, np.float32(0))


def wrong_source_share(sources: Sources | None, exact: Sources) -> float | None:
    """Share of the lensed panel pixels that show another pixel of the picture than they should."""
    if sources is None:
        return None
    return _share(sources != exact, exact)


def hole_share(sources: Sources | None, out: np.ndarray, exact: Sources) -> float:
    """Share of the lensed panel pixels that show nothing."""
    return _share(out[..., 3] == 0 if sources is None else sources == HOLE, exact)


def _share(chosen_pixels: np.ndarray, exact: Sources) -> float:
    """Share of the lensed panel pixels."""
    lensed = exact != NO_LENS
    return int((chosen_pixels & lensed).sum()) / max(1, int(lensed.sum()))


def chosen(text: str | None) -> tuple[Sequence[str], list[str]]:
    """The algorithms of a ``--algorithms`` text, all of which must exist; else `DEFAULT`'s."""
    if text is None:
        return available(DEFAULT)
    names = list(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    if not names:
        raise UsageError("--algorithms: none given; name at least one, such as 'template'")
    for name in names:
        check_algorithm(name)
    return names, []
