"""Ground truth: the EIA traced through every lens centre, and the scene from every viewpoint."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from inim.display import Display, Viewpoint
from inim.display.pixels import SUBPIXELS
from inim.image.noisy_image import NoisyEIA, NoisyImage
from inim.pipeline.stages.capture import Capture, DepthCamera, nonfinite_checks
from inim.pipeline.stages.scene import (
    EMPTY_RAYS,
    Rounds,
    Scene,
    last_round,
    samples_traced,
    seed_of,
)
from inim.pipeline.stages.stage import RENDERING, Run, stage
from inim.scores.document_parts import Check, check
from inim.scores.metrics import Viewing, all_metrics, relic_region
from inim.system.row_bands import row_bands

#: An image whose brightest value is below this is black.
BLACK = 1e-4
# Share of the relic's pixels that should not all be black.
_MOSTLY = 0.9
#: Above this share of clipped pixels, scores depend more on exposure than on the algorithm.
CLIPPED_SHARE = 0.01
_NOT_OBSERVED = "no requested view has a sample there; "


def _panel_samples(
    samples: int, rounds: Rounds, display: Display, mask: np.ndarray | None, **_: Any
) -> tuple[str, str, str]:
    pixels = math.prod(display.eia_shape)
    pixels *= len({(subpixel.right, subpixel.width) for subpixel in SUBPIXELS[display.subpixels]})
    reason = ("" if mask is None else _NOT_OBSERVED) + EMPTY_RAYS
    return samples_traced(samples, pixels, rounds, reason)


@stage("{name}", code=RENDERING, result_types=(NoisyEIA,), describe=_panel_samples)
def pick_up_eia(
    scene: Scene,
    display: Display,
    rounds: Rounds,
    seed: int,
    mask: np.ndarray | None = None,
    observed: np.ndarray | None = None,
    name: str = "ground-truth EIA",
) -> tuple[NoisyEIA, float]:
    """Trace the EIA from the scene through every lens centre (Eq. 1); black outside the mask.

    The display has pinholes: misaligned for the ground truth, as designed for a method. `rounds`
    are samples per panel pixel, of which the last round is traced, and `seed` is that of the image
    (`seed_of`). `mask` selects panel pixels, `observed` those whose replicates are kept, (rows,
    columns) bool. `name` is the name in the report. Also returns the time in seconds.
    """
    from inim.render.ground_truth import pickup

    fitted, start = scene.fitted, perf_counter()
    eia = pickup(
        fitted, display, seed=seed, mask=mask, observed=observed,
        **last_round(rounds), **scene.render_options,
    )  # fmt: skip
    return eia, perf_counter() - start


def render_ground_truth_eia(
    scene: Scene,
    display: Display,
    rounds: Rounds,
    seed: int,
    mask: np.ndarray | None = None,
    observed: np.ndarray | None = None,
    *,
    run: Run,
) -> NoisyEIA:
    """Render the last round of the misaligned display's ground-truth EIA, with finite values."""
    name = "ground-truth EIA" if mask is None else "ground-truth EIA, where observed"
    pinholes, eia_seed = display.through_pinholes(), seed_of("eia", seed)
    with run.observer.timed("ground-truth EIA"):
        eia, _ = pick_up_eia(scene, pinholes, rounds, eia_seed, mask, observed, name, run=run)
        return eia.replace_nonfinite()


@stage("panel pixels that meet the scene", code=RENDERING)
def covered_pixels(scene: Scene) -> np.ndarray:
    """Panel pixels whose centre ray hits the scene, (rows, columns) bool."""
    fitted = scene.fitted
    from inim.render.rays import pickup_rays
    from inim.render.trace import first_surface

    camera = fitted.camera(pickup_rays(scene.display, fitted.start_mm))
    observer = scene.renderer.observer
    return first_surface(fitted.scene, fitted.integrator, camera, observer)[0]


