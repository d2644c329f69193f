"""Methods: sources of EIAs to score.

| type              | EIA                                     | option                         |
| ----------------- | --------------------------------------- | ------------------------------ |
| `GeneratorMethod` | from a generator and the RGB-D picture  | ``--algorithms template``      |
| `PickupMethod`    | ray traced from the scene               | ``--algorithms pickup:spp=16`` |
| `OptimalMethod`   | whose views come closest to the scene   | ``--algorithms optimal``       |
| `FileMethod`      | from a file of any program              | ``--eia mine=mine.png``        |
"""

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from inim.display.viewpoint import Viewpoint, is_file_safe, zone_eyes
from inim.generators import (
    OPTIMAL,
    PICKUP,
    SCENE_ALGORITHMS,
    Algorithm,
    CommonOptions,
    algorithm_names,
    algorithm_summary,
    find_algorithm,
    parse_algorithm,
    split_algorithm,
)
from inim.generators.options import Option, declared_options
from inim.generators.registry import Input
from inim.image.files.eia_file import check_eia_name, read_eia
from inim.image.noisy_image import NoisyEIA
from inim.image.rgbd import RGBD
from inim.pipeline.stages.capture import Capture, DepthCamera, PictureSource
from inim.pipeline.stages.generation import GeneratedEIA, hole_fraction, prepare_generator
from inim.pipeline.stages.ground_truth import SceneImages, covered_pixels, pick_up_eia
from inim.pipeline.stages.optimal import ScoredViews, optimise_eia
from inim.pipeline.stages.reconstruction import Optics
from inim.pipeline.stages.scene import seed_of
from inim.pipeline.stages.stage import Run
from inim.pipeline.timing import (
    REFERENCE_KERNEL,
    Rounds,
    TimedMethod,
    prepare_method,
    ratios,
    time_methods,
    to_srgb_rgba,
)
from inim.system.errors import InimError, UsageError, suggest_words

#: Replaces the algorithms if only finished EIAs are scored.
_NONE = "none"
# The reference views are stored next to the methods' views.
_RESERVED_NAMES = ("reference", _NONE)
# A method's name, with its options, is also part of file names.
_LABEL = re.compile(r"[\w+-][\w.+:=-]{0,99}")
# More samples per pixel are a typing error.
_MAX_SAMPLES = 2**20
# Rows and columns of further eyes of the optimal EIA; each view takes about half a second.
_MAX_ZONE = 32

#: A method ready to compute an EIA of the scene from its images.
PreparedMethod = Callable[[SceneImages], GeneratedEIA]


@dataclass(frozen=True)
class MethodSetup:
    """Inputs of a run's methods that exist before anything is rendered.

    `mask`, (rows, columns) bool, selects the panel pixels to generate, all if None. `observed` are
    those whose replicates are kept, none if None.
    """

    camera: PictureSource
    optics: Optics
    viewpoints: tuple[Viewpoint, ...]
    mask: np.ndarray | None = None
    observed: np.ndarray | None = None

    @property
    def depth_camera(self) -> DepthCamera:
        """The camera in front of the scene, for methods that need a scene."""
        assert isinstance(self.camera, DepthCamera)
        return self.camera


@dataclass(frozen=True)
class Method(ABC):
    """A source of an EIA to score; it can be pickled.

    `name` is the name in the report and its files: the algorithm with its options. `verb` is the
    first word of its stage's name. The run can time a method with `is_timed`: a generator.
    """

    name: str

    verb: ClassVar[str]
    is_timed: ClassVar[bool] = False

    @property
    def input(self) -> Input:
        """Its input from the scene."""
        return RGBD

    @property
    def is_reproducible(self) -> bool:
        """True if its name, the scene and this program determine its EIA."""
        return True

    @property
    def decides_samples(self) -> bool:
        """True if a run takes samples until the scores of this method are precise."""
        return False

    def check(self) -> None:  # noqa: B027 (most methods have none)
        """Raise an `InimError` for mistakes that can be detected without native code.

        Plans are also made outside the worker, where a crash of a decoder would end the program.
        """

    @abstractmethod
    def prepare(self, setup: MethodSetup, run: Run) -> PreparedMethod:
        """Prepare before anything is rendered, so that mistakes cost no rendering time."""


