"""What a validation will do, decided before anything heavy is loaded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from inim.display import Display
from inim.display.misalignment import mounted
from inim.display.viewpoint import Viewpoint, parse_viewpoints
from inim.documents.parts import Conditions, DisplayRecord
from inim.errors import OutOfMemoryError, SceneError, UsageError
from inim.generators import algorithm_items
from inim.lens import check_lens_model
from inim.metrics import SSIM_WINDOW, Viewing, all_metrics
from inim.pipeline.request import PREVIEW, Request, definition_words
from inim.pipeline.stages.method import Method, parse_methods
from inim.pipeline.stages.reconstruct import Optics
from inim.regression import BASELINE, RunStatistics, check_comparable, read_statistics
from inim.scene.file import SceneFile, choose_display, read_scene_file
from inim.settings import PREFIX, Settings

# Running out of memory is a native death, not an exception, so it is planned against: pictures have
# to fit whole, and what they leave decides how many rays the renderer traces at once. Fewer rays a
# pass cost time, not samples.
# The renderer, its kernels and a scene. 0.3 GiB are filled for the relics of `scenes/`; a limit on
# addresses (`ulimit -v`) counts what is reserved too, and other scenes have larger meshes.
_RENDERER_BYTES = 2 * 2**30
# What a pass yields and its random numbers: 14 to 20 bytes a ray, measured with the amphora and
# the goblet between passes of 2^16 and 2^22 rays (a path's own state stays in registers); thrice
# that for longer results and other integrators.
_RAY_BYTES = 60
# Larger passes gain nothing on two cores; below the smallest, starting them costs more than they
# trace.
_MOST_RAYS = 2**22
_FEWEST_RAYS = 2**16

#: What a run takes beside its pictures where memory is short.
LEAST_BYTES = _RENDERER_BYTES + _FEWEST_RAYS * _RAY_BYTES
# Bytes per pixel at the fullest moment. EIA: two float32 halves of the ground truth and their mean,
# a generator's EIA, its noise and its sources, the scorer's bands; half as much again as a whole
# validation of an 8K panel takes above its start (`tests/regression/test_8k.py`).
_EIA_BYTES = 150
# RGB-D: float64 rays and points of the depth pass, colour sums.
_CAPTURE_BYTES = 240
# All layers that there may be: hits on a ray, and for each layer a mean and two halves with copies.
_LAYERS_BYTES = 3200
# A view: float64 sums, rays of the coverage pass, the scorer's copies; and what each view keeps.
_VIEW_BYTES = 400
_KEPT_BYTES = 12


@dataclass(frozen=True)
class Plan:
    """A request checked against its scene file: what can go wrong without native code has not.

    Attributes
    ----------
    request : Request
    file : SceneFile
    settings : Settings
    display : Display
        As designed: what generators know.
    mounted : Display
        As its array really lies: what the viewer looks at, and the ground truth is made for.
    viewpoints : tuple of Viewpoint
    methods : tuple of Method
        Whose EIAs are scored, in the report's order.
    ssim_limits : dict of str to float
        Least SSIM to the reference, by method.
    pictures_bytes : int
        What the run's pictures take at their fullest moment.
    rays_in_flight : int
        That the memory beside them allows the renderer at once.
    baseline : RunStatistics, optional
        To compare with.
    """

    request: Request
    file: SceneFile
    settings: Settings
    display: Display
    mounted: Display
    viewpoints: tuple[Viewpoint, ...]
    methods: tuple[Method, ...]
    ssim_limits: dict[str, float]
    pictures_bytes: int
    rays_in_flight: int
    baseline: RunStatistics | None = None

    @property
    def definitions(self) -> dict[str, str]:
        """Settings and scene parameters that the request overrides, as text for the record."""
        return self.request.recorded_definitions(self.settings, self.file.settings)

    @property
    def command(self) -> list[str]:
        """The command line that repeats the run, after `python -m inim.validate`."""
        return self.request.command(self.settings, self.file.settings)

    @property
    def optics(self) -> Optics:
        """How views of EIAs are reconstructed."""
        s = self.settings
        return Optics(
            self.mounted, s.lens_model, s.view_pixels_per_lens, s.reconstruction_spp, s.seed
        )

    def viewing(self, eye: Viewpoint) -> Viewing:
        """How its view is seen, for metrics of perception."""
        return self.optics.viewing(eye, self.settings.luminance_cd_m2)

    @property
    def reads_layers(self) -> bool:
        """Whether a method is given what lies behind the front surface, too."""
        return any(method.reads_layers for method in self.methods)


def make_plan(request: Request) -> Plan:
    """Read the scene's settings and check them against each other.

    Raises
    ------
    InimError
        Of the kind that fits: every error here costs no rendering time.
    """
    if request.preview and request.baseline is not None:
        raise UsageError("--preview: has too few samples for --baseline; leave one of them out")
    definitions = {**PREVIEW, **request.definitions} if request.preview else request.definitions
    file = read_scene_file(request.scene, definitions, request.allow_folders)
    source = str(request.scene)
    display, settings = choose_display(request.display, definitions, source, file)
    settings = replace(settings, **request.overrides())
    real = mounted(display, settings.misalign if request.misalign is None else request.misalign)
    check_lens_model(settings.lens_model, real)
    all_metrics()  # of which another package's may not be loadable
    viewpoints = parse_viewpoints(
        request.viewpoints or settings.viewpoints,
        display,
        settings.viewing_distance_mm,
        settings.pupil_mm,
        settings.focus_mm,
    )
    methods = parse_methods(algorithm_items(settings.algorithms), request.eias)
    limits = settings.ssim_limits(tuple(m.name for m in methods), source)
    _check_sizes(display, settings, source)
    memory = _share_memory(display, settings, len(viewpoints), methods)
    for method in methods:
        method.check()
    plan = Plan(request, file, settings, display, real, viewpoints, methods, limits, *memory)
    if request.baseline is not None:
        plan = replace(plan, baseline=read_statistics(request.baseline, BASELINE))
        check_baseline(plan)
    return plan


def check_baseline(plan: Plan, variant: str | None = None) -> None:
    """Raise `BaselineError` where the plan's baseline was made under other conditions."""
    baseline, where = plan.baseline, plan.request.baseline
    if baseline is None:
        return
    # The variant is not known before a backend is chosen.
    conditions = conditions_of(plan, variant or baseline.conditions.variant)
    check_comparable(baseline, conditions, str(where))