def _view_samples(
    samples: int,
    scene: Scene,
    view_pixels_per_lens: int | tuple[float, float],
    rounds: Rounds,
    **_: Any,
) -> tuple[str, str, str]:
    pixels = math.prod(scene.display.view_shape(view_pixels_per_lens))
    return samples_traced(samples, pixels, rounds, EMPTY_RAYS)


@stage(
    "ground-truth view: {viewpoint.name}",
    code=RENDERING,
    result_types=(NoisyImage,),
    timer="ground-truth views",
    describe=_view_samples,
)
def render_view(
    scene: Scene,
    viewpoint: Viewpoint,
    view_pixels_per_lens: int | tuple[float, float],
    rounds: Rounds,
    seed: int,
) -> tuple[NoisyImage, np.ndarray]:
    """Render the scene from a viewpoint through the window of the lens array.

    `view_pixels_per_lens` is explained in `inim.render.rays.eye_rays`; `rounds` are samples per
    pixel, of which the last round is traced, and `seed` is the run's. Also returns the relic's
    pixels, (rows, columns) bool.
    """
    from inim.render.ground_truth import true_view

    return true_view(
        scene.fitted,
        scene.display,
        viewpoint,
        pixels_per_lens=view_pixels_per_lens,
        seed=seed_of("views", seed),
        **last_round(rounds),
        **scene.render_options,
    )


class SceneView(NamedTuple):
    """View of a scene; its values may be not finite."""

    image: NoisyImage
    relic: np.ndarray  #: Pixels of the relic, (rows, columns) bool.

    def merged(self, last: SceneView, share: float) -> SceneView:
        """The view of all samples, from those of the `last` round; see `merged_mean`."""
        return SceneView(self.image.merged(last.image, share), self.relic)


@dataclass(frozen=True)
class SceneImages:
    """Images of a scene without a method, from all rounds of samples so far.

    `views` are by viewpoint. `rounds` are the samples per pixel by setting, none of a picture.
    `traced`, (rows, columns) bool, are the EIA's pixels traced in the last round, all if None.
    """

    capture: Capture
    eia: NoisyEIA
    views: Mapping[str, SceneView]
    rounds: Mapping[str, Rounds]
    traced: np.ndarray | None = None

    def merged(self, last: SceneImages) -> SceneImages:
        """The images of all samples, from those of the `last` round; see `merged_mean`."""

        def share(setting: str) -> float:
            rounds = last.rounds[setting]
            return 0.0 if rounds == self.rounds[setting] else rounds[-1] / sum(rounds)

        capture, eia, views = self.capture, self.eia, self.views
        if of_capture := share("capture_spp"):
            capture = capture.merged(last.capture, of_capture)
        if of_eia := share("eia_spp"):
            traced = last.traced
            eia = eia.merged(last.eia, of_eia if traced is None else of_eia * traced[..., None])
        if of_views := share("view_spp"):
            views = {n: view.merged(last.views[n], of_views) for n, view in views.items()}
        return replace(last, capture=capture, eia=eia, views=views)

    def spp(self, setting: str) -> int:
        """Samples per pixel of all rounds."""
        return sum(self.rounds[setting])


@dataclass(frozen=True)
class GroundTruth:
    """Ground truth that methods are compared with; values of views are by viewpoint.

    `display` is the display as designed. `eia` and `views` are finite; the EIA is black where no
    view observes it if the run skips these pixels, and `is_whole` otherwise. `clipped_share` is the
    share of the EIA's pixels that the panel cannot show. `regions`, (rows, columns) bool, are the
    relic's, the same for all methods. `reference_views` are the views of the ground-truth EIA.
    `viewing` is None without a metric that needs it. Unless `is_rendered`, all of it follows from a
    picture (`inim.pipeline.stages.picture`), and it is not `is_whole`. Scores have no intervals
    unless `has_intervals`: those of few samples do not contain the score.
    """

    display: Display
    eia: NoisyImage
    is_whole: bool
    clipped_share: float
    views: dict[str, NoisyImage]
    regions: dict[str, np.ndarray]
    reference_views: dict[str, NoisyImage]
    viewing: dict[str, Viewing | None]
    checks: tuple[Check, ...] = ()
    warnings: tuple[str, ...] = ()
    is_rendered: bool = True
    has_intervals: bool = True

    def conditions(self, view: str) -> tuple[np.ndarray, Viewing | None]:
        """Relic region and viewing conditions under which a view is scored."""
        return self.regions[view], self.viewing[view]


