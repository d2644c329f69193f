"""What the depth camera sees of a scene: colour and depth, and all layers behind the front."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from inim.documents.parts import Check
from inim.image.noisy_image import replace_nonfinite
from inim.image.rgbd import RGBD, Layer, LayeredRGBD
from inim.pipeline.stages.checks import check, nonfinite_checks
from inim.pipeline.stages.scene import EMPTY_RAYS, Scene, samples_traced, seed_of
from inim.pipeline.stages.stage import RENDERING, Run, stage


@dataclass(frozen=True)
class DepthCamera:
    """The depth camera before a scene: parallel rays straight back.

    Attributes
    ----------
    scene : Scene
    pixels_per_pitch : float
    spp : int
        Samples per pixel, both halves.
    seed : int
        Of the run.
    """

    scene: Scene
    pixels_per_pitch: float
    spp: int
    seed: int

    def cache_key(self) -> dict[str, Any]:
        """What decides its picture."""
        return {
            **self.scene.cache_key(),
            "capture_pixels_per_pitch": self.pixels_per_pitch,
            "capture_spp": self.spp,
            "seed": self.seed,
        }

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of its picture."""
        return self.scene.display.capture_shape(self.pixels_per_pitch)

    @property
    def pixel_mm(self) -> float:
        """Side of its pixels."""
        return self.scene.display.capture_pixel_mm(self.pixels_per_pitch)


@dataclass(frozen=True)
class Layers:
    """All layers by two halves of the samples, and what was left out.

    Attributes
    ----------
    halves : (LayeredRGBD, LayeredRGBD)
    covered_shares : tuple of float
        Shares of the picture that the solids of each number cover, nearest first.
    cut_share, hidden_share : float
        See `inim.render.depth_peeling`.
    most : int
        As many solids there may be.
    """

    halves: tuple[LayeredRGBD, LayeredRGBD]
    covered_shares: tuple[float, ...]
    cut_share: float
    hidden_share: float
    most: int


@dataclass(frozen=True)
class Capture:
    """What methods start from.

    Attributes
    ----------
    camera : DepthCamera
    rgbd : RGBD
    halves : (RGBD, RGBD)
        By two independent halves of the colour's samples; depth is the same in both.
    layered : LayeredRGBD, optional
        With what lies behind the front, where a method reads it.
    layered_halves : (LayeredRGBD, LayeredRGBD) or ()
    covered_shares : tuple of float
        See `Layers`.
    hidden_share : float
        Share of what lies behind the front that no ray of the display meets, and is left out.
    checks : tuple of Check
    warnings : tuple of str
    """

    camera: DepthCamera
    rgbd: RGBD
    halves: tuple[RGBD, RGBD]
    layered: LayeredRGBD | None = None
    layered_halves: tuple[LayeredRGBD, ...] = ()
    covered_shares: tuple[float, ...] = ()
    hidden_share: float = 0.0
    checks: tuple[Check, ...] = ()
    warnings: tuple[str, ...] = ()

    def cache_key(self) -> dict[str, Any]:
        """What decides it."""
        return self.camera.cache_key()

    def input(self, *, layers: bool) -> tuple[RGBD, tuple[RGBD, ...]]:
        """What a method is given, and its two halves."""
        if layers and self.layered is not None:
            return self.layered, self.layered_halves
        return self.rgbd, self.halves


def capture_relic(camera: DepthCamera, *, layers: bool, run: Run) -> Capture:
    """Colour and depth, and the layers behind where they are wanted; finite, and checked."""
    first, second = capture_rgbd(camera, run=run)
    (one, other), nonfinite = replace_nonfinite(first.color, second.color)
    halves = replace(first, color=one), replace(second, color=other)
    color = np.float32(0.5) * (one + other)
    mean = replace(first, color=color.astype(np.float32))
    capture = Capture(camera, mean, halves, checks=tuple(nonfinite_checks("RGB-D", nonfinite)))
    if layers:
        return _with_layers(capture, capture_layers(camera, run=run), run)
    what, why = "layers behind the picture", "no algorithm reads them"
    run.skipped.add(what, "nothing", "peeling the scene", why)
    return capture


