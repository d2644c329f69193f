"""A generator's EIA of the captured relic, its noise, and its fingerprint."""

from __future__ import annotations

import io
import time
from collections.abc import Callable
from contextlib import redirect_stderr
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from inim.display import Display
from inim.generators import (
    Algorithm,
    Generator,
    Sources,
    colour_of,
    parse_algorithm,
    prepare,
)
from inim.generators.steps import RayGenerator, sample_points
from inim.image.noisy_image import REPLICATES, NoisyEIA, pseudo_values
from inim.image.rgbd import RGBD
from inim.pipeline.stages.capture import Capture, CapturedInput, PictureSource
from inim.pipeline.stages.stage import GENERATING, Run, stage
from inim.scores.regression.fingerprints import Fingerprint, fingerprint, reference_input


@dataclass(frozen=True)
class ReferenceOutput:
    """Output of a generator for the reference input.

    `eia` returns (rows, columns, 3) float32, computed on demand.
    """

    fingerprint: Fingerprint
    eia: Callable[[], np.ndarray]


@dataclass(frozen=True)
class GeneratedEIA:
    """Output of a method.

    The noise of the EIA is half the difference of the EIAs of the input's half images; its values
    may be not finite. `seconds` and `hole_fraction`, the share of the lensed panel pixels that are
    holes, are None if unknown. Only generators of whole EIAs have a reference output. `remark` is a
    warning for the report, and `terms` are those of `AlgorithmResult`.
    """

    eia: NoisyEIA
    seconds: float | None
    hole_fraction: float | None
    reference_output: ReferenceOutput | None = None
    remark: str = ""
    terms: str = ""


class GeneratorRun(NamedTuple):
    """Result of a generator."""

    eia: np.ndarray  #: (rows, columns, 3) float32, linear RGB; values may be not finite.
    seconds: float  #: Run time.
    holes: np.ndarray | None  #: (rows, columns) bool, within the mask; None: not reported.
    sources: Sources | None = None  #: Sources of generators that only copy colours.


class GeneratorHandle:
    """A generator for a display as designed and an input size, prepared on first use.

    `shape` and `pixel_mm` are those of the input; `mask`, (rows, columns) bool, selects the panel
    pixels to generate, all if None.
    """

    def __init__(
        self,
        algorithm: str | Algorithm,
        display: Display,
        shape: tuple[int, int],
        pixel_mm: float,
        mask: np.ndarray | None = None,
    ) -> None:
        self.algorithm, self.display = parse_algorithm(algorithm), display
        self.shape, self.pixel_mm, self.mask = shape, pixel_mm, mask

    def cache_key(self) -> dict[str, Any]:
        """Return all values that affect the generator's output for an input."""
        return {
            "algorithm": str(self.algorithm),
            "display as designed": self.display.replace(name=""),
            "size of the picture": [*self.shape, self.pixel_mm],
            "panel pixels": self.mask,
        }

    @cached_property
    def generator(self) -> Generator:
        """The generator."""
        return prepare(
            self.display,
            self.algorithm,
            shape=self.shape,
            pixel_mm=self.pixel_mm,
            mask=self.mask,
        )

    @property
    def terms(self) -> str:
        """Rays per panel pixel and their colour, in words."""
        if not (self.algorithm.finds_rays or isinstance(self.generator, RayGenerator)):
            return "rays not stated"
        common = self.algorithm.common
        rays = len(sample_points(self.display, common.samples))
        return f"{rays} ray{'s' * (rays > 1)}, {common.colour}"

    def masked(self, mask: np.ndarray) -> GeneratorHandle:
        """The same generator, restricted to some of its panel pixels."""
        return GeneratorHandle(self.algorithm, self.display, self.shape, self.pixel_mm, mask)

    def run(self, rgbd: RGBD, *, holes: bool = True) -> GeneratorRun:
        """Run the generator (`run_generator`)."""
        return run_generator(self.generator, rgbd, self.mask, holes)

    def rerun(self, rgbd: RGBD) -> GeneratorRun:
        """Run again, without the generator's messages."""
        with redirect_stderr(io.StringIO()):
            return self.run(rgbd)

    def reference_input(self) -> RGBD:
        """Reference input of this generator's size."""
        return reference_input(self.display, self.shape, self.pixel_mm)


@stage(
    "EIA of {generator.algorithm}",
    code=GENERATING,
    result_types=(GeneratedEIA, NoisyEIA),
    describe=("generated", "nothing", "the algorithm or its picture is new"),
)
def generate(
    generator: GeneratorHandle, capture: Capture, observed: np.ndarray | None
) -> GeneratedEIA:
    """Generate the EIA of a capture, its noise from the half images, and its replicates.

    `observed`, (rows, columns) bool, are the panel pixels with replicates.
    """
    rgbd, parts = picture = capture.inputs[generator.algorithm.input]
    eia, _, holes, sources = generator.run(rgbd)
    share = hole_fraction(holes, generator.display, generator.mask)
    del holes
    halves = picture.halves
    if parts is None or halves is None:
        return GeneratedEIA(NoisyEIA((eia, None)), generator.rerun(rgbd).seconds, share)
    first_run = None
    if sources is not None and not generator.algorithm.own:
        # Another package's sources may depend on the colours' noise, or on random numbers.
        first_run = generator.rerun(halves[0])
        if first_run.sources is None or not np.array_equal(sources, first_run.sources):
            sources = None
    replicates = _replicates(generator, picture, eia, sources, observed)
    if sources is not None:
        noise = colour_of(sources, halves[0])
        del sources
    else:
        noise = (first_run or generator.rerun(halves[0])).eia
    last_run = generator.rerun(halves[1])  # by now everything is prepared and compiled
    # In place: each of these takes 0.4 GB for an 8K panel.
    noise -= last_run.eia
    noise /= 2
    return GeneratedEIA(NoisyEIA((eia, noise), observed=replicates), last_run.seconds, share)


