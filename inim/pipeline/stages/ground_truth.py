"""Ground truth: the EIA traced through every lens centre, and the scene from every eye."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from inim.display import Display, Viewpoint
from inim.display.pixels import SUBPIXELS
from inim.documents.parts import Check
from inim.image.noisy_image import NoisyImage
from inim.metrics import Viewing, all_metrics, relic_region
from inim.pipeline.stages.capture import Capture
from inim.pipeline.stages.checks import (
    BLACK,
    CLIPPED_SHARE,
    any_colour,
    check,
    nonfinite_checks,
    share_outside,
)
from inim.pipeline.stages.scene import BLACK_FOR_CERTAIN, Scene, samples_traced, seed_of
from inim.pipeline.stages.stage import RENDERING, Run, stage

_NOT_OBSERVED = "no asked-for view has a sample there; "


def _panel_samples(
    samples: int, eia_spp: int, mounted: Display, mask: np.ndarray | None, **_: Any
) -> tuple[str, str, str]:
    whole = 2 * max(1, eia_spp // 2) * mounted.eia_shape[0] * mounted.eia_shape[1]
    whole *= len({(place.right, place.width) for place in SUBPIXELS[mounted.subpixels]})
    why = ("" if mask is None else _NOT_OBSERVED) + BLACK_FOR_CERTAIN
    return samples_traced(samples, whole, why)


@stage("{name}", code=RENDERING, makes=(NoisyImage,), describe=_panel_samples)
def pick_up(
    scene: Scene,
    mounted: Display,
    eia_spp: int,
    seed: int,
    mask: np.ndarray | None = None,
    name: str = "ground-truth EIA",
) -> tuple[NoisyImage, float]:
    """The EIA traced from the scene through every lens centre (Eq. 1), and the seconds it took.

    Black outside the mask.

    Parameters
    ----------
    scene : Scene
    mounted : Display
        The one it is made for, `through_pinholes`: for the ground truth as it is mounted, for a
        method as it is designed.
    eia_spp : int
        Samples per panel pixel, both halves.
    seed : int
        Of this picture; see `seed_of`.
    mask : (rows, columns) bool, optional
        Panel pixels to trace; all if None.
    name : str
        In the report.
    """
    from inim.render.ground_truth import pickup

    fitted, started = scene.fitted, perf_counter()
    eia = pickup(fitted, mounted, spp=eia_spp, seed=seed, mask=mask, **scene.effort)
    return eia, perf_counter() - started


def pick_up_truth(
    scene: Scene,
    mounted: Display,
    eia_spp: int,
    seed: int,
    mask: np.ndarray | None,
    *,
    run: Run,
) -> NoisyImage:
    """The ground-truth EIA, finite: of the display as it is mounted, by the run's seed."""
    name = "ground-truth EIA" if mask is None else "ground-truth EIA, where observed"
    display, own = mounted.through_pinholes(), seed_of("eia", seed)
    with run.observer.timed("ground-truth EIA"):
        eia, _ = pick_up(scene, display, eia_spp, own, mask, name, run=run)
        return eia.replace_nonfinite()


@stage("panel pixels that meet the scene", code=RENDERING)
def covered_pixels(scene: Scene) -> np.ndarray:
    """Panel pixels whose centre ray meets something of the scene, (rows, columns) bool."""
    fitted = scene.fitted
    from inim.render.rays import pickup_rays
    from inim.render.sensors import make_sensor
    from inim.render.trace import surface

    rays = pickup_rays(scene.display, fitted.start_mm)
    sensor = make_sensor(rays, fitted.fit.world_from_display)
    return surface(fitted.scene, fitted.integrator, sensor, scene.renderer.observer).covered


