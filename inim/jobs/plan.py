"""What a validation will do, decided before anything heavy is loaded."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from inim.display import Display
from inim.errors import OutOfMemoryError, UsageError
from inim.generators import check_algorithm
from inim.lens import check_lens_model
from inim.scene_file import SceneFile, parse_definitions, read_scene_file
from inim.settings import Settings
from inim.viewpoint import Viewpoint, parse_viewpoints

__all__ = ["Plan", "Request", "make_plan"]

# Bytes per panel pixel at the fullest moment: two float32 halves of the ground truth, their mean,
# the generators' EIAs and source maps, and the scorer's float64 copies.
_BYTES_PER_PIXEL = 320
# The renderer, its kernels, a scene and the rays in flight.
_BASE_BYTES = 3 * 2**30


@dataclass(frozen=True)
class Request:
    """What the user asked for; None and empty mean "as the scene says".

    Attributes
    ----------
    scene, out : Path
    definitions : tuple of str
        `key=value` overrides, as after -D.
    display, algorithms, viewpoints, lens_model : str, optional
        Shorthands for the `inim.*` settings of those names.
    backend : {"auto", "llvm", "cuda"}
    """

    scene: Path
    out: Path
    definitions: tuple[str, ...] = ()
    display: str | None = None
    algorithms: str | None = None
    viewpoints: str | None = None
    lens_model: str | None = None
    backend: str = "auto"

    def command(self) -> list[str]:
        """The command line that repeats this request, after `python -m inim.validate`."""
        words = [str(self.scene), "-o", str(self.out)]
        for item in self.definitions:
            words += ["-D", item]
        for name in ("display", "algorithms", "viewpoints", "lens_model"):
            value = getattr(self, name)
            if value is not None:
                words += [f"--{name.replace('_', '-')}", value]
        if self.backend != "auto":
            words += ["--backend", self.backend]
        return words


@dataclass(frozen=True)
class Plan:
    """A request checked against its scene file: all that can go wrong without rendering has not.

    Attributes
    ----------
    request : Request
    file : SceneFile
    settings : Settings
    display : Display
    viewpoints : tuple of Viewpoint
    algorithms : tuple of str
    ssim_limits : dict of str to float
        Least SSIM to the ceiling, by algorithm.
    """

    request: Request
    file: SceneFile
    settings: Settings
    display: Display
    viewpoints: tuple[Viewpoint, ...]
    algorithms: tuple[str, ...]
    ssim_limits: dict[str, float]


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
    for name in ("display", "algorithms", "viewpoints", "lens_model"):
        if getattr(request, name) is not None:
            settings = replace(settings, **{name: getattr(request, name)})
    display = settings.make_display(source)
    check_lens_model(settings.lens_model, display)
    viewpoints = parse_viewpoints(settings.viewpoints, display, settings.viewing_distance_mm)
    algorithms = _algorithms(settings.algorithms)
    limits = settings.ssim_limits(algorithms, source)
    _check_memory(display)
    return Plan(request, file, settings, display, viewpoints, algorithms, limits)


def _algorithms(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if not names:
        raise UsageError("algorithms: none given; name at least one, such as 'template'")
    for name in names:
        check_algorithm(name)
        if names.count(name) > 1:
            raise UsageError(f"algorithm {name!r} is given twice; drop one")
    return names


def _check_memory(display: Display) -> None:
    """Refuse what cannot fit before it takes the machine down: running out is a native death."""
    from inim.backend import memory_limit_bytes

    rows, columns = display.eia_shape
    needed = _BASE_BYTES + rows * columns * _BYTES_PER_PIXEL
    limit = memory_limit_bytes()
    if limit and needed > limit:
        raise OutOfMemoryError(
            f"display {display.name}: {columns} x {rows} pixels need about "
            f"{needed / 2**30:.1f} GiB of the {limit / 2**30:.1f} GiB there are; "
            "use a display with fewer pixels"
        )
