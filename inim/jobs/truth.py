"""The ground truth of a run: everything the contenders are compared with."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from inim.display import Display
from inim.formats.image import write_png, write_rgbd
from inim.jobs.ledger import Ledger
from inim.jobs.reconstruction import Seen, reconstruct_views
from inim.layered_rgbd import LayeredRGBD
from inim.rgbd import RGBD

__all__ = ["BLACK", "CLIPPED_SHARE", "GroundTruth", "render_pickup", "render_truth"]

#: A truth view or EIA whose brightest value is below this shows nothing.
BLACK = 1e-4
#: Above this share of clipped pixels, scores say more about exposure than about the algorithm.
CLIPPED_SHARE = 0.01

# Each picture's seed is its own, so that adding a viewpoint changes no other picture. New ones go
# to the end.
_PICTURES = ("capture", "eia", "views", "pickup", "layers")


@dataclass(frozen=True)
class GroundTruth:
    """Everything the contenders are compared with.

    Attributes
    ----------
    fitted : FittedScene
    rgbd : RGBD
        The picture generators start from.
    captures : (RGBD, RGBD)
        The two independent halves of its colour's samples.
    eia : Truth
    views : dict of str to Truth
        The scene itself, by viewpoint.
    relic : dict of str to (rows, columns) bool
        Where the relic is in each view.
    ceiling : dict of str to Seen
        Views of the ground-truth EIA.
    layered : LayeredRGBD, optional
        The picture with what lies behind it, where a contender wants it.
    layered_captures : (LayeredRGBD, LayeredRGBD) or ()
        The two independent halves of its colours' samples.
    """

    fitted: Any
    rgbd: RGBD
    captures: tuple[RGBD, RGBD]
    eia: Any
    views: dict[str, Any]
    relic: dict[str, np.ndarray]
    ceiling: dict[str, Seen]
    layered: LayeredRGBD | None = None
    layered_captures: tuple[LayeredRGBD, ...] = ()

    def input(self, *, layers: bool) -> tuple[RGBD, tuple[RGBD, ...]]:
        """What a contender is given, and its two halves."""
        if layers and self.layered is not None:
            return self.layered, self.layered_captures
        return self.rgbd, self.captures


def render_truth(job: Ledger) -> GroundTruth:
    """Render the RGB-D picture, the true EIA, the true views; look at the true EIA."""
    from inim.kernel.scene import open_scene

    with job.stage("open scene"):
        s = job.plan.settings
        fitted = open_scene(job.plan.file, job.plan.display, s.fit_share, job.clock)
    captures, eia = _capture(job, fitted), _pickup(job, fitted)
    color = np.float32(0.5) * (captures[0].color + captures[1].color)
    rgbd = replace(captures[0], color=color.astype(np.float32))
    layered: LayeredRGBD | None = None
    halves: tuple[LayeredRGBD, ...] = ()
    if any(contender.wants_layers for contender in job.plan.contenders):
        first, second = halves = _capture_layers(job, fitted)
        layered = _recoloured(first, np.float32(0.5) * (first.palette + second.palette))
    views: dict[str, Any] = {}
    relic: dict[str, np.ndarray] = {}
    for viewpoint in job.plan.viewpoints:
        views[viewpoint.name], relic[viewpoint.name] = _view(job, fitted, viewpoint)
    ceiling = reconstruct_views(job, eia.image, (eia.first - eia.second) / 2, "ceiling")
    with job.stage("write pictures"):
        _save(job, rgbd, layered, eia, views)
    _check(job, rgbd, eia, views)
    return GroundTruth(fitted, rgbd, captures, eia, views, relic, ceiling, layered, halves)


def _seed(picture: str, run_seed: int) -> int:
    """The seed of one of the run's rendered pictures."""
    return 1000 * (run_seed + 1) + _PICTURES.index(picture)


def _common(job: Ledger) -> dict[str, Any]:
    return {"skip": True, "clock": job.clock, "progress": job.listener.rays}


def _capture(job: Ledger, fitted: Any) -> tuple[RGBD, RGBD]:
    """Two halves of the samples; depth and coverage are the same in both."""
    from inim.kernel import ground_truth

    s = job.plan.settings
    with job.stage("capture RGB-D"):
        first, second = ground_truth.capture_halves(
            fitted,
            job.plan.display,
            pixels_per_pitch=s.capture_pixels_per_pitch,
            spp=s.capture_spp,
            seed=_seed("capture", s.seed),
            **_common(job),
        )
        one, other = job.finite("RGB-D", first.color, second.color)
        return replace(first, color=one), replace(first, color=other)


