"""What the depth camera sees of a scene: colour and depth, and all layers behind the front."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from inim.pipeline.checks import check, finite
from inim.pipeline.scene import BLACK_FOR_CERTAIN, Scene, samples_traced, seed_of
from inim.pipeline.stage import RENDERING, Run, stage
from inim.rgbd import RGBD, Layer, LayeredRGBD

__all__ = ["Capture", "CaptureSettings", "capture_layers", "capture_relic", "capture_rgbd"]


@dataclass(frozen=True)
class CaptureSettings:
    """How the RGB-D picture is captured.

    Attributes
    ----------
    capture_pixels_per_pitch : int
    capture_spp : int
        Samples per pixel, both halves.
    seed : int
        Of the run.
    """

    capture_pixels_per_pitch: int
    capture_spp: int
    seed: int

    def cache_key(self) -> dict[str, Any]:
        """By the names of the settings."""
        return dict(vars(self))


@dataclass(frozen=True)
class Layers:
    """All layers by two halves of the samples, and what was left out.

    Attributes
    ----------
    halves : (LayeredRGBD, LayeredRGBD)
    cut_share, hidden_share : float
        See `inim.render.depth_peeling`.
    most : int
        As many layers there may be.
    """

    halves: tuple[LayeredRGBD, LayeredRGBD]
    cut_share: float
    hidden_share: float
    most: int


@dataclass(frozen=True)
class Capture:
    """What methods start from.

    Attributes
    ----------
    rgbd : RGBD
    halves : (RGBD, RGBD)
        By two independent halves of the colour's samples; depth is the same in both.
    layered : LayeredRGBD, optional
        With what lies behind the front, where a method reads it.
    layered_halves : (LayeredRGBD, LayeredRGBD) or ()
    checks : tuple of dict
    warnings : tuple of str
    """

    rgbd: RGBD
    halves: tuple[RGBD, RGBD]
    layered: LayeredRGBD | None = None
    layered_halves: tuple[LayeredRGBD, ...] = ()
    checks: tuple[dict[str, Any], ...] = ()
    warnings: tuple[str, ...] = ()

    def input(self, *, layers: bool) -> tuple[RGBD, tuple[RGBD, ...]]:
        """What a method is given, and its two halves."""
        if layers and self.layered is not None:
            return self.layered, self.layered_halves
        return self.rgbd, self.halves


def capture_relic(scene: Scene, settings: CaptureSettings, *, layers: bool, run: Run) -> Capture:
    """Colour and depth, and the layers behind where they are wanted; finite, and checked."""
    first, second = capture_rgbd(scene, settings, run=run)
    (one, other), checks = finite("RGB-D", first.color, second.color)
    halves = replace(first, color=one), replace(second, color=other)
    color = np.float32(0.5) * (one + other)
    capture = Capture(replace(first, color=color.astype(np.float32)), halves, checks=(*checks,))
    if layers:
        return _with_layers(capture, capture_layers(scene, settings, run=run), run)
    what, why = "layers behind the picture", "no algorithm reads them"
    run.skipped.add(what, "nothing", "peeling the scene", why)
    return capture


def _all_samples(samples: int, scene: Scene, settings: CaptureSettings) -> tuple[str, str, str]:
    rows, columns = scene.display.capture_shape(settings.capture_pixels_per_pitch)
    whole = 2 * max(1, settings.capture_spp // 2) * rows * columns
    return samples_traced(samples, whole, BLACK_FOR_CERTAIN)


@stage(
    "RGB-D picture",
    code=RENDERING,
    makes=(RGBD,),
    timed="capture RGB-D",
    describe=_all_samples,
)
def capture_rgbd(scene: Scene, settings: CaptureSettings) -> tuple[RGBD, RGBD]:
    """Colour by two halves of the samples, with the same depth and coverage."""
    from inim.render.ground_truth import capture_halves

    return capture_halves(
        scene.fitted,
        scene.display,
        pixels_per_pitch=settings.capture_pixels_per_pitch,
        spp=settings.capture_spp,
        seed=seed_of("capture", settings.seed),
        **scene.effort,
    )


def _peeled(*_: Any, **__: Any) -> tuple[str, str, str]:
    done = "captured, as many as there are"
    return done, "layers that do not exist", "peeling ends where nothing is left"


@stage(
    "layers behind the picture",
    code=RENDERING,
    makes=(Layers, LayeredRGBD, Layer),
    timed="capture layers",
    describe=_peeled,
)
def capture_layers(scene: Scene, settings: CaptureSettings) -> Layers:
    """All solids along the camera's rays, their colours by two halves of the samples."""
    from inim.render import ground_truth
    from inim.render.depth_peeling import MOST_LAYERS, peel

    observer, seed = scene.renderer.observer, seed_of("layers", settings.seed)
    peeled = peel(
        scene.fitted,
        scene.display,
        pixels_per_pitch=settings.capture_pixels_per_pitch,
        observer=observer,
    )
    first, second = (
        ground_truth.capture_layers(
            scene.fitted,
            peeled,
            spp=max(1, settings.capture_spp // 2),
            seed=2 * seed + half,
            observer=observer,
        )
        for half in (0, 1)
    )
    return Layers((first, second), peeled.cut_share, peeled.hidden_share, MOST_LAYERS)


def _with_layers(capture: Capture, found: Layers, run: Run) -> Capture:
    """The capture with its layers, their colours finite."""
    first, second = found.halves
    warnings = []
    shares = ", ".join(f"{layer.covered.mean():.2%}" for layer in first.layers)
    detail = f"they cover {shares} of the pixels, nearest first"
    checks = [check("RGB-D: layers", float(len(first.layers)), ">=", 1, detail)]
    if found.hidden_share:
        run.skipped.add(
            "layers behind the picture",
            "those that a ray of the display can meet",
            f"{found.hidden_share:.2%} of what lies behind the front surface",
            "no ray of any panel pixel meets it",
        )
    if found.cut_share:
        warnings.append(
            f"RGB-D: {found.cut_share:.2%} of the covered pixels have more than {found.most} "
            "layers; what lies behind those is left out"
        )
    (one, other), more = finite("RGB-D layers", first.palette, second.palette)
    halves = _recoloured(first, one), _recoloured(second, other)
    return replace(
        capture,
        layered=_recoloured(first, np.float32(0.5) * (halves[0].palette + halves[1].palette)),
        layered_halves=halves,
        checks=(*capture.checks, *checks, *more),
        warnings=(*capture.warnings, *warnings),
    )


def _recoloured(rgbd: LayeredRGBD, palette: np.ndarray) -> LayeredRGBD:
    """The picture with other colours for all its layers, as its `palette` has them."""
    color, *others = np.split(palette, len(rgbd.layers))
    deeper = [replace(layer, color=own) for layer, own in zip(rgbd.deeper, others, strict=True)]
    return replace(rgbd, color=color, deeper=tuple(deeper))