def prepare_methods(
    methods: Sequence[Method], setup: MethodSetup, *, run: Run
) -> list[PreparedMethod]:
    """Prepare every method, and raise before rendering if one of them cannot work."""
    prepared_methods = []
    for method in methods:
        with run.observer.timed(f"{method.verb} {method.name}"):
            prepared_methods.append(method.prepare(setup, run))
    return prepared_methods


def generate_eia(
    method: Method, prepared_method: PreparedMethod, images: SceneImages, *, run: Run
) -> GeneratedEIA:
    """Generate the EIA of a method; pixels that are not finite become black and fail a check."""
    with run.observer.timed(f"{method.verb} {method.name}"):
        output = prepared_method(images)
    return replace(output, eia=output.eia.replace_nonfinite())


@dataclass(frozen=True)
class GeneratorMethod(Method):
    """An EIA from a generator of this project or of another package."""

    algorithm: Algorithm
    verb = "generate"
    is_timed = True

    @property
    def input(self) -> Input:
        """See `Method`."""
        return self.algorithm.input

    @property
    def is_reproducible(self) -> bool:
        """See `Method`: changes of other packages' code are not detected."""
        return self.algorithm.own

    @property
    def decides_samples(self) -> bool:
        """See `Method`: another package's generator may take minutes, in every round."""
        return self.algorithm.own

    def prepare(self, setup: MethodSetup, run: Run) -> PreparedMethod:
        """See `Method`."""
        generate_from = prepare_generator(
            self.algorithm, setup.camera, setup.mask, setup.observed, run=run
        )
        return lambda images: generate_from(images.capture)


@dataclass(frozen=True)
class FileMethod(Method):
    """A finished EIA from a file, which is read completely before anything is rendered.

    Its noise is unknown, unless it was computed from the ground-truth EIA and `shares_noise`. A
    copy of the ground-truth EIA shares it in any case.
    """

    path: Path
    shares_noise: bool = False
    verb = "read"
    is_reproducible = False
    decides_samples = True

    def check(self) -> None:
        """See `Method`."""
        check_eia_name(self.path)

    def prepare(self, setup: MethodSetup, run: Run) -> PreparedMethod:  # noqa: ARG002
        """See `Method`."""
        display = setup.camera.display
        eia, nonempty = read_eia(self.path, display, only_finite=False)
        holes = hole_fraction(None if nonempty is None else ~nonempty, display, setup.mask)

        def read(images: SceneImages) -> GeneratedEIA:
            truth_eia = images.eia
            is_copy = np.array_equal(eia, truth_eia.image)
            if is_copy:
                remark = f"eia/{self.name}: is a copy of the ground-truth EIA, and shares its noise"
                return GeneratedEIA(truth_eia, None, holes, remark=remark)
            if not self.shares_noise:
                return GeneratedEIA(NoisyEIA((eia, None)), None, holes)
            replicates = truth_eia.observed
            if replicates is not None:
                replicates = replicates + (eia - truth_eia.image)[setup.observed]
            return GeneratedEIA(NoisyEIA((eia, truth_eia.noise), observed=replicates), None, holes)

        return read


@dataclass(frozen=True)
class PickupMethod(Method):
    """Ray tracing of the scene through every lens centre: the ground truth as an algorithm.

    `spp` are the samples per panel pixel; 0: as many as the ground truth.
    """

    spp: int = 0
    verb = "trace"

    def prepare(self, setup: MethodSetup, run: Run) -> PreparedMethod:
        """See `Method`."""
        scene, mask = setup.depth_camera.scene, setup.mask
        display = scene.display.through_pinholes()
        seed = seed_of("pickup", setup.depth_camera.seed)

        def generate(images: SceneImages) -> GeneratedEIA:
            rounds, name = (self.spp or images.spp("eia_spp"),), f"EIA of {self.name}"
            eia, seconds = pick_up_eia(
                scene, display, rounds, seed, mask, setup.observed, name, run=run
            )
            holes = hole_fraction(~covered_pixels(scene, run=run), scene.display, mask)
            return GeneratedEIA(eia, seconds, holes)

        return generate


