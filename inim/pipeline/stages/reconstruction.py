"""Reconstructed views of an EIA, and the panel pixels that they depend on."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from inim.display import Display, Viewpoint
from inim.display.lens import foreign_identity, lens_model, white_exposure
from inim.display.panel import emitted_picture, has_own_black, seen_light
from inim.image.noisy_image import NoisyEIA, NoisyImage
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.stages.stage import RENDERING, Run, stage
from inim.scores.metrics import Viewing
from inim.system.cache import array_digest

#: Values, columns and starts of the rows of a sparse matrix, as in `scipy.sparse.csr_array`.
CompressedRows = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Optics:
    """Optical settings for reconstructed views.

    The display includes its misalignment. `view_pixels_per_lens`, a number or (down, across), is
    explained in `inim.render.rays.eye_rays`. `reconstruction_spp` are the samples per view pixel of
    both halves. The seed is the same in all runs: the points at which a view samples the display
    belong to the optics, so that equal EIAs have equal views.
    """

    display: Display
    lens_model: str
    view_pixels_per_lens: int | tuple[float, float]
    reconstruction_spp: int
    seed: int = 0

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


class DisplayViews:
    """Views of EIAs on a display, from the viewpoints of a run.

    Light adds up, so a view is the product of a sparse matrix and the light of the panel pixels
    that it observes. Equal EIAs have equal views.

    `observed`, (rows, columns) bool, are the panel pixels that some view observes. It is None if
    the lens model scatters rays between lenses: any pixel may be observed, and views are rendered.
    """

    def __init__(
        self, viewpoints: Sequence[Viewpoint], optics: Optics, renderer: Renderer, *, run: Run
    ) -> None:
        self.viewpoints, self.optics, self.renderer = viewpoints, optics, renderer
        self._matrices: dict[str, Sequence[CompressedRows]] = {}
        self._masks: dict[str, np.ndarray] = {}
        self.observed: np.ndarray | None = None
        if lens_model(optics.lens_model).trace is None:
            return
        rows, columns = optics.display.eia_shape
        for eye in viewpoints:
            bits, self._matrices[eye.name] = _trace_view(optics, renderer, eye, run=run)
            self._masks[eye.name] = np.unpackbits(bits, count=rows * columns).astype(bool)
        self.observed = np.any([*self._masks.values()], axis=0).reshape(rows, columns)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """The matrices and their panel pixels, by name, for `from_arrays`."""
        arrays = {f"{name} pixels": np.packbits(mask) for name, mask in self._masks.items()}
        for name, matrices in self._matrices.items():
            for number, matrix in enumerate(matrices):
                for part, values in zip(("values", "columns", "rows"), matrix, strict=True):
                    arrays[f"{name} matrix {number} {part}"] = values
        return arrays

    @classmethod
    def from_arrays(
        cls,
        viewpoints: Sequence[Viewpoint],
        optics: Optics,
        renderer: Renderer,
        arrays: Mapping[str, np.ndarray],
    ) -> "DisplayViews":
        """Views whose matrices were stored by `to_arrays`; the renderer is not used."""
        views = cls.__new__(cls)
        views.viewpoints, views.optics, views.renderer = viewpoints, optics, renderer
        rows, columns = optics.display.eia_shape
        views._masks, views._matrices = {}, {}
        for eye in viewpoints:
            bits = arrays[f"{eye.name} pixels"]
            views._masks[eye.name] = np.unpackbits(bits, count=rows * columns).astype(bool)
            count = sum(key.startswith(f"{eye.name} matrix") for key in arrays) // 3
            views._matrices[eye.name] = [
                (
                    arrays[f"{eye.name} matrix {number} values"],
                    arrays[f"{eye.name} matrix {number} columns"],
                    arrays[f"{eye.name} matrix {number} rows"],
                )
                for number in range(count)
            ]
        views.observed = np.any([*views._masks.values()], axis=0).reshape(rows, columns)
        return views

    def cache_key(self) -> dict[str, Any]:
        """Return all values that affect a view of an EIA, except the viewpoint."""
        return {**self.optics.cache_key(), **self.renderer.cache_key()}

    def observed_light(self, eia: NoisyEIA, viewpoint: Viewpoint) -> np.ndarray:
        """Light of the panel pixels that a view observes, of an EIA and of its independent parts.

        (1 + parts, pixels, 3) float32, linear RGB. The parts are the replicates, the halves, or
        none without noise.
        """
        mask = self._masks[viewpoint.name]
        first, *second = (array.reshape(-1, 3)[mask] for array in eia.arrays if array is not None)
        observed = NoisyImage((first, second[0] if second else None), eia.stores_halves)
        parts: Sequence[np.ndarray] | np.ndarray = observed.halves() if second else ()
        if eia.observed is not None and self.observed is not None:
            parts = eia.observed[:, mask[self.observed.ravel()]]
        return np.stack([observed.image, *parts])

    def show(self, light: np.ndarray, viewpoint: Viewpoint) -> np.ndarray:
        """Views of the light of observed panel pixels, (views, pixels, 3), as a viewer sees them.

        (views, rows, columns, 3) float32, linear RGB, exposed for the panel's white.
        """
        from scipy.sparse import csr_array

        optics = self.optics
        shape = optics.display.view_shape(optics.view_pixels_per_lens)
        size = math.prod(shape), light.shape[1]
        matrices = [csr_array(arrays, size) for arrays in self._matrices[viewpoint.name]]
        light = white_exposure(optics.display, optics.lens_model) * emitted_picture(
            light, optics.display
        )
        channels = [matrices[c % len(matrices)] @ light[..., c].T for c in range(3)]
        views = np.stack(channels, axis=-1).swapaxes(0, 1).reshape(len(light), *shape, 3)
        return np.stack([seen_light(view, optics.display) for view in views])


@stage("matrix of the view: {viewpoint.name}", code=RENDERING, timer="trace views")
def _trace_view(
    optics: Optics, renderer: Renderer, viewpoint: Viewpoint
) -> tuple[np.ndarray, Sequence[CompressedRows]]:
    """Trace a view to the panel: the pixels that it observes, and its matrices of these.

    The pixels are packed eight to a byte, uint8.
    """
    renderer.load()
    from inim.render.view_matrix import observed_columns, view_matrices

    matrices = view_matrices(
        optics.display, viewpoint, optics.lens_model,
        pixels_per_lens=optics.view_pixels_per_lens,
        spp=optics.reconstruction_spp, seed=optics.seed, observer=renderer.observer,
    )  # fmt: skip
    mask, matrices = observed_columns(matrices)
    return np.packbits(mask), [(m.data, m.indices, m.indptr) for m in matrices]


_view_stage = stage(
    "view of {name}: {viewpoint.name}",
    code=RENDERING,
    result_types=(NoisyImage,),
    timer="reconstruct views",
    describe=("reconstructed", "nothing", "its EIA or its viewpoint is new"),
    derived=("name",),
)


@_view_stage
def _reconstruct(
    name: str,
    views: DisplayViews,
    viewpoint: Viewpoint,
    light: np.ndarray,
) -> NoisyImage:
    """Reconstruct a view from the light of its panel pixels (`DisplayViews.observed_light`)."""
    # Separate products: the view's bits do not depend on what is known of the noise.
    image = views.show(light[:1], viewpoint)[0]
    if len(light) == 1:
        return NoisyImage.from_image(image)
    parts = NoisyImage.from_parts(views.show(light[1:], viewpoint))
    return NoisyImage.from_image(image, parts.noise, parts.replicates)


@dataclass(frozen=True)
class DisplayedEIA:
    """An EIA on a display whose views have no matrices, loaded into the renderer once.

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
            spp=max(1, optics.reconstruction_spp // 2),
            seed=2 * optics.seed + half,
            observer=self.renderer.observer,
        )
        exposure = np.float32(white_exposure(optics.display, optics.lens_model))
        return seen_light(exposure * view, optics.display)


