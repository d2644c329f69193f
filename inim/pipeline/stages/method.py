"""Methods: whatever yields an EIA to be scored.

| type              | EIA                                       | option                         |
| ----------------- | ----------------------------------------- | ------------------------------ |
| `GeneratorMethod` | made by a generator from the RGB-D picture | ``--algorithms template``      |
| `PickupMethod`    | ray traced from the scene                 | ``--algorithms pickup:spp=16`` |
| `FileMethod`      | read from a file, made by any program     | ``--eia mine=mine.png``        |
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from inim.display.viewpoint import is_file_safe
from inim.errors import InimError, UsageError, known_words
from inim.files.eia_file import check_eia_name, read_eia
from inim.generators import (
    PICKUP,
    algorithm_names,
    algorithm_summary,
    check_algorithm,
    parse_algorithm,
    properties,
)
from inim.image.noisy_image import NoisyImage
from inim.pipeline.stages.capture import Capture, DepthCamera
from inim.pipeline.stages.generate import GeneratedEIA, hole_fraction, prepare_generator
from inim.pipeline.stages.ground_truth import covered_pixels, pick_up
from inim.pipeline.stages.scene import seed_of
from inim.pipeline.stages.stage import Run
from inim.regression import is_steady, log_ratios
from inim.timing import YARDSTICK, Rounds, display_ready, prepare_method, time_methods

#: In place of algorithms, where only finished EIAs are to be scored.
_NONE = "none"
# The reference views lie beside the methods'.
_TAKEN = ("reference", _NONE)
# A method's name, with its options, also names files.
_LABEL = re.compile(r"[\w+-][\w.+:=-]{0,99}")
# More samples than this per pixel is a slip of the keyboard.
_MOST_SAMPLES = 2**20

#: Makes the EIA of a captured relic.
Make = Callable[[Capture], GeneratedEIA]


@dataclass(frozen=True)
class Task:
    """What all methods of a run are given before anything is rendered.

    Attributes
    ----------
    camera : DepthCamera
    eia_spp : int
        Samples per panel pixel of the ground truth.
    mask : (rows, columns) bool, optional
        Panel pixels to make; all if None.
    """

    camera: DepthCamera
    eia_spp: int
    mask: np.ndarray | None = None


@dataclass(frozen=True)
class Method:
    """A source of an EIA to be scored; it can be pickled.

    Attributes
    ----------
    name : str
        In the report and its files: the algorithm as asked for, options and all.
    verb : str
        Name of its stage, in front of its own.
    times : bool
        Whether it is a generator, whose time can be taken.
    """

    name: str

    verb: ClassVar[str]
    times: ClassVar[bool] = False

    @property
    def reads_layers(self) -> bool:
        """Whether its input includes what lies behind the front surface."""
        return False

    def check(self) -> None:
        """Raise an `InimError` for what can be found out without native code.

        Plans are made outside the worker too, where nothing survives a decoder's death.
        """

    def prepare(self, task: Task, run: Run) -> Make:
        """Get ready before anything is rendered: mistakes found here cost no rendering time."""
        raise NotImplementedError


def prepare_methods(methods: Sequence[Method], task: Task, *, run: Run) -> list[Make]:
    """Get every method ready; those that cannot work are found out before rendering."""
    makers = []
    for method in methods:
        with run.observer.timed(f"{method.verb} {method.name}"):
            makers.append(method.prepare(task, run))
    return makers


def make_eia(method: Method, make: Make, capture: Capture, *, run: Run) -> GeneratedEIA:
    """The EIA of a method; black where it is not finite, which fails a check."""
    with run.observer.timed(f"{method.verb} {method.name}"):
        made = make(capture)
    return replace(made, eia=made.eia.replace_nonfinite())


class GeneratorMethod(Method):
    """A generator's EIA: the project's own or one announced by another package."""

    verb = "generate"
    times = True

    @property
    def reads_layers(self) -> bool:
        """See `Method`."""
        return properties(self.name).reads_layers

    def prepare(self, task: Task, run: Run) -> Make:
        """See `Method`."""
        return prepare_generator(self.name, task.camera, task.mask, run=run)


@dataclass(frozen=True)
class FileMethod(Method):
    """A finished EIA from a file, which is read to its end before anything is rendered.

    Attributes
    ----------
    path : Path
    """

    path: Path
    verb = "read"

    def check(self) -> None:
        """See `Method`."""
        check_eia_name(self.path)

    def prepare(self, task: Task, run: Run) -> Make:  # noqa: ARG002
        """See `Method`."""
        eia, shown = read_eia(self.path, task.camera.scene.display)
        empty = None if shown is None else ~shown
        holes = hole_fraction(empty, task.camera.scene.display, task.mask)
        return lambda _: GeneratedEIA(NoisyImage.from_image(eia), None, holes)


@dataclass(frozen=True)
class PickupMethod(Method):
    """Ray tracing of the scene, for those who have the scene; the ground truth as an algorithm.

    Attributes
    ----------
    spp : int
        Samples per panel pixel; 0: as many as the ground truth.
    """

    spp: int = 0
    verb = "trace"

    def prepare(self, task: Task, run: Run) -> Make:
        """See `Method`."""
        scene = task.camera.scene
        display, seed = scene.display.through_pinholes(), seed_of("pickup", task.camera.seed)

        def make(_: Capture) -> GeneratedEIA:
            wanted = self.spp or task.eia_spp
            eia, seconds = pick_up(
                scene, display, wanted, seed, task.mask, f"EIA of {self.name}", run=run
            )
            empty = ~covered_pixels(scene, run=run)
            holes = hole_fraction(empty, scene.display, task.mask)
            return GeneratedEIA(NoisyImage.from_image(eia.image, eia.noise), seconds, holes)

        return make


def parse_methods(algorithms: Sequence[str], eias: Mapping[str, Path]) -> tuple[Method, ...]:
    """Methods of a run.

    Parameters
    ----------
    algorithms : sequence of str
        Names with options; or "none", where there is a finished EIA.
    eias : mapping of str to Path
        Finished EIAs by name.

    Raises
    ------
    UsageError
        None, an unknown or doubled one, or one whose name cannot be that of a file.
    """
    if [*algorithms] == [_NONE] and eias:
        algorithms = ()
    elif not algorithms or _NONE in algorithms:
        raise UsageError(
            "algorithms: none given; name at least one, such as 'template', or write 'none' and "
            "give a finished EIA with --eia NAME=FILE"
        )
    methods = [*map(_parse_algorithm, algorithms), *map(_file_method, eias, eias.values())]
    names: set[str] = set()
    for method in methods:
        if method.name.lower() in names:  # case apart, two names may be one file
            what = "EIA" if isinstance(method, FileMethod) else "algorithm"
            raise UsageError(f"{what} {method.name!r} is given twice; drop one")
        names.add(method.name.lower())
    return tuple(methods)


def _parse_algorithm(text: str) -> Method:
    name, options = parse_algorithm(text)
    label = ":".join([name, *(f"{key}={value}" for key, value in options.items())])
    if name == PICKUP:
        return PickupMethod(label, _pickup_samples(label, options))
    if name not in (names := algorithm_names()):
        raise UsageError(f"algorithm {name!r}: {known_words(name, [*names, PICKUP])}")
    check_algorithm(text)
    if not _LABEL.fullmatch(label):
        raise UsageError(
            f"algorithm {label!r} also names files of the report: use up to 100 letters, digits "
            "or . _ + - in names and values"
        )
    return GeneratorMethod(label)


def _pickup_samples(label: str, options: dict[str, str]) -> int:
    for key in options.keys() - {"spp"}:
        raise UsageError(f"algorithm {PICKUP!r} has no option {key!r}; its options are spp")
    if not options:
        return 0
    text = options["spp"]
    if not (text.isascii() and text.isdigit() and 2 <= int(text[:9]) <= _MOST_SAMPLES):
        raise UsageError(
            f"algorithm {label!r}: spp must be a whole number in 2..{_MOST_SAMPLES}, half of it "
            "for each of two passes"
        )
    return int(text)


def parse_eias(items: Iterable[str]) -> dict[str, Path]:
    """Finished EIAs by name, from ``NAME=FILE`` each.

    Raises
    ------
    UsageError
        Without a name or a file, or with a name that another has.
    """
    eias: dict[str, Path] = {}
    for item in items:
        name, _, path = (part.strip() for part in item.partition("="))
        if not (name and path):
            raise UsageError(f"--eia {item!r}: write --eia NAME=FILE")
        if name in eias:
            raise UsageError(f"EIA {name!r} is given twice; drop one")
        eias[name] = Path(path)
    return eias


def _file_method(name: str, path: Path) -> Method:
    if not is_file_safe(name):
        raise UsageError(f"--eia name {name!r}: use 1 to 64 letters, digits or . _ + -")
    taken = (*_TAKEN, PICKUP, *algorithm_names())
    if name.lower() in (word.lower() for word in taken):
        raise UsageError(f"--eia name {name!r} is taken; rename it")
    return FileMethod(name, path)


def algorithm_table() -> str:
    """All algorithms as text, one a line: how to write them with their options, and what they do.

    One that cannot be loaded has its error beside its name.
    """
    summary = (PickupMethod.__doc__ or "").partition("\n")[0]
    rows = [(f"{PICKUP}:spp=EIA_SPP", summary)]
    for name in reversed(algorithm_names()):
        try:
            rows.append(algorithm_summary(name))
        except InimError as error:
            rows.append((name, " ".join(str(error).split())))
    width = max(len(written) for written, _ in rows)
    return "\n".join(f"{written:{width}}  {what}".rstrip() for written, what in reversed(rows))


# More than the nine that a verdict needs: at this many, one interrupted round in ten does not
# widen the interval to where 30 % more time could hide in it.
_ROUNDS = 31
# While other programs work beside this one, ratios scatter tenfold. So many times the rounds make
# up for twice the scatter that is allowed; what is not steady by then fails, and says so.
_MOST_TURNS = 5


def generator_times(
    methods: Sequence[Method], capture: Capture, *, run: Run
) -> dict[str, tuple[float, ...]]:
    """`inim.regression.log_ratios` of each generator, on the run's display-ready picture.

    Rounds are added until `inim.regression.is_steady` holds for all, or `_MOST_TURNS` are done.
    """
    wanted = [method for method in methods if method.times]
    times: dict[str, tuple[float, ...]] = {method.name: () for method in wanted}
    display = capture.camera.scene.display
    with run.observer.timed("time"):
        rgbd = display_ready(capture.rgbd)
        layered = rgbd if capture.layered is None else display_ready(capture.layered)
        prepared = [
            prepare_method(m.name, layered if m.reads_layers else rgbd, display) for m in wanted
        ]
        for _ in range(_MOST_TURNS):
            taken = time_methods(prepared, rgbd, display, Rounds(runs=_ROUNDS))
            kernel = taken[YARDSTICK].times_s
            times = {n: times[n] + log_ratios(taken[n].times_s, kernel) for n in times}
            if all(map(is_steady, times.values())):
                break
    return times
