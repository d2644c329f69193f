"""Methods: whatever yields an EIA to be scored.

| made by            | what                                  | asked for with                 |
| ------------------ | ------------------------------------- | ------------------------------ |
| `generator_method` | a generator's, from the RGB-D picture | ``--algorithms template``      |
| `pickup_method`    | ray traced from the scene             | ``--algorithms pickup:spp=16`` |
| `file_method`      | a file's, made by any program         | ``--eia mine=mine.png``        |
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

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

#: In place of algorithms, where only finished EIAs are to be scored.
_NONE = "none"
# The ceiling's views lie beside the methods'.
_TAKEN = ("ceiling", _NONE)
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
    """Something that yields an EIA to be scored.

    Attributes
    ----------
    name : str
        In the report and its files: the algorithm as asked for, options and all.
    verb : str
        What its stage is called in front of its name.
    prepare : callable
        Gets ready before anything is rendered: mistakes found here cost no rendering time.
    reads_layers : bool
        Whether it is given what lies behind the front surface, too.
    spp : int, optional
        Samples per panel pixel that its making traces; 0: as many as the ground truth; None: none.
    times : bool
        Whether it is a generator, whose time can be taken.
    path : Path, optional
        Of its file.
    """

    name: str
    verb: str
    prepare: Callable[[Task, Run], Make]
    reads_layers: bool = False
    spp: int | None = None
    times: bool = False
    path: Path | None = None

    def check(self) -> None:
        """Raise an `InimError` for what can be found out without native code.

        Plans are made outside the worker too, where nothing survives a decoder's death.
        """
        if self.path is not None:
            check_eia_name(self.path)


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


def generator_method(name: str) -> Method:
    """A generator's EIA: the project's own or one announced by another package."""

    def prepare(task: Task, run: Run) -> Make:
        return prepare_generator(name, task.camera, task.mask, run=run)

    layers = properties(name).reads_layers
    return Method(name, "generate", prepare, reads_layers=layers, times=True)


def file_method(name: str, path: Path) -> Method:
    """A finished EIA from a file, which is read to its end before anything is rendered."""

    def prepare(task: Task, run: Run) -> Make:
        eia, shown = read_eia(path, task.camera.scene.display)
        empty = None if shown is None else ~shown
        holes = hole_fraction(empty, task.camera.scene.display, task.mask)
        return lambda _: GeneratedEIA(NoisyImage.from_image(eia), None, holes)

    return Method(name, "read", prepare, path=path)


def pickup_method(name: str, spp: int = 0) -> Method:
    """Ray tracing of the scene, for those who have the scene; the ground truth as an algorithm."""

    def prepare(task: Task, run: Run) -> Make:
        scene = task.camera.scene
        display, seed = scene.display.through_pinholes(), seed_of("pickup", task.camera.seed)

        def make(_: Capture) -> GeneratedEIA:
            wanted = spp or task.eia_spp
            eia, seconds = pick_up(
                scene, display, wanted, seed, task.mask, f"EIA of {name}", run=run
            )
            empty = ~covered_pixels(scene, run=run)
            holes = hole_fraction(empty, scene.display, task.mask)
            return GeneratedEIA(NoisyImage.from_image(eia.image, eia.noise), seconds, holes)

        return make

    return Method(name, "trace", prepare, spp=spp)


def parse_methods(algorithms: str, eias: tuple[str, ...]) -> tuple[Method, ...]:
    """Methods from the texts that ask for them.

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
    for method in found:
        if method.name.lower() in seen:  # case apart, two names may be one file
            what = "algorithm" if method.path is None else "EIA"
            raise UsageError(f"{what} {method.name!r} is given twice; drop one")
        seen.add(method.name.lower())
    return tuple(found)


def _parse_algorithm(text: str) -> Method:
    name, options = parse_algorithm(text)
    label = ":".join([name, *(f"{key}={value}" for key, value in options.items())])
    if name == PICKUP:
        return pickup_method(label, _pickup_samples(label, options))
    if name not in (names := algorithm_names()):
        raise UsageError(f"algorithm {name!r}: {known_words(name, [*names, PICKUP])}")
    check_algorithm(text)
    if not _LABEL.fullmatch(label):
        raise UsageError(
            f"algorithm {label!r} also names files of the report: use up to 100 letters, digits "
            "or . _ + - in names and values"
        )
    return generator_method(label)


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


def _parse_file(text: str) -> Method:
    name, equals, path = (part.strip() for part in text.partition("="))
    if not (name and equals and path):
        raise UsageError(f"--eia {text!r}: write --eia NAME=FILE")
    if not is_file_safe(name):
        raise UsageError(f"--eia name {name!r}: use 1 to 64 letters, digits or . _ + -")
    taken = (*_TAKEN, PICKUP, *algorithm_names())
    if name.lower() in (word.lower() for word in taken):
        raise UsageError(f"--eia name {name!r} is taken; rename it")
    return file_method(name, Path(path))


def algorithm_table() -> str:
    """All algorithms as text, one a line: how to write them with their options, and what they do.

    One that cannot be loaded has its error beside its name.
    """
    summary = (pickup_method.__doc__ or "").partition("\n")[0]
    rows = [(f"{PICKUP}:spp=EIA_SPP", summary)]
    for name in reversed(algorithm_names()):
        try:
            rows.append(algorithm_summary(name))
        except InimError as error:
            rows.append((name, " ".join(str(error).split())))
    width = max(len(written) for written, _ in rows)
    return "\n".join(f"{written:{width}}  {what}".rstrip() for written, what in reversed(rows))
