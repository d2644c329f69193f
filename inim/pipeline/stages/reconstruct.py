"""What a viewer sees of an EIA, and which panel pixels that depends on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from inim.cache import array_digest
from inim.display import Display, Viewpoint
from inim.image.noisy_image import NoisyImage
from inim.lens import foreign_identity, white_exposure
from inim.metrics import Viewing
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.stages.stage import RENDERING, Run, stage


@dataclass(frozen=True)
class Optics:
    """How views of EIAs are reconstructed.

    Attributes
    ----------
    display : Display
        Display with its misalignment.
    lens_model : str
    view_pixels_per_lens : int, or (down, across)
        See `inim.render.rays.eye_rays`.
    reconstruction_spp : int
        Samples per view pixel, both halves.
    seed : int
        Of the run; the same for all EIAs, so equal EIAs look equal.
    """

    display: Display
    lens_model: str
    view_pixels_per_lens: int | tuple[float, float]
    reconstruction_spp: int
    seed: int

    def cache_key(self) -> dict[str, Any]:
        """By the names of the settings."""
        given = {f"display {k}": v for k, v in self.display.given().items() if k != "name"}
        package = foreign_identity(self.lens_model)
        own = {name: value for name, value in vars(self).items() if name != "display"}
        return given | own | {"lens_model's package": package}

    def viewing(self, eye: Viewpoint, luminance_cd_m2: float) -> Viewing:
        """How a view is seen from its eye: its pixels lie on the lens array."""
        per_lens = self.view_pixels_per_lens
        across = per_lens if isinstance(per_lens, int) else per_lens[1]
        return Viewing.of(self.display.pitch_mm / across, eye.position_mm, luminance_cd_m2)

    @property
    def half_spp(self) -> int:
        """Samples of each half."""
        return max(1, self.reconstruction_spp // 2)

    @property
    def half_seeds(self) -> tuple[int, int]:
        """Seeds of the two halves."""
        return 2 * self.seed, 2 * self.seed + 1


@dataclass(frozen=True)
class ShownEIA:
    """An EIA on the display: its scene in the renderer is made once for all viewpoints.

    Attributes
    ----------
    eia : (rows, columns, 3) float32, linear RGB
    noise : (rows, columns, 3) float32, or None
        Half of the difference of two halves of the EIA's samples; None where it has no noise.
    optics : Optics
    renderer : Renderer
    """

    eia: np.ndarray
    noise: np.ndarray | None
    optics: Optics
    renderer: Renderer
    _scenes: dict[str, Any] = field(default_factory=dict)

    @cached_property
    def digest(self) -> str:
        """Of EIA and noise."""
        return array_digest(self.eia, self.noise)

    def cache_key(self) -> dict[str, Any]:
        """What decides a view of it."""
        return {"EIA": self.digest, **self.optics.cache_key(), **self.renderer.cache_key()}

    def view(self, viewpoint: Viewpoint, half: int, *, moved: bool = False) -> np.ndarray:
        """The view by a half of the samples, of the EIA or of the EIA moved by its noise."""
        optics, key = self.optics, "moved" if moved else "eia"
        if key not in self._scenes:
            self.renderer.load()
            from inim.render.reconstruct import DisplayScene

            eia = self.eia if not moved or self.noise is None else self.eia + self.noise
            self._scenes[key] = DisplayScene(eia, optics.display, optics.lens_model)
        seen: np.ndarray = self._scenes[key].view(
            viewpoint,
            pixels_per_lens=optics.view_pixels_per_lens,
            spp=optics.half_spp,
            seed=optics.half_seeds[half],
            observer=self.renderer.observer,
        )
        return np.float32(white_exposure(optics.display, optics.lens_model)) * seen


@stage(
    "view of {name}: {viewpoint.name}",
    code=RENDERING,
    result_types=(NoisyImage,),
    timer="reconstruct views",
    describe=("reconstructed", "nothing", "its EIA or its eye is new"),
    derived=("name",),
)
def reconstruct(name: str, shown: ShownEIA, viewpoint: Viewpoint) -> NoisyImage:
    """The view of an EIA from one eye, exposed so that the panel's white looks white.

    It depends on the EIA and the seed only: equal EIAs have equal views. Two views of half of the
    samples each make it. A view is linear in its EIA; so what the EIA's
    noise does to it is a third view, with the first one's random numbers, less the first.

    Parameters
    ----------
    name : str
        Whose EIA it is.
    shown : ShownEIA
    viewpoint : Viewpoint
    """
    first, second = shown.view(viewpoint, 0), shown.view(viewpoint, 1)
    moved = first if shown.noise is None else shown.view(viewpoint, 0, moved=True)
    image = np.float32(0.5) * (first + second)
    noise = np.float32(0.5) * (first - second) + (moved - first)
    return NoisyImage.from_image(image, noise)


def reconstruct_views(
    name: str,
    eia: NoisyImage,
    viewpoints: Sequence[Viewpoint],
    optics: Optics,
    renderer: Renderer,
    *,
    run: Run,
) -> dict[str, NoisyImage]:
    """The views of an EIA, by viewpoint.

    Parameters
    ----------
    name : str
        Whose EIA it is.
    eia : NoisyImage
    viewpoints : sequence of Viewpoint
    optics : Optics
    renderer : Renderer
    run : Run
    """
    shown = ShownEIA(eia.image, eia.noise, optics, renderer)
    return {eye.name: reconstruct(name, shown, eye, run=run) for eye in viewpoints}


def find_observed_pixels(
    viewpoints: Sequence[Viewpoint], optics: Optics, renderer: Renderer, *, run: Run
) -> np.ndarray | None:
    """Panel pixels that the views have samples of, (rows, columns) bool; None: all may be."""
    packed = _observed(tuple(viewpoints), optics, renderer, run=run)
    if packed is None:
        model = optics.lens_model
        why = f"the {model} lens model scatters rays between lenses: any pixel may be observed"
        run.skipped.add("panel pixels", "all", "none", why)
        return None
    count = optics.display.eia_shape[1]
    observed = np.unpackbits(packed, axis=1, count=count).astype(bool)
    done = f"{np.count_nonzero(observed)} of {observed.size} ({observed.mean():.1%})"
    why = "no sample of any asked-for view comes from the others"
    run.skipped.add("panel pixels", done, "the others, and scores of whole EIAs", why)
    return observed


@stage("observed panel pixels", code=RENDERING, timer="observed pixels")
def _observed(
    viewpoints: tuple[Viewpoint, ...], optics: Optics, renderer: Renderer
) -> np.ndarray | None:
    """The pixels packed eight to a byte, (rows, columns / 8) uint8."""
    renderer.load()
    from inim.render import reconstruct as display_scene

    found = display_scene.observed_pixels(
        optics.display,
        viewpoints,
        optics.lens_model,
        pixels_per_lens=optics.view_pixels_per_lens,
        spp=optics.half_spp,
        seeds=optics.half_seeds,
        observer=renderer.observer,
    )
    return None if found is None else np.packbits(found, axis=1)