@_view_stage
def _render(name: str, eia: DisplayedEIA, viewpoint: Viewpoint) -> NoisyImage:
    """Render a view of an EIA as a viewer sees it, exposed for the panel's white.

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
    name: str, eia: NoisyEIA, views: DisplayViews, *, run: Run
) -> dict[str, NoisyImage]:
    """Reconstruct the views of an EIA, by viewpoint."""
    if views.observed is None:
        eia_on_display = DisplayedEIA(eia.image, eia.noise, views.optics, views.renderer)
        return {eye.name: _render(name, eia_on_display, eye, run=run) for eye in views.viewpoints}
    return {
        eye.name: _reconstruct(name, views, eye, views.observed_light(eia, eye), run=run)
        for eye in views.viewpoints
    }


def find_observed_pixels(views: DisplayViews, *, run: Run) -> np.ndarray | None:
    """Find the panel pixels to compute, (rows, columns) bool; None if views may observe any."""
    mask = views.observed
    if mask is None:
        model = views.optics.lens_model
        reason = f"the {model} lens model scatters rays between lenses: any pixel may be observed"
        run.skipped.add("panel pixels", "all", "none", reason)
        return None
    count_text = f"{np.count_nonzero(mask)} of {mask.size} ({mask.mean():.1%})"
    reason = "no requested view samples the others"
    run.skipped.add("panel pixels", count_text, "the others, and scores of whole EIAs", reason)
    return mask
