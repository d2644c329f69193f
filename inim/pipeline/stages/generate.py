"""A generator's EIA of the captured relic, its noise, and its mark on the reference input."""

from __future__ import annotations

import io
import time
from collections.abc import Callable
from contextlib import redirect_stderr
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from inim.display import Display
from inim.generators import (
    Generator,
    SourceGenerator,
    colour_of,
    foreign_errors,
    prepare,
    properties,
)
from inim.generators.base import check_array
from inim.image.noisy_image import NoisyImage
from inim.image.rgbd import RGBD
from inim.pipeline.stages.capture import Capture, DepthCamera
from inim.pipeline.stages.stage import GENERATING, Run, stage
from inim.regression import Fingerprint, fingerprint, reference_input


@dataclass(frozen=True)
class Reference:
    """What a generator makes of the reference input, made when it is asked for.

    Attributes
    ----------
    fingerprint : callable
        Its `Fingerprint`, found in the cache where that has it.
    eia : callable
        The EIA, (rows, columns, 3) float32.
    """

    fingerprint: Callable[[], Fingerprint]
    eia: Callable[[], np.ndarray]


@dataclass(frozen=True)
class GeneratedEIA:
    """What a method yields.

    Attributes
    ----------
    eia : NoisyImage
        Its noise is half the difference of the EIAs of two halves of the input's samples. It may
        hold values that are not finite.
    seconds : float or None
        What it took; None where nobody measured it.
    hole_fraction : float or None
        Share of the lensed panel pixels that show nothing; None where it cannot be told.
    reference : Reference, optional
        Where it is a generator's whole EIA.
    """

    eia: NoisyImage
    seconds: float | None
    hole_fraction: float | None
    reference: Reference | None = None


class GeneratorHandle:
    """A generator for a display and a size of picture, prepared when it is first needed.

    Parameters
    ----------
    algorithm : str
        With its options.
    display : Display
        As designed: what generators know.
    shape : (rows, columns)
        Of the pictures to come.
    pixel_mm : float
    mask : (rows, columns) bool, optional
        Panel pixels to make; all if None.
    """

    def __init__(
        self,
        algorithm: str,
        display: Display,
        shape: tuple[int, int],
        pixel_mm: float,
        mask: np.ndarray | None = None,
    ) -> None:
        self.algorithm, self.display = algorithm, display
        self.shape, self.pixel_mm, self.mask = shape, pixel_mm, mask
        self.properties = properties(algorithm)
        self.seconds = 0.0

    def cache_key(self) -> dict[str, Any]:
        """What decides what it makes of a picture."""
        return {
            "algorithm": self.algorithm,
            "display as designed": self.display.replace(name=""),
            "size of the picture": [*self.shape, self.pixel_mm],
            "panel pixels": self.mask,
        }

    @cached_property
    def generator(self) -> Generator:
        """The generator; `seconds` says how long preparing it took."""
        started = time.perf_counter()
        with foreign_errors(self.algorithm):
            made = prepare(
                self.display,
                self.algorithm,
                shape=self.shape,
                pixel_mm=self.pixel_mm,
                mask=self.mask,
            )
        self.seconds = time.perf_counter() - started
        return made

    def run(self, rgbd: RGBD) -> tuple[np.ndarray, float, np.ndarray | None]:
        """See `run_generator`; the EIA is its own array."""
        made = run_generator(self.algorithm, self.generator, rgbd, self.display, self.mask)
        # Ours make a new one each time; others may keep one place to write to.
        return made if self.properties.own else (made[0].copy(), *made[1:])

    def again(self, rgbd: RGBD) -> np.ndarray:
        """The EIA of another picture; what the generator says, it has said."""
        with redirect_stderr(io.StringIO()):
            return self.run(rgbd)[0]

    def reference_input(self) -> RGBD:
        """The reference input of its size."""
        return reference_input(self.display, self.shape, self.pixel_mm)


@stage(
    "EIA of {generator.algorithm}",
    code=GENERATING,
    makes=(GeneratedEIA, NoisyImage),
    describe=("generated", "nothing", "the algorithm or its picture is new"),
)
def generate(generator: GeneratorHandle, capture: Capture) -> GeneratedEIA:
    """The EIA that a generator makes of a scene's capture, and its noise."""
    whole, halves = capture.input(layers=generator.properties.reads_layers)
    eia, seconds, empty = generator.run(whole)
    holes = hole_fraction(empty, generator.display, generator.mask)
    del empty
    noise, second = (generator.again(rgbd) for rgbd in halves)
    # In place: of an 8K panel each of these takes 0.4 GB.
    noise -= second
    noise /= 2
    return GeneratedEIA(NoisyImage.from_image(eia, noise), generator.seconds + seconds, holes)


@stage("EIA of {generator.algorithm}, reference input", code=GENERATING, makes=(Fingerprint,))
def _fingerprint(generator: GeneratorHandle) -> Fingerprint:
    """The mark of what a generator makes of the reference input."""
    rgbd, exact = generator.reference_input(), generator.properties.portable
    return fingerprint(rgbd, generator.again(rgbd), generator.display, exact=exact)


def prepare_generator(
    algorithm: str, camera: DepthCamera, mask: np.ndarray | None, *, run: Run
) -> Callable[[Capture], GeneratedEIA]:
    """What makes the EIA of a capture; the generator is ready, or its EIA is in the cache.

    Of other packages' generators nothing tells what has changed: theirs are always made.
    """
    display = camera.scene.display
    generator = GeneratorHandle(algorithm, display, camera.shape, camera.pixel_mm, mask)
    own = generator.properties.own
    known = own and generate.is_known(generator, camera, run=run)
    if not known:
        _ = generator.generator

    def fingerprint_once() -> Fingerprint:
        return _fingerprint(generator, run=run) if own else _fingerprint.function(generator)

    def make(capture: Capture) -> GeneratedEIA:
        made = (
            generate(generator, capture, run=run) if own else generate.function(generator, capture)
        )
        if mask is not None:  # of an EIA that is made in part, no fingerprint could be compared
            return made
        reference = Reference(
            fingerprint_once, lambda: generator.again(generator.reference_input())
        )
        return replace(made, reference=reference)

    return make


def hole_fraction(
    empty: np.ndarray | None, display: Display, mask: np.ndarray | None
) -> float | None:
    """Share of the lensed pixels asked for that show nothing; None where that is not known.

    Parameters
    ----------
    empty : (rows, columns) bool, or None
        Panel pixels that show nothing.
    display : Display
    mask : (rows, columns) bool, optional
        Pixels asked for; all if None.
    """
    if empty is None:
        return None
    lensed = display.lensed if mask is None else display.lensed & mask
    pixels = np.count_nonzero(lensed)
    return np.count_nonzero(empty & lensed) / pixels if pixels else 0.0


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
