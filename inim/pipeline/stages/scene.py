"""Handles of a renderer and of a scene: known by their digest, loaded when first used."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from inim.backend import Backend, choose_backend
from inim.display import Display
from inim.pipeline.stages.stage import RENDERING, stage
from inim.process.observer import Observer
from inim.scene.file import SceneFile

# Each picture's seed is its own, so that adding a viewpoint changes no other picture. New ones go
# to the end.
_SEEDED = ("capture", "eia", "views", "pickup", "layers")


def seed_of(picture: str, run_seed: int) -> int:
    """The seed of one of a run's rendered pictures."""
    return 1000 * (run_seed + 1) + _SEEDED.index(picture)


@dataclass(frozen=True)
class Renderer:
    """The renderer, not loaded yet.

    Attributes
    ----------
    wanted : {"auto", "llvm", "cuda"}
    observer : Observer
        Hears of rays, seconds and samples.
    rays_in_flight : int, optional
        That memory allows at once.
    skip : bool
        Leave out rays that change no result.
    """

    wanted: str
    observer: Observer
    rays_in_flight: int | None = None
    skip: bool = True

    @cached_property
    def backend(self) -> Backend:
        """What renders, should anything have to be rendered."""
        return choose_backend(self.wanted)

    def cache_key(self) -> dict[str, Any]:
        """What decides a picture of it."""
        backend = self.backend
        return {"backend": [backend.variant, backend.libllvm_version, backend.device]}

    def load(self) -> None:
        """Load it: a run that finds all its pictures in the cache never does."""
        from inim.render import trace, variant

        variant.use(self.wanted)
        if self.rays_in_flight is not None:
            trace.limit_rays(self.rays_in_flight)


@dataclass(frozen=True)
class Scene:
    """A scene before a display, not opened yet.

    Attributes
    ----------
    file : SceneFile
    display : Display
        As designed: the relic is fitted into its depth range.
    fit_share : float
        Share of the array that the relic fills.
    renderer : Renderer
    """

    file: SceneFile
    display: Display
    fit_share: float
    renderer: Renderer

    def cache_key(self) -> dict[str, Any]:
        """What decides any picture of it; lenses do not, as it is traced through their centres."""
        return self._key

    @cached_property
    def _key(self) -> dict[str, Any]:
        given = self.display.through_pinholes().given()
        return {
            "scene": self.file.rendered_sha256,
            "fit_share": self.fit_share,
            **{f"display {name}": value for name, value in given.items() if name != "name"},
            **self.renderer.cache_key(),
        }

    @cached_property
    def fitted(self) -> Any:
        """The scene in the renderer, an `inim.render.scene.FittedScene`."""
        self.renderer.load()
        from inim.render.scene import open_scene

        observer = self.renderer.observer
        with observer.timed("open scene"):
            return open_scene(self.file, self.display, self.fit_share, observer)

    @property
    def effort(self) -> dict[str, Any]:
        """How pictures of it are rendered; changes none of them."""
        return {"skip": self.renderer.skip, "observer": self.renderer.observer}


@stage("scene", code=RENDERING)
def describe_scene(scene: Scene) -> dict[str, Any]:
    """Number of shapes and splats, and the fit, as in report.json."""
    fit = scene.fitted.fit
    of_splats = {"splats": {"count": scene.fitted.splats}} if scene.fitted.shows_splats else {}
    return {
        "shapes": scene.fitted.shapes,
        **of_splats,
        "fit": {
            "scale_xy": fit.scale_xy,
            "scale_z": fit.scale_z,
            "display_from_world": fit.display_from_world.tolist(),
        },
    }


def samples_traced(samples: int, whole: int, why: str) -> tuple[str, str, str]:
    """What the report says of a rendered picture.

    Parameters
    ----------
    samples : int
        That were traced.
    whole : int
        That tracing every pixel would have taken.
    why : str
        The others are not needed.
    """
    reason = why if samples < whole else "every pixel may show something"
    return f"{_millions(samples)} samples traced", f"{_millions(whole - samples)} samples", reason


def _millions(samples: int) -> str:
    return f"{samples / 1e6:.3g} million" if samples >= 1e5 else f"{samples}"


#: Why rays are left out.
EMPTY_RAYS = (
    "rays that meet no shape's box are black for certain; samples have addresses, so the others "
    "keep every bit"
)
