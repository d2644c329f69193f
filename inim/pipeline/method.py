"""Contenders: whatever yields an EIA to be scored.

| kind           | what                                        | asked for with                 |
| -------------- | ------------------------------------------- | ------------------------------ |
| `Generated`    | a generator's, from the RGB-D picture       | ``--algorithms template``      |
| `Pickup`       | ray traced from the scene, where one has it | ``--algorithms pickup:spp=16`` |
| `FinishedFile` | a file's, made by any program               | ``--eia mine=mine.png``        |
"""

from __future__ import annotations

import io
import re
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import redirect_stderr
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from inim.cache.store import Record
from inim.display import Display
from inim.display.viewpoint import is_file_safe
from inim.errors import InimError, UsageError
from inim.files.eia_file import check_eia_name, read_eia
from inim.generators import (
    PICKUP,
    Generator,
    algorithm_names,
    algorithm_summary,
    check_algorithm,
    is_own,
    parse_algorithm,
    prepare,
    properties,
)
from inim.pipeline.deciding import eia_parts, scene_parts
from inim.pipeline.plugin_guard import blamed, run_generator
from inim.regression import Fingerprint, fingerprint, reference_input
from inim.rgbd import RGBD

if TYPE_CHECKING:
    from inim.pipeline.ledger import Ledger
    from inim.pipeline.plan import Plan
    from inim.pipeline.truth import GroundTruth

__all__ = ["Contender", "Entry", "algorithm_table", "parse_contenders", "reads_layers"]

#: In place of algorithms, where only finished EIAs are to be scored.
_NONE = "none"
# The ceiling's views lie beside the contenders'.
_TAKEN = ("ceiling", _NONE)
# An algorithm's name with its options also names files.
_LABEL = re.compile(r"[\w+-][\w.+:=-]{0,99}")
# More samples than this per pixel is a slip of the keyboard.
_MOST_SAMPLES = 2**20


@dataclass(frozen=True)
class Fixed:
    """What a generator makes of `inim.regression.reference_eia`, made when it is asked for.

    Attributes
    ----------
    fingerprint : callable
        Its `Fingerprint`, found again where the store has it.
    eia : callable
        The EIA, (rows, columns, 3) float32.
    """

    fingerprint: Callable[[], Fingerprint]
    eia: Callable[[], np.ndarray]


@dataclass(frozen=True)
class Entry:
    """What a contender yields.

    Attributes
    ----------
    eia : (rows, columns, 3) float32
        Linear RGB; it may hold values that are not finite.
    seconds : float or None
        What it took; None where nobody measured it.
    hole_fraction : float or None
        Share of the lensed panel pixels that show nothing; None where it cannot be told.
    noise : (rows, columns, 3) float32, or None
        Half of the difference of what two halves of the input's samples yield: the EIA is known
        to this. None: it has no noise.
    fixed : Fixed, optional
        What it makes of the fixed picture, where it is a generator's whole EIA.
    """

    eia: np.ndarray
    seconds: float | None = None
    hole_fraction: float | None = None
    noise: np.ndarray | None = None
    fixed: Fixed | None = None


#: Makes the entry, once the ground truth is there.
Make = Callable[["Ledger", "GroundTruth"], Entry]


@dataclass(frozen=True)
class Contender(ABC):
    """Something that yields an EIA to be scored.

    Parameters
    ----------
    name : str
        In the report and its files: the algorithm as asked for, options and all.
    """

    name: str

    #: What its stage is called in front of its name.
    doing: ClassVar[str] = "generate"

    @property
    def wants_layers(self) -> bool:
        """Whether it is given what lies behind the front surface, too; capturing it takes time."""
        return False

    def check(self, display: Display) -> None:  # noqa: B027 (most have nothing to check)
        """Raise an `InimError` for what can be found out without native code.

        Plans are made outside the worker too, where nothing survives a decoder's death.
        """

    def rays(self, plan: Plan) -> int:  # noqa: ARG002
        """How many rays its making will trace."""
        return 0

    @abstractmethod
    def prepare(self, job: Ledger) -> Make:
        """Get ready before anything is rendered: mistakes found here cost no rendering time."""


