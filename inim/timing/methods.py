"""Generators and the reference kernel timed in turn on a display-ready picture."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from inim.display import Display
from inim.generators import (
    Generator,
    foreign_errors,
    is_own,
    parse_algorithm,
    prepare,
)
from inim.generators.base import check_array
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.image.rgbd import RGBD, LayeredRGBD
from inim.timing.turns import Rounds, Timing, in_turn, threads

#: The reference kernel's name among the timings.
YARDSTICK = "yardstick"


@dataclass(frozen=True)
class TimedMethod:
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
    is_own : bool
        Whether the generator is the project's, not another package's.
    """

    name: str
    generator: Generator
    rgbd: RGBD
    out: np.ndarray
    prepare_s: float
    is_own: bool = True

    def run(self) -> None:
        """Generate once: what is timed.

        Raises
        ------
        UsageError
            In place of anything that another package's generator raises.
        """
        if self.is_own:
            self.generator.generate(self.rgbd, self.out)
            return
        with foreign_errors(self.name):
            eia = self.generator.generate(self.rgbd, self.out)
            if eia is not self.out:  # it wrote elsewhere: the EIA still has to get to its place
                check_array(eia, self.out.shape, str(self.out.dtype))
                self.out[...] = eia


def prepare_method(
    name: str, rgbd: RGBD, display: Display, mask: np.ndarray | None = None
) -> TimedMethod:
    """Prepare one algorithm for a display-ready picture.

    Parameters
    ----------
    name : str
        With its options.
    rgbd : RGBD
    display : Display
    mask : (rows, columns) bool, optional
        Panel pixels to make; all if None.

    Raises
    ------
    UsageError
        Unknown algorithm or option.
    """
    start = time.perf_counter()
    with foreign_errors(name):
        made = prepare(display, name, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm, mask=mask)
    taken = time.perf_counter() - start
    out = np.zeros((*display.eia_shape, 4), np.uint8)  # written once: its pages are there
    return TimedMethod(name, made, rgbd, out, taken, is_own(parse_algorithm(name)[0]))


def time_methods(
    methods: Sequence[TimedMethod], rgbd: RGBD, display: Display, rounds: Rounds
) -> dict[str, Timing]:
    """Times of all methods and of the reference kernel (`YARDSTICK`), by name, taken in turn.

    Parameters
    ----------
    methods : sequence of TimedMethod
    rgbd : RGBD
        Display-ready: what the reference kernel gathers from.
    display : Display
    rounds : Rounds
    """
    from inim.render.reference_kernel import ReferenceKernel

    calls = {YARDSTICK: ReferenceKernel(rgbd.color, display, rgbd.pixel_mm).run}
    calls |= {method.name: method.run for method in methods}
    with threads(rounds.threads):
        return in_turn(calls, rounds)


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