def _view_samples(
    samples: int,
    scene: Scene,
    view_pixels_per_lens: int | tuple[float, float],
    view_spp: int,
    **_: Any,
) -> tuple[str, str, str]:
    down, across = np.broadcast_to(view_pixels_per_lens, 2)
    rows, columns = scene.display.lens_rows, scene.display.lens_columns
    pixels = round(rows * down) * round(columns * across)
    return samples_traced(samples, 2 * max(1, view_spp // 2) * pixels, BLACK_FOR_CERTAIN)


@stage(
    "true view: {viewpoint.name}",
    code=RENDERING,
    makes=(NoisyImage,),
    timed="ground-truth views",
    describe=_view_samples,
)
def render_view(
    scene: Scene,
    viewpoint: Viewpoint,
    view_pixels_per_lens: int | tuple[float, float],
    view_spp: int,
    seed: int,
) -> tuple[NoisyImage, np.ndarray]:
    """The scene itself from an eye, through the window of the array, and the relic's pixels.

    Parameters
    ----------
    scene : Scene
    viewpoint : Viewpoint
    view_pixels_per_lens : int, or (down, across)
        See `inim.render.rays.eye_rays`.
    view_spp : int
        Samples per pixel, both halves.
    seed : int
        Of the run.
    """
    from inim.render.ground_truth import true_view

    return true_view(
        scene.fitted,
        scene.display,
        viewpoint,
        pixels_per_lens=view_pixels_per_lens,
        spp=view_spp,
        seed=seed_of("views", seed),
        **scene.effort,
    )


@dataclass(frozen=True)
class GroundTruth:
    """Everything that methods are compared with.

    Attributes
    ----------
    display : Display
        As designed.
    eia : NoisyImage
        Finite; black where the run observes nothing of it.
    whole : bool
        Whether all of it was made.
    clipped : float
        Share of its pixels that no panel shows.
    views : dict of str to NoisyImage
        The scene itself, by viewpoint; finite.
    regions : dict of str to (rows, columns) bool
        The relic's in each view: the same for all methods, as it is known without them.
    reference_views : dict of str to NoisyImage
        Views of the ground-truth EIA.
    viewing : dict of str to Viewing or None
        Viewing conditions of each view; None if no metric depends on them.
    checks : tuple of Check
    warnings : tuple of str
    """

    display: Display
    eia: NoisyImage
    whole: bool
    clipped: float
    views: dict[str, NoisyImage]
    regions: dict[str, np.ndarray]
    reference_views: dict[str, NoisyImage]
    viewing: dict[str, Viewing | None]
    checks: tuple[Check, ...] = ()
    warnings: tuple[str, ...] = ()

    def conditions(self, view: str) -> tuple[np.ndarray, Viewing | None]:
        """Conditions under which a view is scored: the relic's region, and how it is viewed."""
        return self.regions[view], self.viewing[view]


def collect_truth(
    capture: Capture,
    eia: NoisyImage,
    views: dict[str, tuple[NoisyImage, np.ndarray]],
    reference_views: dict[str, NoisyImage],
    viewing: dict[str, Viewing],
    *,
    whole: bool,
) -> GroundTruth:
    """The ground truth from what was rendered, checked.

    A ground truth that shows nothing is a failure to report, not a picture to score.
    """
    finite_views = {name: view.replace_nonfinite() for name, (view, _) in views.items()}
    covered = float(capture.rgbd.covered.mean())
    truth = {"truth/eia": eia} | {f"truth/{name}": view for name, view in finite_views.items()}
    checks = [row for name, one in truth.items() for row in nonfinite_checks(name, one.nonfinite)]
    checks.append(check("RGB-D: covered share", covered, ">=", 1e-6, "the relic is seen"))
    images = {name: one.image for name, one in truth.items()}
    for name, image in images.items():
        row = check(f"{name}: brightest value", float(image.max()), ">=", BLACK, "not black")
        checks.append(row)
    clipped = {name: float(any_colour(image > 1).mean()) for name, image in images.items()}
    worst = max(clipped, key=lambda name: clipped[name])
    warnings = []
    if clipped[worst] > CLIPPED_SHARE:
        warnings.append(
            f"{worst}: {clipped[worst]:.1%} of the pixels are brighter than the panel's white and "
            "clipped; dim the scene's lights"
        )
    is_viewed = any(metric.viewed for metric in all_metrics())
    return GroundTruth(
        capture.camera.scene.display,
        eia,
        whole,
        share_outside(images["truth/eia"]),
        finite_views,
        {name: relic_region(relic) for name, (_, relic) in views.items()},
        reference_views,
        {name: how if is_viewed else None for name, how in viewing.items()},
        tuple(checks),
        tuple(warnings),
    )