@dataclass(frozen=True)
class Generated(Contender):
    """A generator's EIA: the project's own or one announced by another package."""

    @property
    def wants_layers(self) -> bool:
        """See `Contender`."""
        return reads_layers(self.name)

    @property
    def _is_own(self) -> bool:
        """Whether the project's code decides it: of others, nothing tells what has changed."""
        return is_own(parse_algorithm(self.name)[0])

    def prepare(self, job: Ledger) -> Make:
        """See `Contender`; nothing is loaded where the store has the EIA."""
        product = f"EIA of {self.name}"
        parts = eia_parts(job, self.name, "layers" if self.wants_layers else "capture")
        known = self._is_own and job.memo.knows(product, parts)
        generator = None if known else self._generator(job)

        def make(job: Ledger, truth: GroundTruth) -> Entry:
            def prepared() -> tuple[Generator, float]:
                nonlocal generator
                generator = generator or self._generator(job)
                return generator

            def once(product: str, anew: Callable[[], Record], told: Any = None) -> Record:
                return job.memo.recall(product, parts, anew, told=told) if self._is_own else anew()

            plan, exact = job.plan, properties(self.name).portable

            def fixed_eia(rgbd: RGBD | None = None) -> np.ndarray:
                return self._again(job, prepared()[0], rgbd or _reference_input(plan))

            def print_anew() -> Record:
                rgbd = _reference_input(plan)
                found = fingerprint(rgbd, fixed_eia(rgbd), plan.display, exact=exact)
                return Record({"sample": found.sample}, found.as_data())

            def fixed_print() -> Fingerprint:
                found = once(f"{product}, fixed picture", print_anew)
                return Fingerprint.of(found.facts | {"exact": exact}, found.arrays["sample"])

            record = once(product, lambda: self._made(job, truth, prepared()), _made)
            return Entry(
                record.arrays["eia"],
                record.facts["seconds"],
                record.facts["hole_fraction"],
                record.arrays["noise"],
                # Of an EIA that is made in part, no fingerprint could be compared.
                Fixed(fixed_print, fixed_eia) if job.observed is None else None,
            )

        return make

    def _generator(self, job: Ledger) -> tuple[Generator, float]:
        """The generator, prepared, and the seconds that took."""
        plan = job.plan
        shape, pixel_mm, mask = plan.capture_shape, plan.capture_pixel_mm, job.observed
        started = time.perf_counter()
        with blamed(self.name, "prepare"):
            made = prepare(plan.display, self.name, shape=shape, pixel_mm=pixel_mm, mask=mask)
        return made, time.perf_counter() - started

    def _made(self, job: Ledger, truth: GroundTruth, prepared: tuple[Generator, float]) -> Record:
        """The EIA and its noise; seconds and holes."""
        (generator, preparing), display, mask = prepared, job.plan.display, job.observed
        picture, halves = truth.input(layers=self.wants_layers)
        eia, seconds, empty = run_generator(self.name, generator, picture, display, mask)
        eia, holes = self._kept(eia), _hole_fraction(empty, display, mask)
        del empty
        noise, second = (self._again(job, generator, rgbd) for rgbd in halves)
        # In place: of an 8K panel each of these takes 0.4 GB.
        noise -= second
        noise /= 2
        facts = {"seconds": preparing + seconds, "hole_fraction": holes}
        return Record({"eia": eia, "noise": noise}, facts)

    def _again(self, job: Ledger, generator: Generator, rgbd: RGBD) -> np.ndarray:
        """The EIA of another picture."""
        with redirect_stderr(io.StringIO()):  # what it says, it has said
            made = run_generator(self.name, generator, rgbd, job.plan.display, job.observed)
        return self._kept(made[0])

    def _kept(self, eia: np.ndarray) -> np.ndarray:
        """Ours make a new one each time; others may keep one place to write to."""
        return eia if self._is_own else eia.copy()


def _reference_input(plan: Plan) -> RGBD:
    return reference_input(plan.display, plan.capture_shape, plan.capture_pixel_mm)


def _made() -> tuple[str, str, str]:
    return "generated", "nothing", "the algorithm or its picture is new"


@dataclass(frozen=True)
class FinishedFile(Contender):
    """A finished EIA from a file."""

    path: Path

    doing: ClassVar[str] = "read"

    def check(self, display: Display) -> None:  # noqa: ARG002
        """See `Contender`; the file is not opened yet."""
        check_eia_name(self.path)

    def prepare(self, job: Ledger) -> Make:
        """See `Contender`; the file is read to its end."""
        eia, shown = read_eia(self.path, job.plan.display)
        empty = None if shown is None else ~shown
        entry = Entry(eia, None, _hole_fraction(empty, job.plan.display, job.observed))

        def make(_: Ledger, __: GroundTruth) -> Entry:
            return entry

        return make