def out_of_range_share(eia: np.ndarray) -> float:
    """Share of pixels that are below black or brighter than the panel's white."""
    rows = row_bands(*eia.shape[:2])
    counts = (np.count_nonzero(any_colour((eia[r] < 0) | (eia[r] > 1))) for r in rows)
    return float(sum(counts) / (eia.shape[0] * eia.shape[1]))


def any_colour(mask: np.ndarray) -> np.ndarray:
    """Same as `any(axis=-1)` over three colours, six times as fast."""
    pixels: np.ndarray = mask[..., 0] | mask[..., 1] | mask[..., 2]
    return pixels


def black_warnings(views: Mapping[str, NoisyImage], relics: Mapping[str, np.ndarray]) -> list[str]:
    """Warnings of views in which nearly all of the relic is black, but not all of the image."""
    texts = []
    for name, view in views.items():
        light = view.image.max(axis=-1)[relics[name]]
        if light.size and light.max() >= BLACK > np.quantile(light, _MOSTLY):
            texts.append(
                f"truth/{name}: {_MOSTLY:.0%} of the relic's pixels are black; check its lights, "
                "and if its to_world mirrors it, wrap its material in a bsdf of type twosided"
            )
    return texts


def collect_ground_truth(
    scene: SceneImages,
    reference_views: dict[str, NoisyImage],
    viewing: dict[str, Viewing],
    *,
    is_whole: bool,
) -> GroundTruth:
    """Collect the images of a scene into a ground truth, and check them.

    An empty ground truth fails its checks.
    """
    capture, eia, views = scene.capture, scene.eia, scene.views
    finite_views = {name: view.replace_nonfinite() for name, (view, _) in views.items()}
    covered_share = float(capture.rgbd.covered.mean())
    truth = {"truth/eia": eia} | {f"truth/{name}": view for name, view in finite_views.items()}
    checks = [c for name, image in truth.items() for c in nonfinite_checks(name, image.nonfinite)]
    checks.append(check("RGB-D: covered share", covered_share, ">=", 1e-6, "the relic is seen"))
    images = {name: image.image for name, image in truth.items()}
    checks += [
        check(f"{name}: brightest value", float(image.max()), ">=", BLACK, "not black")
        for name, image in images.items()
    ]
    clipped = {name: float(any_colour(image > 1).mean()) for name, image in images.items()}
    worst = max(clipped, key=lambda name: clipped[name])
    warnings = []
    if clipped[worst] > CLIPPED_SHARE:
        warnings.append(
            f"{worst}: {clipped[worst]:.1%} of the pixels are brighter than the panel's white and "
            "clipped; dim the scene's lights"
        )
    is_rendered = isinstance(capture.camera, DepthCamera)
    if is_rendered:
        relics = {name: relic for name, (_, relic) in views.items()}
        warnings += black_warnings(finite_views, relics)
    needs_viewing = any(metric.needs_viewing for metric in all_metrics())
    return GroundTruth(
        capture.camera.display,
        eia,
        is_whole and is_rendered,
        out_of_range_share(images["truth/eia"]),
        finite_views,
        {name: relic_region(relic) for name, (_, relic) in views.items()},
        reference_views,
        {name: conditions if needs_viewing else None for name, conditions in viewing.items()},
        tuple(checks),
        tuple(warnings),
        is_rendered,
    )