def _replicates(
    generator: GeneratorHandle,
    picture: CapturedInput,
    eia: np.ndarray,
    sources: Sources | None,
    observed: np.ndarray | None,
) -> np.ndarray | None:
    """Replicates of a picture's EIA at observed panel pixels; see `NoisyEIA`.

    Interpolated colours are not linear in the picture, so the EIAs of noisier parts would be darker
    than that of all. Replicates are therefore `pseudo_values` of the EIAs of all parts but one. Of
    copied colours, they are the EIAs of the parts. None for another package's generator without
    `sources`, whose EIA may depend on the noise in any way.
    """
    if observed is None or len(picture.parts or ()) < REPLICATES:
        return None
    if sources is not None:
        of_observed = sources[observed][None]
        return np.concatenate([colour_of(of_observed, part) for part in picture.parts or ()])
    if not generator.algorithm.own:
        return None
    masked = generator.masked(observed).generator
    without_each = (masked.generate(others)[observed] for others in picture.without_each())
    return pseudo_values(eia[observed], without_each)


@stage(
    "EIA of {generator.algorithm}, reference input", code=GENERATING, result_types=(Fingerprint,)
)
def _fingerprint(generator: GeneratorHandle) -> Fingerprint:
    """Fingerprint of a generator's output for the reference input."""
    rgbd, exact = generator.reference_input(), generator.algorithm.portable
    # Messages are silenced for the whole process, so not in a thread; our own have none.
    generate = generator.run if generator.algorithm.own else generator.rerun
    return fingerprint(rgbd, generate(rgbd).eia, generator.display, exact=exact)


def prepare_generator(
    algorithm: Algorithm,
    camera: PictureSource,
    mask: np.ndarray | None,
    observed: np.ndarray | None,
    *,
    run: Run,
) -> Callable[[Capture], GeneratedEIA]:
    """Return a function that generates the EIA of a capture; see `generate`.

    The generator is prepared unless its EIA is in the cache. EIAs of other packages' generators are
    never cached, because changes of their code cannot be detected.
    """
    display = camera.display
    generator = GeneratorHandle(algorithm, display, camera.shape, camera.pixel_mm, mask)
    is_own = algorithm.own
    if not (is_own and generate.is_cached(generator, camera, observed, run=run)):
        _ = generator.generator

    # A generator's first call compiles its kernels, while the scene is rendered. Another package's
    # generator may not be thread-safe.
    started = (
        run.ahead.submit(_fingerprint, generator, run=run) if is_own and mask is None else None
    )

    def generate_from(capture: Capture) -> GeneratedEIA:
        reference = None
        if mask is None:  # the fingerprint of a partial EIA is not comparable
            fingerprint = started.result() if started else _fingerprint.function(generator)
            reference = ReferenceOutput(
                fingerprint, lambda: generator.rerun(generator.reference_input()).eia
            )
        if is_own:
            output = generate(generator, capture, observed, run=run)
        else:
            output = generate.function(generator, capture, observed)
        return replace(output, reference_output=reference, terms=generator.terms)

    return generate_from


def hole_fraction(
    empty: np.ndarray | None, display: Display, mask: np.ndarray | None
) -> float | None:
    """Share of the lensed pixels in the mask that are holes; None if unknown.

    `empty` and `mask` are (rows, columns) bool; without a mask, all lensed pixels count.
    """
    if empty is None:
        return None
    lensed = display.lensed if mask is None else display.lensed & mask
    pixels = np.count_nonzero(lensed)
    return np.count_nonzero(empty & lensed) / pixels if pixels else 0.0


def run_generator(
    generator: Generator, rgbd: RGBD, mask: np.ndarray | None = None, holes: bool = True
) -> GeneratorRun:
    """Generate the EIA of a linear float32 picture; `mask` is that of the prepared generator.

    Finding the holes may take as long as a ray of every pixel; without `holes`, it is omitted.

    Raises `UsageError` if another package's generator fails, or if its result does not fit the
    display.
    """
    start = time.perf_counter()
    # The sources suffice if the colours are copied from them.
    source = generator if isinstance(generator, RayGenerator) else None
    if source is not None and mask is None and source.shows_sources(rgbd):
        sources = source.sources(rgbd)
        eia = colour_of(sources, rgbd)
        return GeneratorRun(eia, time.perf_counter() - start, sources < 0, sources)
    eia = generator.generate(rgbd)
    seconds = time.perf_counter() - start
    if source is None or not holes:
        return GeneratorRun(eia, seconds, None)
    empty = source.sources(rgbd) < 0
    return GeneratorRun(eia, seconds, empty if mask is None else empty & mask)
