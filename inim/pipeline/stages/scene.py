"""Handles of the renderer and of a scene: identified by a digest, loaded on first use."""

import math
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, TypedDict

from inim.display import Display
from inim.display.settings import Placement
from inim.image.noisy_image import split_samples
from inim.pipeline.stages.stage import RENDERING, stage
from inim.render.scene_files.facts import file_facts
from inim.render.scene_files.file import SceneFile
from inim.system.backend import Backend, choose_backend
from inim.system.plugins import PluginModule
from inim.system.process.observer import Observer

# Each rendered image has its own seed, so that a new viewpoint changes no other image. Append new
# names at the end.
_SEEDED = ("capture", "eia", "views", "pickup", "layers", "optimal")


def seed_of(image: str, run_seed: int) -> int:
    """Seed of one of a run's rendered images."""
    return 1000 * (run_seed + 1) + _SEEDED.index(image)


@dataclass(frozen=True)
class Renderer:
    """The renderer, loaded on first use.

    With `skip`, it leaves out rays that change no result. `rays_in_flight` is the number of rays
    that may be traced at once in the available memory. `plugins` are modules with Mitsuba plugins
    of the scene.
    """

    requested_backend: str
    observer: Observer
    rays_in_flight: int | None = None
    skip: bool = True
    plugins: tuple[PluginModule, ...] = ()

    @cached_property
    def backend(self) -> Backend:
        """The backend, chosen without loading it."""
        return choose_backend(self.requested_backend)

    def cache_key(self) -> dict[str, Any]:
        """Return the properties of the backend that affect rendered images."""
        backend = self.backend
        return {"backend": [backend.variant, backend.libllvm_version, backend.device]}

    def load(self) -> None:
        """Load the backend; not needed if all images are in the cache."""
        from inim.render import trace, variant

        variant.use(self.requested_backend)
        variant.load_plugins(self.plugins)
        if self.rays_in_flight is not None:
            trace.limit_rays(self.rays_in_flight)


@dataclass(frozen=True)
class Scene:
    """A scene in front of a display as designed, opened on first use.

    The relic is fitted into the display's depth range (`inim.render.scene.open_scene`).
    """

    file: SceneFile
    display: Display
    placement: Placement
    renderer: Renderer

    def cache_key(self) -> dict[str, Any]:
        """Return all values that affect rendered images; the display has pinholes for lenses."""
        return self._key

    @cached_property
    def _key(self) -> dict[str, Any]:
        parameters = self.display.through_pinholes().parameters()
        return {
            "scene": self.file.rendered_sha256,
            **asdict(self.placement),
            **{f"display {name}": value for name, value in parameters.items() if name != "name"},
            **self.renderer.cache_key(),
            **{f"plugin {plugin.name}": plugin.sha256 for plugin in self.renderer.plugins},
        }

    @cached_property
    def fitted(self) -> Any:
        """The scene in the renderer, an `inim.render.scene.FittedScene`."""
        self.renderer.load()
        from inim.render.scene import open_scene

        observer = self.renderer.observer
        with observer.timed("open scene"):
            place = asdict(self.placement)
            return open_scene(self.file, self.display, observer=observer, **place)

    @property
    def render_options(self) -> dict[str, Any]:
        """Options of the renderer that change no image."""
        return {"skip": self.renderer.skip, "observer": self.renderer.observer}


@stage("scene", code=RENDERING)
def describe_scene(scene: Scene) -> dict[str, Any]:
    """Describe the scene for report.json: number of shapes and splats, and the fit."""
    fit = scene.fitted.fit
    splats = {"splats": {"count": scene.fitted.splats}} if scene.fitted.shows_splats else {}
    return {
        "shapes": scene.fitted.shapes,
        "left_out": list(scene.fitted.left_out),
        "imports": list(scene.fitted.imports),
        "warnings": list(scene.fitted.warnings),
        **splats,
        "fit": {
            "scale_xy": fit.scale_xy,
            "scale_z": fit.scale_z,
            "depth_mm": fit.depth_mm,
            "display_from_world": fit.display_from_world.tolist(),
        },
    }


@stage("files of the scene", code=RENDERING)
def describe_files(file: SceneFile) -> dict[str, dict[str, str]]:
    """Facts and previews of meshes and pictures, by SHA-256, to show what changed."""
    return file_facts(file)


#: Samples per pixel of each round so far. A stage renders those of the last round.
Rounds = tuple[int, ...]


class RoundSamples(TypedDict):
    """Samples of a round, as arguments of the renderer (`inim.render.ground_truth.pickup`)."""

    spp: int
    first: int


def last_round(rounds: Rounds) -> RoundSamples:
    """Samples of the last round."""
    return {"spp": rounds[-1], "first": sum(rounds[:-1])}


def samples_traced(samples: int, pixels: int, rounds: Rounds, reason: str) -> tuple[str, str, str]:
    """Describe the samples of a rendered image for the report, of all rounds.

    `samples` are those traced in the last round, for an image of so many `pixels`. Every round
    traces the same pixels.
    """
    in_round = math.prod(split_samples(rounds[-1]))
    total = pixels * math.prod(split_samples(sum(rounds)))
    samples = samples * total // (pixels * in_round)
    reason = reason if samples < total else "every pixel may show something"
    return f"{_millions(samples)} samples traced", f"{_millions(total - samples)} samples", reason


def _millions(samples: int) -> str:
    return f"{samples / 1e6:.3g} million" if samples >= 1e5 else f"{samples}"


#: Reason for leaving out rays.
EMPTY_RAYS = (
    "rays that miss all bounding boxes are black; each pixel has its own random numbers, so all "
    "other samples are unchanged"
)
