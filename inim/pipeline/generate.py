"""A generator's EIA of the captured relic, its noise, and its mark on the reference input."""

from __future__ import annotations

import io
import time
from collections.abc import Callable
from contextlib import redirect_stderr
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from inim.display import Display
from inim.generators import Generator, prepare, properties
from inim.pipeline.capture import Capture, CaptureSettings
from inim.pipeline.plugin_guard import blamed, run_generator
from inim.pipeline.scene import Scene
from inim.pipeline.stage import GENERATING, Run, stage
from inim.regression import Fingerprint, fingerprint, reference_input
from inim.rgbd import RGBD

__all__ = ["GeneratedEIA", "Reference", "hole_fraction", "prepare_generator"]


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
    eia : (rows, columns, 3) float32
        Linear RGB; it may hold values that are not finite.
    noise : (rows, columns, 3) float32, or None
        Half of the difference of what two halves of the input's samples yield: the EIA is known
        to this. None: it has no noise.
    seconds : float or None
        What it took; None where nobody measured it.
    hole_fraction : float or None
        Share of the lensed panel pixels that show nothing; None where it cannot be told.
    reference : Reference, optional
        Where it is a generator's whole EIA.
    """

    eia: np.ndarray
    noise: np.ndarray | None
    seconds: float | None
    hole_fraction: float | None
    reference: Reference | None = None


class _Prepared:
    """A generator for a display and a size of picture, prepared when it is first needed."""

    def __init__(
        self, algorithm: str, display: Display, capture: CaptureSettings, mask: np.ndarray | None
    ) -> None:
        self.algorithm, self.display, self.mask = algorithm, display, mask
        self.shape = display.capture_shape(capture.capture_pixels_per_pitch)
        self.pixel_mm = display.pitch_mm / capture.capture_pixels_per_pitch
        self.seconds = 0.0

    @cached_property
    def generator(self) -> Generator:
        """The generator; `seconds` says how long preparing it took."""
        started = time.perf_counter()
        with blamed(self.algorithm, "prepare"):
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
        return made if properties(self.algorithm).own else (made[0].copy(), *made[1:])

    def again(self, rgbd: RGBD) -> np.ndarray:
        """The EIA of another picture; what the generator says, it has said."""
        with redirect_stderr(io.StringIO()):
            return self.run(rgbd)[0]

    def reference_input(self) -> RGBD:
        """The reference input of its size."""
        return reference_input(self.display, self.shape, self.pixel_mm)


def _generated(*_: Any, **__: Any) -> tuple[str, str, str]:
    return "generated", "nothing", "the algorithm or its picture is new"


@stage(
    "EIA of {algorithm}",
    code=GENERATING,
    makes=(GeneratedEIA,),
    describe=_generated,
    follows=("capture", "prepared"),
)
def generate(
    algorithm: str,
    scene: Scene,
    settings: CaptureSettings,
    display: Display,
    mask: np.ndarray | None,
    capture: Capture,
    prepared: _Prepared,
) -> GeneratedEIA:
    """The EIA that an algorithm makes of a scene's capture, and its noise.

    Parameters
    ----------
    algorithm : str
        With its options.
    scene, settings :
        What the capture is of.
    display : Display
        As designed: what generators know.
    mask : (rows, columns) bool, optional
        Panel pixels to make; all if None.
    capture : Capture
    prepared : _Prepared
    """
    whole, halves = capture.input(layers=properties(algorithm).reads_layers)
    eia, seconds, empty = prepared.run(whole)
    holes = hole_fraction(empty, display, mask)
    del empty
    noise, second = (prepared.again(rgbd) for rgbd in halves)
    # In place: of an 8K panel each of these takes 0.4 GB.
    noise -= second
    noise /= 2
    return GeneratedEIA(eia, noise, prepared.seconds + seconds, holes)


@stage(
    "EIA of {algorithm}, reference input",
    code=GENERATING,
    makes=(Fingerprint,),
    follows=("prepared",),
)
def _fingerprint(
    algorithm: str, display: Display, settings: CaptureSettings, prepared: _Prepared
) -> Fingerprint:
    rgbd = prepared.reference_input()
    exact = properties(algorithm).exact
    return fingerprint(rgbd, prepared.again(rgbd), display, exact=exact)


def prepare_generator(
    algorithm: str,
    scene: Scene,
    settings: CaptureSettings,
    mask: np.ndarray | None,
    *,
    run: Run,
) -> Callable[[Capture], GeneratedEIA]:
    """What makes the EIA of a capture; the generator is ready, or its EIA is in the cache.

    Of other packages' generators nothing tells what has changed: theirs are always made.
    """
    display, own = scene.display, properties(algorithm).own
    prepared = _Prepared(algorithm, display, settings, mask)
    if not (own and generate.is_known(algorithm, scene, settings, display, mask, run=run)):
        _ = prepared.generator

    def make(capture: Capture) -> GeneratedEIA:
        given = (algorithm, scene, settings, display, mask, capture, prepared)
        made = generate(*given, run=run) if own else generate.function(*given)
        if mask is not None:  # of an EIA that is made in part, no fingerprint could be compared
            return made
        printing = (algorithm, display, settings, prepared)
        reference = Reference(
            lambda: _fingerprint(*printing, run=run) if own else _fingerprint.function(*printing),
            lambda: prepared.again(prepared.reference_input()),
        )
        return GeneratedEIA(made.eia, made.noise, made.seconds, made.hole_fraction, reference)

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