@dataclass(frozen=True)
class OptimalMethod(Method):
    """EIA whose views come closest to the scene: the bound of all algorithms.

    With `zone`, views from so many rows and columns of further eyes, over the viewing zone at the
    distance of the first viewpoint, count as much as those of the run.
    """

    zone: int = 0

    verb = "optimise"

    def prepare(self, setup: MethodSetup, run: Run) -> PreparedMethod:
        """See `Method`."""
        first, display = setup.viewpoints[0], setup.camera.display
        further = [
            replace(first, name=eye.name, x_mm=eye.x_mm, y_mm=eye.y_mm)
            for eye in zone_eyes(display, self.zone, first.z_mm, rows=self.zone)
        ]
        views = ScoredViews(setup.optics, (*setup.viewpoints, *further))
        views.check()

        def optimise(images: SceneImages) -> GeneratedEIA:
            scene, spp = setup.depth_camera.scene, images.spp("view_spp")
            eia, seconds = optimise_eia(self.name, scene, views, spp, images.eia, run=run)
            return GeneratedEIA(eia, seconds, None)

        return optimise


def parse_methods(
    algorithms: Sequence[str], eias: Mapping[str, Path], shared_noise: Collection[str] = ()
) -> tuple[Method, ...]:
    """Parse the methods of a run: algorithms with options, and finished EIAs by name.

    The EIAs named in `shared_noise` have the noise of the ground-truth EIA.

    With finished EIAs, the only algorithm may be "none". Raises `UsageError` without a method, and
    for unknown or repeated methods and names that cannot be file names.
    """
    if [*algorithms] == [_NONE] and eias:
        algorithms = ()
    elif not algorithms or _NONE in algorithms:
        raise UsageError(
            "algorithms: none given; name at least one, such as 'template', or write 'none' and "
            "give a finished EIA with --eia NAME=FILE"
        )
    for name in shared_noise:
        if name not in eias:
            raise UsageError(f"inim.shared_noise: {name!r} is no EIA of --eia; name one, or none")
    methods = [_parse_algorithm(text) for text in algorithms]
    methods += [_file_method(name, path, name in shared_noise) for name, path in eias.items()]
    names: set[str] = set()
    for method in methods:
        if method.name.lower() in names:  # file names may ignore case
            kind = "EIA" if isinstance(method, FileMethod) else "algorithm"
            raise UsageError(f"{kind} {method.name!r} is given twice; remove one")
        names.add(method.name.lower())
    return tuple(methods)


def _parse_algorithm(text: str) -> Method:
    name, options = split_algorithm(text)
    label = ":".join([name, *(f"{key}={value}" for key, value in options.items())])
    if name == PICKUP:
        why = ", as it is split into two passes"
        return PickupMethod(label, _whole_number(label, options, "spp", 2, _MAX_SAMPLES, why))
    if name == OPTIMAL:
        return OptimalMethod(label, _whole_number(label, options, "zone", 0, _MAX_ZONE))
    if name not in (names := algorithm_names()):
        raise UsageError(f"algorithm {name!r}: {suggest_words(name, [*names, *SCENE_ALGORITHMS])}")
    algorithm = parse_algorithm(text)
    if not _LABEL.fullmatch(label):
        raise UsageError(
            f"algorithm {label!r}: cannot be part of file names; use up to 100 letters, digits or "
            ". _ + - in names and values"
        )
    return GeneratorMethod(label, algorithm)