def conditions_of(plan: Plan, variant: str | None = None) -> Conditions:
    """Conditions that two runs must share to be compared.

    Parameters
    ----------
    plan : Plan
    variant : str, optional
        Of the renderer.
    """
    s, request = plan.settings, plan.request
    perceptual = any(metric.viewed for metric in all_metrics())
    return Conditions(
        scene_sha256=plan.file.sha256,
        # `-D` of the scene's own; those of `inim` are compared by what they lead to.
        scene_parameters=sorted(
            text for text in definition_words(request.definitions) if not text.startswith(PREFIX)
        ),
        display=plan.display,
        derived=DisplayRecord.of(plan.display).derived,
        misalign=s.misalign,
        fit_share=s.fit_share,
        lens_model=s.lens_model,
        viewpoints={v.name: (*v.position_mm, v.pupil_mm, v.focus_mm) for v in plan.viewpoints},
        view_pixels_per_lens=s.view_pixels_per_lens,
        capture_pixels_per_pitch=s.capture_pixels_per_pitch,
        algorithms=sorted(method.name for method in plan.methods),
        panel_pixels="observed ones only" if request.lazy else None,
        luminance_cd_m2=s.luminance_cd_m2 if perceptual else None,
        variant=variant,
    )


def _check_sizes(display: Display, settings: Settings, source: str) -> None:
    """SSIM needs its window: pictures smaller than it cannot be scored."""
    per_lens = settings.view_pixels_per_lens
    for what, shape, key in (
        ("the EIA", display.eia_shape, "lens_columns, inim.lens_rows or the panel"),
        ("a view", _view_shape(display, per_lens), "view_pixels_per_lens"),
    ):
        if min(shape) < SSIM_WINDOW:
            raise SceneError(
                f"{source}: {what} has {shape[1]} x {shape[0]} pixels, fewer than SSIM's window of "
                f"{SSIM_WINDOW}; raise inim.{key}"
            )


def _view_shape(display: Display, pixels_per_lens: int) -> tuple[int, int]:
    return display.lens_rows * pixels_per_lens, display.lens_columns * pixels_per_lens


def _share_memory(
    display: Display, settings: Settings, views: int, methods: Sequence[Method]
) -> tuple[int, int]:
    """Bytes of pictures and rays in flight beside them; refuses pictures that leave no room."""
    from inim.backend import memory_limit_bytes

    layers = _LAYERS_BYTES if any(m.reads_layers for m in methods) else 0
    pictures = {
        "use a display with fewer pixels": (display.eia_shape, _EIA_BYTES),
        "lower inim.capture_pixels_per_pitch": (
            display.capture_shape(settings.capture_pixels_per_pitch),
            _CAPTURE_BYTES + layers,
        ),
        "lower inim.view_pixels_per_lens": (
            _view_shape(display, settings.view_pixels_per_lens),
            _VIEW_BYTES + views * (3 + len(methods)) * _KEPT_BYTES,
        ),
    }
    needs = {key: shape[0] * shape[1] * each for key, (shape, each) in pictures.items()}
    needed, limit = sum(needs.values()), memory_limit_bytes()
    rays = rays_in_flight(limit, needed)
    if not rays:
        way_out = max(needs, key=lambda name: needs[name])
        rows, columns = pictures[way_out][0]
        raise OutOfMemoryError(
            f"pictures of {columns} x {rows} pixels bring the run to about "
            f"{(LEAST_BYTES + needed) / 2**30:.1f} GiB of the {limit / 2**30:.1f} GiB there are; "
            f"{way_out}"
        )
    return needed, rays


def rays_in_flight(limit_bytes: int, pictures_bytes: int) -> int:
    """Rays that may be traced at once: a power of two, or 0 where not even the fewest fit.

    Parameters
    ----------
    limit_bytes : int
        The memory there is (`inim.backend.memory_limit_bytes`); 0: not known, and not limited.
    pictures_bytes : int
        What the run's pictures take at their fullest moment.
    """
    if not limit_bytes:
        return _MOST_RAYS
    affordable = (limit_bytes - pictures_bytes - _RENDERER_BYTES) // _RAY_BYTES
    if affordable < _FEWEST_RAYS:
        return 0
    return int(min(_MOST_RAYS, 2 ** (affordable.bit_length() - 1)))