def _all_samples(samples: int, camera: DepthCamera) -> tuple[str, str, str]:
    whole = 2 * max(1, camera.spp // 2) * camera.shape[0] * camera.shape[1]
    return samples_traced(samples, whole, EMPTY_RAYS)


@stage(
    "RGB-D picture",
    code=RENDERING,
    result_types=(RGBD,),
    timer="capture RGB-D",
    describe=_all_samples,
)
def capture_rgbd(camera: DepthCamera) -> tuple[RGBD, RGBD]:
    """Colour by two halves of the samples, with the same depth and coverage."""
    from inim.render.ground_truth import capture_halves

    return capture_halves(
        camera.scene.fitted,
        camera.scene.display,
        pixels_per_pitch=camera.pixels_per_pitch,
        spp=camera.spp,
        seed=seed_of("capture", camera.seed),
        **camera.scene.effort,
    )


@stage(
    "layers behind the picture",
    code=RENDERING,
    result_types=(Layers, LayeredRGBD, Layer),
    timer="capture layers",
    describe=(
        "captured, as many as there are",
        "layers that do not exist",
        "peeling ends where nothing is left",
    ),
)
def capture_layers(camera: DepthCamera) -> Layers:
    """All solids along the camera's rays, their colours by two halves of the samples."""
    from inim.render import ground_truth
    from inim.render.depth_peeling import MOST_LAYERS, peel

    scene, observer = camera.scene, camera.scene.renderer.observer
    seed = seed_of("layers", camera.seed)
    peeled = peel(
        scene.fitted,
        scene.display,
        pixels_per_pitch=camera.pixels_per_pitch,
        hidden=not scene.renderer.skip,
        observer=observer,
    )
    first, second = (
        ground_truth.capture_layers(
            scene.fitted,
            peeled,
            spp=max(1, camera.spp // 2),
            seed=2 * seed + half,
            observer=observer,
        )
        for half in (0, 1)
    )
    shares = tuple(float(solid.mean()) for solid in peeled.covered)
    return Layers((first, second), shares, peeled.cut_share, peeled.hidden_share, MOST_LAYERS)


def _with_layers(capture: Capture, found: Layers, run: Run) -> Capture:
    """The capture with its layers, their colours finite."""
    first, second = found.halves
    warnings = []
    solids = ", ".join(f"{share:.2%}" for share in found.covered_shares)
    detail = f"solids cover {solids} of the pixels, nearest first; the others are their sides"
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
            "solids; what lies behind those is left out"
        )
    (one, other), nonfinite = replace_nonfinite(first.palette, second.palette)
    checks += nonfinite_checks("RGB-D layers", nonfinite)
    halves = _recoloured(first, one), _recoloured(second, other)
    return replace(
        capture,
        layered=_recoloured(first, np.float32(0.5) * (halves[0].palette + halves[1].palette)),
        layered_halves=halves,
        covered_shares=found.covered_shares,
        hidden_share=found.hidden_share,
        checks=(*capture.checks, *checks),
        warnings=(*capture.warnings, *warnings),
    )


def _recoloured(rgbd: LayeredRGBD, palette: np.ndarray) -> LayeredRGBD:
    """The picture with other colours for all its layers, as its `palette` has them."""
    color, *others = np.split(palette, len(rgbd.layers))
    deeper = [replace(layer, color=own) for layer, own in zip(rgbd.deeper, others, strict=True)]
    return replace(rgbd, color=color, deeper=tuple(deeper))


# What takes less than this of the light counts as nothing: it changes no 8-bit picture by much.
_LEAST_COVERAGE = 0.01
_BINS = 10


@stage("translucency of the splats", code=RENDERING, timer="translucency")
def measure_translucency(camera: DepthCamera) -> dict[str, Any]:
    """What a depth map of the splats cannot hold, as `scene.splats` in report.json."""
    from inim.render.ground_truth import capture_absorption

    fitted = camera.scene.fitted
    lost, mm_per_unit = capture_absorption(
        fitted, camera.scene.display, pixels_per_pitch=camera.pixels_per_pitch
    )
    coverage = 1 - lost.left.astype(np.float64)
    touched = coverage >= _LEAST_COVERAGE
    pixels = max(1, int(np.count_nonzero(touched)))

    def share(where: np.ndarray) -> float:
        return int(np.count_nonzero(where & touched)) / pixels

    counts = np.histogram(coverage[touched], _BINS, (0, 1))[0]
    dense = touched & np.isfinite(lost.most)
    spread = np.abs(lost.most[dense] - lost.tenth[dense]).astype(np.float64) * mm_per_unit
    return {
        "count": fitted.splats,
        "touched_fraction": float(touched.mean()),
        "mean_coverage": float(coverage[touched].mean()) if touched.any() else None,
        "coverage_histogram": (counts / pixels).tolist(),
        "without_depth_fraction": share(~np.isfinite(lost.half)),
        "never_opaque_fraction": share(~np.isfinite(lost.most)),
        "depth_spread_mm": float(np.median(spread)) if dense.any() else None,
        "depth_spread_p95_mm": float(np.quantile(spread, 0.95)) if dense.any() else None,
        "counted_twice_fraction": share(lost.twice),
    }
