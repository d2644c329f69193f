"""Optimal EIA: the panel image whose views come closest to the scene.

Definition. Of all panel images with values in 0..1, the optimal EIA has views with the largest mean
PSNR to the ground-truth views, at the run's viewpoints, through its lens model and its misaligned
display. It includes the pre-correction of real lenses, and it knows the scene, not only a picture.

Method. A view is linear in the EIA (`inim.render.view_matrix`), and its PSNR is that of sRGB. The
unknowns are the panel's sRGB values: a change of a value changes the views' values by about as
much, in the dark as in the light. A view's squared error is weighted by its inverse, which makes
the mean logarithm fall. Gauss-Newton steps solve the linearised least squares with conjugate
gradients, on the values that are not held at 0 or 1 (Nocedal and Wright, Numerical Optimization,
2006, chapters 5, 10 and 16). A small term keeps panel pixels that views hardly show near the
ground-truth EIA.

Limits. It bounds the mean over the viewpoints of the PSNR of whole views, not SSIM, FLIP, the score
of a single view, of the relic, or of other viewpoints. With few viewpoints, hardly any panel pixel
serves two of them, and views in between are sacrificed; further views over the viewing zone
(``zone``) give a lower and stricter bound. It is a local optimum, rounded to 8 bits. Its ground-
truth views have another seed than those that score it, so it does not follow their noise. The noise
of these views lowers its score slightly; the noise correction of the scores estimates by how much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from inim.display import Viewpoint
from inim.display.lens import lens_model, white_exposure
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_slope, to_srgb
from inim.image.noisy_image import NoisyEIA, NoisyImage
from inim.pipeline.stages.reconstruction import Optics
from inim.pipeline.stages.scene import Scene, seed_of
from inim.pipeline.stages.stage import RENDERING, stage
from inim.system.errors import UsageError

if TYPE_CHECKING:
    from scipy.sparse import csr_array

#: Matrices of a view from panel pixels to view pixels: one for all colours, or one for each.
ViewMatrices = Sequence["csr_array"]

# The variance of rounding to 8 bits. It is added to squared errors: a view without an error would
# otherwise outweigh all others.
_ROUNDING = 1 / (12 * 255**2)
# Weight of the distance to the start, relative to a panel pixel that fills one view pixel.
_NEARNESS = np.float32(1e-3)
# Gauss-Newton steps end when the mean logarithm of squared errors falls by less: 0.004 dB.
_TOLERANCE = 1e-3
_MOST_STEPS = 8
_CONJUGATE_STEPS = 20
# Share of the squared gradient that counts as solved, some float32 roundings.
_LEAST_REST = 1e-10
_SHORTEST_STEP = 1e-3


@dataclass(frozen=True)
class ScoredViews:
    """Views of a run, whose error is minimised."""

    optics: Optics
    viewpoints: tuple[Viewpoint, ...]

    def cache_key(self) -> dict[str, Any]:
        """Return all values that affect the views, apart from the scene."""
        return {"views": [self.optics.cache_key(), self.viewpoints]}

    def check(self) -> None:
        """Raise `UsageError` for a lens model whose views have no sparse matrix."""
        model = lens_model(self.optics.lens_model)
        if model.trace is None:
            raise UsageError(
                f"algorithm 'optimal': the {model.name} lens model scatters rays between lenses; "
                f"use {model.stand_in}, or leave out this algorithm"
            )


@stage(
    "EIA of {name}",
    code=RENDERING,
    result_types=(NoisyEIA,),
    describe=("optimised", "nothing", "its scene or its views are new"),
)
def optimise_eia(
    name: str, scene: Scene, views: ScoredViews, spp: int, start: NoisyImage
) -> tuple[NoisyEIA, float]:
    """Find the EIA whose views come closest to the scene.

    `spp` are the samples per pixel of the ground-truth views, both halves. Panel pixels that no
    view shows keep the values of `start`. The noise of the result is that of the views. Also
    returns the time in seconds, with the rendering of these views.
    """
    fitted, begin = scene.fitted, perf_counter()
    from inim.render.ground_truth import true_view
    from inim.render.view_matrix import view_matrices

    optics = views.optics
    per_lens, seed = optics.view_pixels_per_lens, seed_of("optimal", optics.seed)
    exposure = np.float32(white_exposure(optics.display, optics.lens_model))
    truths, matrices = [], []
    for eye in views.viewpoints:
        truth, _ = true_view(
            fitted, scene.display, eye, pixels_per_lens=per_lens, spp=spp, seed=seed,
            **scene.render_options,
        )  # fmt: skip
        truths.append(truth.replace_nonfinite())
        by_colour = view_matrices(
            optics.display, eye, optics.lens_model, pixels_per_lens=per_lens,
            spp=optics.reconstruction_spp, seed=seed,
        )  # fmt: skip
        matrices.append([matrix * exposure for matrix in by_colour])
    fit = LeastSquares(matrices, start.image)
    eia = fit.solve([truth.image for truth in truths])
    noise = fit.solve([truth.first for truth in truths], eia, steps=1) - eia
    rounded = linear_from_srgb(to_srgb(eia) / np.float32(255))
    return NoisyEIA((rounded, noise)), perf_counter() - begin


class LeastSquares:
    """Least squares for the EIA whose views come closest to images.

    Parameters
    ----------
    matrices : sequence of ViewMatrices
        By view, including the exposure.
    start : (rows, columns, 3) float32
        EIA from which the search starts, linear RGB.
    """

    def __init__(self, matrices: Sequence[ViewMatrices], start: np.ndarray) -> None:
        every = [matrix for by_colour in matrices for matrix in by_colour]
        self._shown = sum(np.bincount(m.indices, minlength=m.shape[1]) for m in every) > 0
        self._forward = [[matrix[:, self._shown] for matrix in m] for m in matrices]
        self._backward = [[matrix.T.tocsr() for matrix in m] for m in self._forward]
        self._start = start

    def solve(
        self, views: Sequence[np.ndarray], guess: np.ndarray | None = None, steps: int = _MOST_STEPS
    ) -> np.ndarray:
        """Find the EIA whose views come closest to `views`.

        Parameters
        ----------
        views : sequence of (rows, columns, 3) float32
            Linear RGB.
        guess : (rows, columns, 3) float32, optional
            First estimate; default: the start.
        steps : int
            Maximum number of Gauss-Newton steps.

        Returns
        -------
        (rows, columns, 3) float32, linear RGB in 0..1
            Equal to the start, cut to 0..1, in pixels that no view shows.
        """
        targets = [srgb_from_linear(view).reshape(-1, 3) for view in views]
        start = srgb_from_linear(self._start.reshape(-1, 3)[self._shown])
        codes = start if guess is None else srgb_from_linear(guess.reshape(-1, 3)[self._shown])
        estimate = self._state_of(codes, targets)
        for _ in range(steps):
            direction = self._direction(estimate, start)
            share = 1.0
            while True:
                codes = np.clip(estimate.codes + np.float32(share) * direction, 0, 1)
                closer = self._state_of(codes, targets)
                if closer.error < estimate.error or share < _SHORTEST_STEP:
                    break
                share /= 2
            gain = estimate.error - closer.error
            if gain > 0:
                estimate = closer
            if gain < _TOLERANCE:
                break
        eia = np.clip(self._start, 0, 1).reshape(-1, 3)
        eia[self._shown] = estimate.light
        result: np.ndarray = eia.reshape(self._start.shape)
        return result

    def _state_of(self, codes: np.ndarray, targets: Sequence[np.ndarray]) -> _PanelState:
        """The views of panel values, and their errors."""
        light = linear_from_srgb(codes)
        views = [_apply(forward, light) for forward in self._forward]
        residuals = [srgb_from_linear(v) - t for v, t in zip(views, targets, strict=True)]
        squares = [float(np.mean(np.square(r), dtype=np.float64)) + _ROUNDING for r in residuals]
        slopes = [srgb_slope(view).astype(np.float32) for view in views]
        weights = [np.float32(min(squares) / square) for square in squares]
        error = float(np.mean(np.log(squares)))
        return _PanelState(codes, light, slopes, residuals, weights, error)

    def _direction(self, estimate: _PanelState, start: np.ndarray) -> np.ndarray:
        """Solution of the linearised least squares, by conjugate gradients."""
        light_slope: np.ndarray = 1 / srgb_slope(estimate.light).astype(np.float32)

        def transposed(values: Sequence[np.ndarray]) -> np.ndarray:
            parts = zip(self._backward, estimate.slopes, estimate.weights, values, strict=True)
            total: np.ndarray = np.zeros_like(light_slope)
            for backward, slope, weight, value in parts:
                total += _apply(backward, weight * slope * value)
            total *= light_slope
            return total

        gradient = transposed(estimate.residuals) + _NEARNESS * (estimate.codes - start)
        is_at_bound = (estimate.codes <= 0) & (gradient > 0) | (estimate.codes >= 1) & (
            gradient < 0
        )
        direction: np.ndarray = np.zeros_like(gradient)
        rest = np.where(is_at_bound, 0, -gradient)
        along, square = rest.copy(), float(np.vdot(rest, rest))
        smallest = _LEAST_REST * square
        for _ in range(_CONJUGATE_STEPS):
            if square <= smallest:
                break
            light = light_slope * along
            changes = [
                slope * _apply(forward, light)
                for forward, slope in zip(self._forward, estimate.slopes, strict=True)
            ]
            curved = np.where(is_at_bound, 0, transposed(changes) + _NEARNESS * along)
            share = np.float32(square / float(np.vdot(along, curved)))
            direction += share * along
            rest -= share * curved
            previous, square = square, float(np.vdot(rest, rest))
            along = rest + np.float32(square / previous) * along
        return direction


class _PanelState(NamedTuple):
    """Panel values with their views: what a Gauss-Newton step needs.

    `codes` and `light` are (shown pixels, 3), sRGB and linear; `slopes` are the derivatives of the
    views' sRGB values, `residuals` their differences to the images, and `weights` the weights of
    the views' squared errors. `error` is the mean logarithm of squared errors.
    """

    codes: np.ndarray
    light: np.ndarray
    slopes: list[np.ndarray]
    residuals: list[np.ndarray]
    weights: list[np.float32]
    error: float


def _apply(by_colour: ViewMatrices, light: np.ndarray) -> np.ndarray:
    """Product with the light of pixels, (pixels, 3), colour by colour if there are three."""
    if len(by_colour) == 1:
        product: np.ndarray = by_colour[0] @ light
        return product
    return np.stack([matrix @ light[:, k] for k, matrix in enumerate(by_colour)], axis=-1)
