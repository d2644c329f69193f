"""What a validation will do, decided before anything heavy is loaded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from inim.display import Display
from inim.display.misalignment import mounted
from inim.display.viewpoint import Viewpoint, parse_viewpoints
from inim.errors import OutOfMemoryError, SceneError
from inim.lens import check_lens_model
from inim.metrics import SSIM_WINDOW
from inim.pipeline.memory import LEAST_BYTES, rays_in_flight
from inim.pipeline.method import Contender, parse_contenders
from inim.pipeline.request import SHORTHANDS, Request
from inim.regression import Evidence
from inim.scene.file import SceneFile, parse_definitions, read_scene_file
from inim.settings import Settings

__all__ = ["Plan", "make_plan"]

# Bytes per pixel at the fullest moment. EIA: two float32 halves of the ground truth and their mean,
# a generator's EIA, its noise and its sources, the scorer's bands; half as much again as a whole
# validation of an 8K panel takes above its start (`tests/regression/test_8k.py`).
_EIA_BYTES = 150
# RGB-D: float64 rays and points of the depth pass, colour sums.
_CAPTURE_BYTES = 240
# All layers that there may be: hits on a ray, and for each layer a mean and two halves with copies.
_LAYERS_BYTES = 1600
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
    contenders : tuple of Contender
        Whose EIAs are scored, in the report's order.
    ssim_limits : dict of str to float
        Least SSIM to the ceiling, by contender.
    pictures_bytes : int
        What the run's pictures take at their fullest moment.
    rays_in_flight : int
        That the memory beside them allows the renderer at once.
    baseline : Evidence, optional
        To compare with.
    """

    request: Request
    file: SceneFile
    settings: Settings
    display: Display
    mounted: Display
    viewpoints: tuple[Viewpoint, ...]
    contenders: tuple[Contender, ...]
    ssim_limits: dict[str, float]
    pictures_bytes: int
    rays_in_flight: int
    baseline: Evidence | None = None

    @property
    def capture_shape(self) -> tuple[int, int]:
        """Rows and columns of the RGB-D picture."""
        return self.display.capture_shape(self.settings.capture_pixels_per_pitch)

    @property
    def capture_pixel_mm(self) -> float:
        """Side of its pixels [mm]."""
        return self.display.pitch_mm / self.settings.capture_pixels_per_pitch


def make_plan(request: Request) -> Plan:
    """Read the scene's settings and check them against each other.

    Raises
    ------
    InimError
        Of the kind that fits: every error here costs no rendering time.
    """
    file = read_scene_file(request.scene, parse_definitions(list(request.definitions)))
    source = str(request.scene)
    settings = Settings.parse(file.settings, source)
    for name in SHORTHANDS:
        if getattr(request, name) is not None:
            settings = replace(settings, **{name: getattr(request, name)})
    display = settings.make_display(source)
    real = mounted(display, settings.misalign)
    check_lens_model(settings.lens_model, real)
    viewpoints = parse_viewpoints(
        settings.viewpoints,
        display,
        settings.viewing_distance_mm,
        settings.pupil_mm,
        settings.focus_mm,
    )
    contenders = parse_contenders(settings.algorithms, request.eias)
    limits = settings.ssim_limits(tuple(c.name for c in contenders), source)
    _check_sizes(display, settings, source)
    memory = _share_memory(display, settings, len(viewpoints), contenders)
    for contender in contenders:
        contender.check(display)
    plan = Plan(request, file, settings, display, real, viewpoints, contenders, limits, *memory)
    return plan if request.baseline is None else _with_baseline(plan, request.baseline)


def _with_baseline(plan: Plan, folder: Path) -> Plan:
    """The plan with its baseline, once it is sure that they can be compared."""
    from inim.pipeline.baseline import check_conditions, load_baseline

    plan = replace(plan, baseline=load_baseline(folder))
    check_conditions(plan)
    return plan


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
    display: Display, settings: Settings, views: int, contenders: Sequence[Contender]
) -> tuple[int, int]:
    """Bytes of pictures and rays in flight beside them; refuses pictures that leave no room."""
    from inim.backend import memory_limit_bytes

    layers = _LAYERS_BYTES if any(c.wants_layers for c in contenders) else 0
    pictures = {
        "use a display with fewer pixels": (display.eia_shape, _EIA_BYTES),
        "lower inim.capture_pixels_per_pitch": (
            display.capture_shape(settings.capture_pixels_per_pitch),
            _CAPTURE_BYTES + layers,
        ),
        "lower inim.view_pixels_per_lens": (
            _view_shape(display, settings.view_pixels_per_lens),
            _VIEW_BYTES + views * (3 + len(contenders)) * _KEPT_BYTES,
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