def _whole_number(
    label: str, options: dict[str, str], option: str, low: int, high: int, why: str = ""
) -> int:
    """Value of an algorithm's only option, or 0 without it."""
    for key in options.keys() - {option}:
        raise UsageError(
            f"algorithm {label.partition(':')[0]!r} has no option {key!r}; its options are {option}"
        )
    if not options:
        return 0
    text = options[option]
    if not (text.isascii() and text.isdigit() and low <= int(text[:9]) <= high):
        raise UsageError(
            f"algorithm {label!r}: {option} must be a whole number in {low}..{high}{why}"
        )
    return int(text)


def parse_eias(items: Iterable[str]) -> dict[str, Path]:
    """Parse ``NAME=FILE`` items of finished EIAs into paths by name; raises `UsageError`."""
    eias: dict[str, Path] = {}
    for item in items:
        name, _, path = (part.strip() for part in item.partition("="))
        if not (name and path):
            raise UsageError(f"--eia {item!r}: write --eia NAME=FILE")
        if name in eias:
            raise UsageError(f"EIA {name!r} is given twice; remove one")
        eias[name] = Path(path)
    return eias


def _file_method(name: str, path: Path, shares_noise: bool) -> Method:
    if not is_file_safe(name):
        raise UsageError(f"--eia name {name!r}: use 1 to 64 letters, digits or . _ + -")
    reserved_names = (*_RESERVED_NAMES, *SCENE_ALGORITHMS, *algorithm_names())
    if name.lower() in (word.lower() for word in reserved_names):
        raise UsageError(f"--eia name {name!r} is reserved; choose another")
    return FileMethod(name, path, shares_noise)


def algorithm_table() -> str:
    """Format text tables: of all algorithms with their defaults, and of their options.

    An algorithm that cannot be loaded has its error as its summary.
    """
    rows = [
        (usage, (method.__doc__ or "").partition("\n")[0])
        for usage, method in (
            (f"{OPTIMAL}:zone=0", OptimalMethod),
            (f"{PICKUP}:spp=EIA_SPP", PickupMethod),
        )
    ]
    options: list[tuple[str, Iterable[Option]]] = [
        ("every algorithm with sources", declared_options(CommonOptions()))
    ]
    for name in reversed(algorithm_names()):
        try:
            rows.append(algorithm_summary(name))
            options.append((name, find_algorithm(name).own_options))
        except InimError as error:
            rows.append((name, " ".join(str(error).split())))
    meanings = [
        (f"{name}: {option.name}", option.meaning)
        for name, declared in options[:1] + options[:0:-1]
        for option in declared
        if option.meaning
    ]
    return "\n\n".join(map(_aligned, (rows[::-1], meanings)))


def _aligned(rows: Sequence[tuple[str, str]]) -> str:
    width = max(len(first) for first, _ in rows)
    return "\n".join(f"{first:{width}}  {text}".rstrip() for first, text in rows)


def prepare_timed_methods(names: Sequence[str], capture: Capture) -> tuple[list[TimedMethod], RGBD]:
    """Prepare generators for timing on the display-ready capture; also return its front surface."""
    ready = {kind: to_srgb_rgba(rgbd) for kind, (rgbd, _) in capture.inputs.items()}
    display = capture.camera.display
    timed_methods = [
        prepare_method(name, ready[parse_algorithm(name).input], display) for name in names
    ]
    return timed_methods, ready[RGBD]


def generator_times(methods: Sequence[Method], capture: Capture, *, run: Run) -> dict[str, float]:
    """Median time of each generator, as a multiple of the reference kernel's.

    The generators run on the display-ready picture.
    """
    names = [method.name for method in methods if method.is_timed]
    with run.observer.timed("time"):
        timed_methods, rgbd = prepare_timed_methods(names, capture)
        timings = time_methods(timed_methods, rgbd, capture.camera.display, Rounds())
    return {name: ratios(timings[name], timings[REFERENCE_KERNEL])["ratio"] for name in names}
