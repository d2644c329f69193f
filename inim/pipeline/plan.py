"""Plan of a validation, made before the renderer is loaded."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec

from inim.display import Display
from inim.display.lens import check_lens_model
from inim.display.misalignment import misaligned, misalignment_text, parse_misalignment
from inim.display.settings import Settings
from inim.display.viewpoint import Viewpoint, parse_viewpoints
from inim.generators import SCENE_ALGORITHMS, algorithm_items, split_algorithm
from inim.generators.registry import Input
from inim.image.noisy_image import split_samples
from inim.image.rgbd import RGBD
from inim.pipeline.request import PREVIEW, Request
from inim.pipeline.stages.capture import DepthCamera
from inim.pipeline.stages.method import GeneratorMethod, Method, OptimalMethod, parse_methods
from inim.pipeline.stages.picture import FittedPicture, PictureFile
from inim.pipeline.stages.reconstruction import Optics
from inim.pipeline.stages.scene import Renderer, Scene
from inim.pipeline.stages.stage import PROGRAM, deciding_inputs
from inim.render.scene_files.file import SceneFile, choose_display, read_scene_file
from inim.scores.document_parts import DisplayRecord, FileRecord, RunInputs
from inim.scores.metrics import SSIM_WINDOW, Viewing, all_metrics
from inim.scores.regression.run_statistics import BASELINE, RunStatistics, read_statistics
from inim.system.errors import OutOfMemoryError, SceneError, UsageError, naming
from inim.system.plugins import PluginModule, identity

# An out-of-memory failure is a native crash, not an exception, so memory is planned: all images
# must fit, and the rest limits the rays per pass. Fewer rays per pass cost time, not samples.
# Renderer, kernels and scene. The relics of `scenes/` use 0.3 GiB; a limit on addresses
# (`ulimit -v`) also counts reserved memory, and other scenes have larger meshes.
_RENDERER_BYTES = 2 * 2**30
# Results and random numbers of a pass: 14 to 20 bytes per ray, measured with the amphora and the
# goblet between passes of 2^16 and 2^22 rays (a path's state stays in registers); times three for
# longer results and other integrators.
_RAY_BYTES = 60
# Larger passes gain no speed on two cores; smaller ones take longer to start than to trace.
_MAX_RAYS = 2**22
_MIN_RAYS = 2**16

#: Suffix of RGB-D pictures; any other input is a scene.
PICTURE_SUFFIX = ".exr"
#: Least memory of a run in addition to its images.
LEAST_BYTES = _RENDERER_BYTES + _MIN_RAYS * _RAY_BYTES
# Bytes per pixel at peak. EIA: two float32 halves of the ground truth and their mean, a generator's
# EIA, its noise and its sources, the scorer's bands; 1.5 times the measured growth of a validation
# of an 8K panel (`tests/regression/test_8k.py`).
_EIA_BYTES = 150
# RGB-D: float64 rays and points of the depth pass, colour sums.
_CAPTURE_BYTES = 240
# Maximum number of layers: hits along a ray, and for each layer a mean and two halves with copies.
_LAYERS_BYTES = 3200
# Colours of eight layers in each part of the samples, and their copies.
_COPIES_OF_LAYERS = 16
# View: float64 sums, rays of the coverage pass, the scorer's copies.
_VIEW_BYTES = 400
# A colour.
_COLOUR_BYTES = 12
# Matrix of a view, per view pixel: six panel pixels of three colours, 8 bytes each.
_MATRIX_BYTES = 150
# Panel pixels that a view observes, per view pixel: 0.9 to 1.1 through thick lenses.
_OBSERVED_PIXELS = 1.2
# Per pixel of each view of the optimal EIA: its matrix, twice, and the images of the search.
_OPTIMAL_BYTES = 200

# Settings that decide nothing as text: a plan has their values.
_PARSED = ("title", "algorithms", "cameras", "viewpoints", "min_ssim_to_reference")


@dataclass(frozen=True)
class Plan:
    """A request with its scene's settings, after all checks that need no native code.

    `display` is the display as designed, which generators use; `misaligned_display` is for ground
    truth and views. `ssim_limits` are the smallest SSIM to the reference that pass, by method.
    `images_bytes` is the peak memory of the run's images, and `rays_in_flight` the number of rays
    that the renderer may trace at once in the remaining memory. `by_need` are the numbers of
    samples that scores or the baseline decide, by setting.
    """

    request: Request
    file: SceneFile | PictureFile
    settings: Settings
    display: Display
    misaligned_display: Display
    viewpoints: tuple[Viewpoint, ...]
    methods: tuple[Method, ...]
    ssim_limits: dict[str, float]
    images_bytes: int
    rays_in_flight: int
    baseline: RunStatistics | None = None
    plugins: tuple[PluginModule, ...] = ()
    by_need: tuple[str, ...] = ()

    @property
    def samples(self) -> dict[str, int]:
        """Samples per pixel by setting; the usual number of those `by_need`."""
        return {name: getattr(self.settings, name) for name in self.display.layout.usual_samples}

    @property
    def definitions(self) -> dict[str, str]:
        """Settings and scene parameters that the request overrides, as text."""
        return self.request.recorded_definitions(self.settings, self.file.settings)

    @property
    def command(self) -> list[str]:
        """Arguments of `python -m inim.validate` that repeat the run."""
        return self.request.command(self.settings, self.file.settings)

    @property
    def is_lazy(self) -> bool:
        """True if only panel pixels that some view depends on are computed.

        A preview of a lenticular is: its view depends on few of many pixels.
        """
        request = self.request
        return request.lazy or (request.preview and self.display.layout.of_cylinders)

    @property
    def is_reproducible(self) -> bool:
        """True if the command and `cache_key` determine the report, except its times.

        Times are measured again, and changes of finished EIAs, of other packages' algorithms and
        of baselines are not detected.
        """
        is_own = all(method.is_reproducible for method in self.methods)
        return is_own and self.baseline is None and not self.request.time

    def cache_key(self, renderer: Renderer | None = None) -> dict[str, Any]:
        """Return all values that decide the scores: no path, no title and no time.

        They are the declared inputs, samples, seed, criteria, the viewpoints' order, versions and
        code. Without a renderer, its backend is the requested one, on any machine.
        """
        return deciding_inputs(
            PROGRAM,
            scene=self.file.sha256,
            inputs=msgspec.structs.replace(inputs_of(self), files={}),
            parameters=self.file.parameters,
            settings={k: v for k, v in vars(self.settings).items() if k not in _PARSED},
            viewpoints=self.viewpoints,
            algorithms=[method.name for method in self.methods],
            algorithm_packages=self.algorithm_packages,
            ssim_limits=self.ssim_limits,
            is_timed=self.request.time,
            optics=self.optics,
            **{f"plugin {plugin.name}": plugin.sha256 for plugin in self.plugins},
            **({"backend": self.request.backend} if renderer is None else renderer.cache_key()),
        )

    @property
    def algorithm_packages(self) -> dict[str, dict[str, str]]:
        """Identities of the other packages that provide algorithms, by algorithm."""
        return {
            m.algorithm.name: identity("inim.generators", m.algorithm.name)
            for m in self.methods
            if isinstance(m, GeneratorMethod) and not m.algorithm.own
        }

    @property
    def scene_file(self) -> SceneFile:
        """The scene; raises `UsageError` for a picture."""
        if isinstance(self.file, PictureFile):
            raise UsageError(f"{self.request.scene}: is a picture; give a scene (.xml)")
        return self.file

    def source(self, renderer: Renderer) -> DepthCamera | FittedPicture:
        """Depth camera in front of the scene, or the picture without a scene."""
        if isinstance(self.file, PictureFile):
            return FittedPicture(self.file, self.display)
        return self.camera(renderer)

    def camera(self, renderer: Renderer) -> DepthCamera:
        """Depth camera in front of the scene, which the renderer opens on first use."""
        s = self.settings
        scene = Scene(self.scene_file, self.display, s.placement, renderer)
        rounds = (self.samples["capture_spp"],)
        return DepthCamera(scene, s.capture_pixels_per_pitch, rounds, s.seed)

    @property
    def optics(self) -> Optics:
        """Optics for reconstructed views."""
        s = self.settings
        display = self.misaligned_display
        return Optics(display, s.lens_model, s.view_pixels_per_lens, s.reconstruction_spp)

    def viewing_conditions(self, eye: Viewpoint) -> Viewing:
        """Viewing conditions of a viewpoint, for perceptual metrics."""
        return self.optics.viewing_conditions(eye, self.settings.luminance_cd_m2)

    @property
    def inputs(self) -> set[Input]:
        """Inputs of the methods."""
        return {method.input for method in self.methods}


def make_plan(request: Request, *, of_scene: bool = False) -> Plan:
    """Read the scene's settings, or a picture, and check the request; raises `InimError`.

    With `of_scene`, a picture is read as a scene, which fails.
    """
    if request.preview and request.baseline is not None:
        raise UsageError("--preview has too few samples for --baseline; remove one of them")
    definitions = {**PREVIEW, **request.definitions} if request.preview else request.definitions
    source = str(request.scene)
    file: SceneFile | PictureFile
    if not of_scene and request.scene.suffix.lower() == PICTURE_SUFFIX:
        file = PictureFile.read(request.scene)
        display, settings = choose_display(request.display, definitions, source)
        display = FittedPicture.of(file, display).display
    else:
        file = read_scene_file(request.scene, definitions, request.allow_folders)
        display, settings = choose_display(request.display, definitions, source, file)
    settings = replace(settings, **request.overrides())
    misalignment = parse_misalignment(
        settings.misalign if request.misalign is None else request.misalign
    )
    settings = replace(settings, misalign=misalignment_text(misalignment))
    misaligned_display = misaligned(display, misalignment)
    check_lens_model(settings.lens_model, misaligned_display)
    all_metrics()  # raises if another package's metric cannot be loaded
    with naming(source):
        viewpoints = parse_viewpoints(
            request.viewpoints or settings.viewpoints,
            display,
            settings.viewing_distance_mm,
            settings.pupil_mm,
            settings.focus_mm,
        )
    algorithms = request.algorithms or algorithm_items(settings.algorithms)
    if isinstance(file, PictureFile):
        FittedPicture(file, display).check(source)
        _check_without_scene(request, settings, algorithms)
    algorithms += tuple(f"cameras:views={views}" for views in algorithm_items(settings.cameras))
    shared_noise = algorithm_items(settings.shared_noise)
    methods = parse_methods(algorithms, request.eias, shared_noise)
    limits = settings.ssim_limits(tuple(m.name for m in methods), source)
    _check_sizes(display, settings, source)
    shape = display.capture_shape(settings.capture_pixels_per_pitch)
    if isinstance(file, PictureFile):
        shape = file.rgbd.shape
    usual = display.layout.usual_samples
    by_need = tuple(name for name in usual if getattr(settings, name) is None)
    settings = settings.with_samples(display)
    memory = _plan_memory(display, settings, shape, len(viewpoints), methods)
    for method in methods:
        method.check()
    plugins = tuple(map(PluginModule.of, request.plugins))
    plan = Plan(
        request,
        file,
        settings,
        display,
        misaligned_display,
        viewpoints,
        methods,
        limits,
        *memory,
        plugins=plugins,
        by_need=() if isinstance(file, PictureFile) else by_need,
    )
    return plan if request.baseline is None else _with_baseline(plan, request.baseline)


def _with_baseline(plan: Plan, path: Path) -> Plan:
    """Return the plan with its baseline, and as many samples as the baseline if scores decide.

    Raises `BaselineError` if the baseline is missing or damaged.
    """
    baseline = read_statistics(path, BASELINE)
    counts = {name: getattr(baseline.circumstances, name) for name in plan.by_need}
    settings = replace(plan.settings, **counts)
    return replace(plan, settings=settings, baseline=baseline)


def _check_without_scene(request: Request, settings: Settings, algorithms: Sequence[str]) -> None:
    """Raise `UsageError` for options and algorithms that need a scene."""
    for option, value in (
        ("--cameras", settings.cameras),
        ("--allow-folder", request.allow_folders),
        ("--plugin", request.plugins),
    ):
        if value:
            raise UsageError(f"{option}: needs a scene, not a picture; leave it out")
    for name in algorithms:
        if split_algorithm(name)[0] in SCENE_ALGORITHMS:
            raise UsageError(f"algorithm {name!r}: needs a scene, not a picture; leave it out")


def inputs_of(
    plan: Plan, variant: str | None = None, facts: Mapping[str, Mapping[str, str]] | None = None
) -> RunInputs:
    """Declared inputs of a run, for comparisons.

    `variant` is the renderer's; `facts` are those of `inim.render.scene_files.facts`.
    """
    s = plan.settings
    is_perceptual = any(metric.needs_viewing for metric in all_metrics())
    return RunInputs(
        elements=dict(plan.file.elements),
        files={
            sha256: FileRecord(name=name, **(facts or {}).get(sha256, {}))
            for sha256, name in plan.file.file_names.items()
        },
        display=plan.display,
        derived=DisplayRecord.of(plan.display).derived,
        misalign=s.misalign,
        fit_share=s.fit_share,
        turn_deg=s.turn_deg,
        relic=s.relic or None,
        lens_model=s.lens_model,
        viewpoints={v.name: (*v.position_mm, v.pupil_mm, v.focus_mm) for v in plan.viewpoints},
        view_pixels_per_lens=s.view_pixels_per_lens,
        capture_pixels_per_pitch=s.capture_pixels_per_pitch,
        algorithms=sorted(method.name for method in plan.methods),
        panel_pixels="observed ones only" if plan.is_lazy else None,
        luminance_cd_m2=s.luminance_cd_m2 if is_perceptual else None,
        variant=variant,
    )


def _check_sizes(display: Display, settings: Settings, source: str) -> None:
    """Raise `SceneError` if an image is smaller than the window of SSIM."""
    per_lens = settings.view_pixels_per_lens
    for name, shape, key in (
        ("the EIA", display.eia_shape, "lens_columns, inim.lens_rows or the panel"),
        ("a view", display.view_shape(per_lens), "view_pixels_per_lens"),
    ):
        if min(shape) < SSIM_WINDOW:
            raise SceneError(
                f"{source}: {name} has {shape[1]} x {shape[0]} pixels, fewer than SSIM's window of "
                f"{SSIM_WINDOW}; raise inim.{key}"
            )


def _plan_memory(
    display: Display,
    settings: Settings,
    capture_shape: tuple[int, int],
    views: int,
    methods: Sequence[Method],
) -> tuple[int, int]:
    """Bytes of all images and number of rays in flight; raises if the images are too large."""
    from inim.system.process.machine import memory_limit_bytes

    optimised = sum(views + m.zone**2 for m in methods if isinstance(m, OptimalMethod))
    counts = (getattr(settings, name) for name in display.layout.usual_samples)
    parts_bytes = max(split_samples(spp)[0] for spp in counts) * _COLOUR_BYTES
    # Ground truth, reference and the current method, each with image and noise.
    stored_views = 3 * (parts_bytes + 2 * _COLOUR_BYTES) + len(methods) * _COLOUR_BYTES
    # Replicates of two EIAs, and of one that is being computed.
    observed = 3 * _OBSERVED_PIXELS * parts_bytes
    layers = 0
    if any(m.input is not RGBD for m in methods):
        layers = _LAYERS_BYTES + _COPIES_OF_LAYERS * parts_bytes
    images = {
        "use a display with fewer pixels": (display.eia_shape, _EIA_BYTES),
        "lower inim.capture_pixels_per_pitch": (
            capture_shape,
            _CAPTURE_BYTES + parts_bytes + layers,
        ),
        "lower inim.view_pixels_per_lens": (
            display.view_shape(settings.view_pixels_per_lens),
            _VIEW_BYTES
            + views * (stored_views + observed + _MATRIX_BYTES)
            + optimised * _OPTIMAL_BYTES,
        ),
    }
    needs = {fix: int(shape[0] * shape[1] * size) for fix, (shape, size) in images.items()}
    total, limit = sum(needs.values()), memory_limit_bytes()
    rays = rays_in_flight(limit, total)
    if not rays:
        fix = max(needs, key=lambda name: needs[name])
        display_fix, _, views_fix = images
        if fix == views_fix and needs[fix] > limit * settings.view_pixels_per_lens**2:
            fix = display_fix  # one pixel per lens is too many
        rows, columns = images[fix][0]
        raise OutOfMemoryError(
            f"images of {columns} x {rows} pixels raise the run's memory to about "
            f"{(LEAST_BYTES + total) / 2**30:.1f} GiB, above the available "
            f"{limit / 2**30:.1f} GiB; {fix}"
        )
    return total, rays


def rays_in_flight(limit_bytes: int, images_bytes: int) -> int:
    """Number of rays to trace at once: a power of two, or 0 if memory is too small.

    The memory limit (`inim.system.process.machine.memory_limit_bytes`) is 0 if unknown, and then
    taken as unlimited.
    """
    if not limit_bytes:
        return _MAX_RAYS
    affordable = (limit_bytes - images_bytes - _RENDERER_BYTES) // _RAY_BYTES
    if affordable < _MIN_RAYS:
        return 0
    return int(min(_MAX_RAYS, 2 ** (affordable.bit_length() - 1)))