def _capture_layers(job: Ledger, fitted: Any) -> tuple[LayeredRGBD, LayeredRGBD]:
    """Two halves of the samples of all layers; what was found of them goes to the checks."""
    from inim.kernel.ground_truth import capture_layers
    from inim.kernel.peel import MOST_LAYERS, peel

    s = job.plan.settings
    with job.stage("capture layers"):
        peeled = peel(
            fitted,
            job.plan.display,
            pixels_per_pitch=s.capture_pixels_per_pitch,
            clock=job.clock,
        )
        first, second = (
            capture_layers(
                fitted,
                peeled,
                spp=max(1, s.capture_spp // 2),
                seed=2 * _seed("layers", s.seed) + half,
                clock=job.clock,
            )
            for half in (0, 1)
        )
        shares = ", ".join(f"{layer.covered.mean():.2%}" for layer in first.layers)
        detail = f"they cover {shares} of the pixels, nearest first"
        job.check("RGB-D: layers", float(len(first.layers)), ">=", 1, detail)
        if peeled.cut_share:
            job.warnings.append(
                f"RGB-D: {peeled.cut_share:.2%} of the covered pixels have more than {MOST_LAYERS} "
                "layers; what lies behind those is left out"
            )
        one, other = job.finite("RGB-D layers", first.palette, second.palette)
        return _recoloured(first, one), _recoloured(second, other)


def _recoloured(rgbd: LayeredRGBD, palette: np.ndarray) -> LayeredRGBD:
    """The picture with other colours for all its layers, as its `palette` has them."""
    color, *others = np.split(palette, len(rgbd.layers))
    deeper = [replace(layer, color=own) for layer, own in zip(rgbd.deeper, others, strict=True)]
    return replace(rgbd, color=color, deeper=tuple(deeper))


def _pickup(job: Ledger, fitted: Any) -> Any:
    from inim.kernel.ground_truth import Truth

    with job.stage("ground-truth EIA"):
        eia = render_pickup(job, fitted, job.plan.mounted, job.plan.settings.eia_spp, "eia")
        return Truth(*job.finite("truth/eia", eia.first, eia.second))


def render_pickup(job: Ledger, fitted: Any, display: Display, spp: int, picture: str) -> Any:
    """The EIA ray traced from the scene, with the seed of `picture`: a `Truth` of two halves.

    The ground truth is made for the display as it is mounted, a contender for the one designed.
    """
    from inim.kernel.ground_truth import pickup

    seed = _seed(picture, job.plan.settings.seed)
    return pickup(fitted, display, spp=spp, seed=seed, **_common(job))


def _view(job: Ledger, fitted: Any, viewpoint: Any) -> tuple[Any, np.ndarray]:
    from inim.kernel import ground_truth

    s = job.plan.settings
    with job.stage("ground-truth views"):
        view, relic = ground_truth.true_view(
            fitted,
            job.plan.display,
            viewpoint,
            pixels_per_lens=s.view_pixels_per_lens,
            spp=s.view_spp,
            seed=_seed("views", s.seed),
            **_common(job),
        )
        halves = job.finite(f"truth/{viewpoint.name}", view.first, view.second)
        return ground_truth.Truth(*halves), relic


def _save(
    job: Ledger, rgbd: RGBD, layered: LayeredRGBD | None, eia: Any, views: dict[str, Any]
) -> None:
    low, high = job.plan.display.depth_range_mm
    grey = np.where(rgbd.covered, 0.1 + 0.9 * (rgbd.depth_mm - low) / (high - low), 0.0)
    write_rgbd(job.folder / "rgbd.exr", layered or rgbd, job.attributes())
    write_png(job.folder / "rgbd_color.png", rgbd.color)
    write_png(job.folder / "rgbd_depth.png", np.repeat(grey[..., None], 3, axis=-1))
    job.save("truth/eia", eia.image)
    for name, truth in views.items():
        job.save(f"truth/{name}", truth.image)


def _check(job: Ledger, rgbd: RGBD, eia: Any, views: dict[str, Any]) -> None:
    """A ground truth that shows nothing is a failure to report, not a picture to score."""
    job.check("RGB-D: covered share", float(rgbd.covered.mean()), ">=", 1e-6, "the relic is seen")
    pictures = {"truth/eia": eia.image, **{f"truth/{n}": t.image for n, t in views.items()}}
    for name, image in pictures.items():
        job.check(f"{name}: brightest value", float(image.max()), ">=", BLACK, "not black")
    clipped = {name: float((image > 1).any(axis=-1).mean()) for name, image in pictures.items()}
    worst = max(clipped, key=lambda name: clipped[name])
    if clipped[worst] > CLIPPED_SHARE:
        job.warnings.append(
            f"{worst}: {clipped[worst]:.1%} of the pixels are brighter than the panel's white and "
            "clipped; dim the scene's lights"
        )
