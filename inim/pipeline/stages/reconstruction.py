"""Reconstructed views of an EIA, and the panel pixels that they depend on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from inim.display import Display, Viewpoint
from inim.display.lens import foreign_identity, white_exposure
from inim.display.panel import has_own_black, seen_light
from inim.image.noisy_image import NoisyImage
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.stages.stage import RENDERING, Run, stage
from inim.scores.metrics import Viewing
from inim.system.cache import array_digest


@dataclass(frozen=True)
class Optics:
    """Optical settings for reconstructed views.

    The display includes its misalignment. `view_pixels_per_lens`, a number or (down, across), is
    explained in `inim.render.rays.eye_rays`. `reconstruction_spp` are the samples per view pixel of
    both halves. The seed is the same for all EIAs, so that equal EIAs have equal views.
    """

    display: Display
    lens_model: str
    view_pixels_per_lens: int | tuple[float, float]
    reconstruction_spp: int
    seed: int

    def cache_key(self) -> dict[str, Any]:
        """Return all values that affect a view, by the names of the settings."""
        display = {f"display {k}": v for k, v in self.display.parameters().items() if k != "name"}
        package = foreign_identity(self.lens_model)
        settings = {name: value for name, value in vars(self).items() if name != "display"}
        return display | settings | {"lens_model's package": package}

    def viewing_conditions(self, eye: Viewpoint, luminance_cd_m2: float) -> Viewing:
        """Viewing conditions of a view; its pixels are on the lens array."""
        per_lens = self.view_pixels_per_lens
        across = per_lens if isinstance(per_lens, int) else per_lens[1]
        viewing = Viewing.of(self.display.pitch_mm / across, eye.position_mm, luminance_cd_m2)
        # The views contain the black.
        return replace(viewing, contrast=math.inf) if has_own_black(self.display) else viewing

    @property
    def half_spp(self) -> int:
        """Samples of each half."""
        return max(1, self.reconstruction_spp // 2)

    @property
    def half_seeds(self) -> tuple[int, int]:
        """Seeds of the two halves."""
        return 2 * self.seed, 2 * self.seed + 1


@dataclass(frozen=True)
class DisplayedEIA:
    """An EIA on the display, loaded into the renderer once for all viewpoints.

    `eia` and its noise, half the difference of its half images, are (rows, columns, 3) float32,
    linear RGB. The noise may be None.
    """

    eia: np.ndarray
    noise: np.ndarray | None
    optics: Optics
    renderer: Renderer
    _scenes: dict[bool, Any] = field(default_factory=dict)

    @cached_property
    def digest(self) -> str:
        """Digest of the EIA and its noise."""
        return array_digest(self.eia, self.noise)

    def cache_key(self) -> dict[str, Any]:
        """Return all values that affect a view."""
        return {"EIA": self.digest, **self.optics.cache_key(), **self.renderer.cache_key()}

    def view(self, viewpoint: Viewpoint, half: int, *, add_noise: bool = False) -> np.ndarray:
        """Render a half image of the view of the EIA, or of the EIA plus its noise."""
        optics = self.optics
        if add_noise not in self._scenes:
            self.renderer.load()
            from inim.render.reconstruct import DisplayScene

            eia = self.eia + self.noise if add_noise and self.noise is not None else self.eia
            self._scenes[add_noise] = DisplayScene(eia, optics.display, optics.lens_model)
        view: np.ndarray = self._scenes[add_noise].view(
            viewpoint,
            pixels_per_lens=optics.view_pixels_per_lens,
            spp=optics.half_spp,
            seed=optics.half_seeds[half],
            observer=self.renderer.observer,
        )
        exposure = np.float32(white_exposure(optics.display, optics.lens_model))
        return seen_light(exposure * view, optics.display)


@stage(
    "view of {name}: {viewpoint.name}",
    code=RENDERING,
    result_types=(NoisyImage,),
    timer="reconstruct views",
    describe=("reconstructed", "nothing", "its EIA or its viewpoint is new"),
    derived=("name",),
)
def reconstruct(name: str, eia: DisplayedEIA, viewpoint: Viewpoint) -> NoisyImage:
    """Reconstruct a view of an EIA as a viewer sees it, exposed for the panel's white.

    The view is the mean of two half images. Equal EIAs with equal seeds have equal views. A view is
    affine in its EIA, so the EIA's noise changes it by the view of the EIA plus its noise, minus
    the first half image, both with the same random numbers.
    """
    first, second = eia.view(viewpoint, 0), eia.view(viewpoint, 1)
    noisy = first if eia.noise is None else eia.view(viewpoint, 0, add_noise=True)
    image = np.float32(0.5) * (first + second)
    noise = np.float32(0.5) * (first - second) + (noisy - first)
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
    """Reconstruct the views of an EIA, by viewpoint."""
    eia_on_display = DisplayedEIA(eia.image, eia.noise, optics, renderer)
    return {eye.name: reconstruct(name, eia_on_display, eye, run=run) for eye in viewpoints}


def find_observed_pixels(
    viewpoints: Sequence[Viewpoint], optics: Optics, renderer: Renderer, *, run: Run
) -> np.ndarray | None:
    """Find the panel pixels that views sample, (rows, columns) bool; None if it may be any."""
    packed_mask = _packed_observed_pixels(tuple(viewpoints), optics, renderer, run=run)
    if packed_mask is None:
        model = optics.lens_model
        reason = f"the {model} lens model scatters rays between lenses: any pixel may be observed"
        run.skipped.add("panel pixels", "all", "none", reason)
        return None
    count = optics.display.eia_shape[1]
    mask = np.unpackbits(packed_mask, axis=1, count=count).astype(bool)
    count_text = f"{np.count_nonzero(mask)} of {mask.size} ({mask.mean():.1%})"
    reason = "no requested view samples the others"
    run.skipped.add("panel pixels", count_text, "the others, and scores of whole EIAs", reason)
    return mask


@stage("observed panel pixels", code=RENDERING, timer="observed pixels")
def _packed_observed_pixels(
    viewpoints: tuple[Viewpoint, ...], optics: Optics, renderer: Renderer
) -> np.ndarray | None:
    """Observed pixels packed eight to a byte, (rows, columns / 8) uint8."""
    renderer.load()
    from inim.render import reconstruct as display_scene

    mask = display_scene.observed_pixels(
        optics.display,
        viewpoints,
        optics.lens_model,
        pixels_per_lens=optics.view_pixels_per_lens,
        spp=optics.half_spp,
        seeds=optics.half_seeds,
        observer=renderer.observer,
    )
    return None if mask is None else np.packbits(mask, axis=1)