@dataclass(frozen=True)
class Pickup(Contender):
    """The ground truth as an algorithm: ray tracing of the scene, for those who have the scene.

    Parameters
    ----------
    spp : int, optional
        Samples per panel pixel; as `inim.eia_spp` otherwise.
    """

    spp: int | None = None

    doing: ClassVar[str] = "trace"

    def rays(self, plan: Plan) -> int:
        """See `Contender`."""
        rows, columns = plan.display.eia_shape
        return rows * columns * 2 * max(1, self._spp(plan) // 2)

    def _spp(self, plan: Plan) -> int:
        return self.spp or plan.settings.eia_spp

    def prepare(self, job: Ledger) -> Make:  # noqa: ARG002
        """See `Contender`."""

        def make(job: Ledger, _: GroundTruth) -> Entry:
            from inim.pipeline.truth import render_pickup

            plan, name = job.plan, f"EIA of {self.name}"
            eia, seconds = render_pickup(job, plan.display, self._spp(plan), PICKUP, name)
            holes = _hole_fraction(_misses(job), plan.display, job.observed)
            return Entry(eia.image, seconds, holes, eia.noise)

        return make


def _misses(job: Ledger) -> np.ndarray:
    """Panel pixels whose centre ray meets nothing of the scene, (rows, columns) bool."""
    display = job.plan.display

    def make() -> Record:
        fitted = job.fitted
        from inim.render.sensors import make_sensor, pickup_rays
        from inim.render.trace import surface

        rays = pickup_rays(display, fitted.start_mm)
        sensor = make_sensor(rays, fitted.fit.world_from_display)
        return Record({"covered": surface(fitted.scene, sensor, job.clock).covered})

    found = job.memo.recall("panel pixels that meet the scene", scene_parts(job, display), make)
    return ~found.arrays["covered"]


def _hole_fraction(
    empty: np.ndarray | None, display: Display, mask: np.ndarray | None
) -> float | None:
    """Share of the lensed pixels asked for that show nothing."""
    if empty is None:
        return None
    asked = display.lensed if mask is None else display.lensed & mask
    pixels = np.count_nonzero(asked)
    return np.count_nonzero(empty & asked) / pixels if pixels else 0.0


def reads_layers(algorithm: str) -> bool:
    """Whether an algorithm, options and all, makes use of `inim.rgbd.LayeredRGBD`."""
    return properties(algorithm).reads_layers


def parse_contenders(algorithms: str, eias: tuple[str, ...]) -> tuple[Contender, ...]:
    """Contenders from the texts that ask for them.

    Parameters
    ----------
    algorithms : str
        Names with options, separated by commas; or "none", where there is a finished EIA.
    eias : tuple of str
        Finished EIAs as ``NAME=FILE``.

    Raises
    ------
    UsageError
        None, an unknown or doubled one, or one whose name cannot be that of a file.
    """
    texts = [t.strip() for t in algorithms.split(",") if t.strip()]
    if texts == [_NONE] and eias:
        texts = []
    elif not texts or _NONE in texts:
        raise UsageError(
            "algorithms: none given; name at least one, such as 'template', or write 'none' and "
            "give a finished EIA with --eia NAME=FILE"
        )
    found = [*map(_parse_algorithm, texts), *map(_parse_file, eias)]
    seen: set[str] = set()
    for contender in found:
        if contender.name.lower() in seen:  # case apart, two names may be one file
            what = "EIA" if isinstance(contender, FinishedFile) else "algorithm"
            raise UsageError(f"{what} {contender.name!r} is given twice; drop one")
        seen.add(contender.name.lower())
    return tuple(found)


def _parse_algorithm(text: str) -> Contender:
    name, options = parse_algorithm(text)
    label = ":".join([name, *(f"{key}={value}" for key, value in options.items())])
    if name == PICKUP:
        return _parse_pickup(label, options)
    if name not in (names := algorithm_names()):
        raise UsageError(f"algorithm {name!r}: use {' or '.join([*names, PICKUP])}")
    check_algorithm(text)
    if not _LABEL.fullmatch(label):
        raise UsageError(
            f"algorithm {label!r} also names files of the report: use up to 100 letters, digits "
            "or . _ + - in names and values"
        )
    return Generated(label)


def _parse_pickup(label: str, options: dict[str, str]) -> Contender:
    for key in options.keys() - {"spp"}:
        raise UsageError(f"algorithm {PICKUP!r} has no option {key!r}; its options are spp")
    if not options:
        return Pickup(label)
    text = options["spp"]
    if not (text.isascii() and text.isdigit() and 2 <= int(text[:9]) <= _MOST_SAMPLES):
        raise UsageError(
            f"algorithm {label!r}: spp must be a whole number in 2..{_MOST_SAMPLES}, half of it "
            "for each of two passes"
        )
    return Pickup(label, int(text))


def _parse_file(text: str) -> Contender:
    name, equals, path = (part.strip() for part in text.partition("="))
    if not (name and equals and path):
        raise UsageError(f"--eia {text!r}: write --eia NAME=FILE")
    if not is_file_safe(name):
        raise UsageError(f"--eia name {name!r}: use 1 to 64 letters, digits or . _ + -")
    taken = (*_TAKEN, PICKUP, *algorithm_names())
    if name.lower() in (word.lower() for word in taken):
        raise UsageError(f"--eia name {name!r} is taken; rename it")
    return FinishedFile(name, Path(path))


def algorithm_table() -> str:
    """All algorithms as text, one a line: how to write them with their options, and what they do.

    One that cannot be loaded has its error beside its name.
    """
    rows = [(f"{PICKUP}:spp=EIA_SPP", (Pickup.__doc__ or "").partition("\n")[0])]
    for name in reversed(algorithm_names()):
        try:
            rows.append(algorithm_summary(name))
        except InimError as error:
            rows.append((name, " ".join(str(error).split())))
    width = max(len(written) for written, _ in rows)
    return "\n".join(f"{written:{width}}  {what}".rstrip() for written, what in reversed(rows))
