"""Capture of a scene by the depth camera: colour, depth and the layers behind the front."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from inim.display import Display
from inim.generators import merge_colourings
from inim.generators.registry import Input
from inim.image.noisy_image import REPLICATES, merged_mean, replace_nonfinite, split_samples
from inim.image.rgbd import (
    RGBD,
    Camera,
    CameraRGBD,
    CameraRGBDs,
    Layer,
    LayeredRGBD,
    camera_directions,
)
from inim.pipeline.stages.scene import (
    EMPTY_RAYS,
    Rounds,
    Scene,
    last_round,
    samples_traced,
    seed_of,
)
from inim.pipeline.stages.stage import GENERATING, RENDERING, Run, stage
from inim.scores.document_parts import Check, check
from inim.system.errors import SceneError

# Share of pixels with too many solids from which a warning appears: one in 10,000.
_LEAST_CUT_SHARE = 1e-4


# More than the images of a run, which have seeds of their own.
_SEED_STEP = 100


class PictureSource(Protocol):
    """Origin of a run's picture: a depth camera in front of a scene, or a fitted picture."""

    @property
    def display(self) -> Display:
        """The display as designed."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the picture."""

    @property
    def pixel_mm(self) -> float:
        """Side length of a pixel."""

    def cache_key(self) -> dict[str, Any]:
        """Return all values that affect the picture."""


@dataclass(frozen=True)
class DepthCamera:
    """A depth camera in front of a scene: parallel rays along the display's axis.

    `rounds` are the samples per pixel of each round, of all parts (`split_samples`); `seed` is the
    run's.
    """

    scene: Scene
    pixels_per_pitch: float
    rounds: Rounds
    seed: int

    def cache_key(self) -> dict[str, Any]:
        """Return all values that affect the capture."""
        return {
            **self.scene.cache_key(),
            "capture_pixels_per_pitch": self.pixels_per_pitch,
            "capture_spp": self.rounds,
            "seed": self.seed,
        }

    @property
    def display(self) -> Display:
        """The display as designed."""
        return self.scene.display

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the capture."""
        return self.scene.display.capture_shape(self.pixels_per_pitch)

    @property
    def pixel_mm(self) -> float:
        """Side length of a pixel."""
        return self.scene.display.capture_pixel_mm(self.pixels_per_pitch)


@dataclass(frozen=True)
class Layers:
    """All layers as independent parts, with the shares left out (`inim.render.depth_peeling`).

    `covered_shares` are the shares of the pixels covered by the first solid, by the second, and so
    on. No ray of the display meets the `hidden_share` of the hidden layers.
    """

    parts: tuple[LayeredRGBD, ...]
    covered_shares: tuple[float, ...]
    cut_share: float
    hidden_share: float
    max_solids: int


class CapturedInput(NamedTuple):
    """Input of methods: a picture, and its parts with independent colour samples.

    The parts are two halves or `REPLICATES`; None for a picture without known noise.
    """

    rgbd: RGBD
    parts: tuple[RGBD, ...] | None

    @classmethod
    def of(cls, parts: Sequence[RGBD]) -> CapturedInput:
        """The mean of independent parts."""
        return cls(_mean_picture(parts), (*parts,))

    @property
    def halves(self) -> tuple[RGBD, RGBD] | None:
        """Means of the first and of the second half of the parts."""
        if self.parts is None:
            return None
        middle = len(self.parts) // 2
        return _mean_picture(self.parts[:middle]), _mean_picture(self.parts[middle:])

    def without_each(self) -> Iterator[RGBD]:
        """Means of all parts but one, in the order of the parts."""
        parts = self.parts or ()
        total = np.float32(len(parts)) * self.rgbd.palette
        for part in parts:
            yield _with_palette(part, (total - part.palette) / np.float32(len(parts) - 1))


@dataclass(frozen=True)
class Capture:
    """Inputs of the methods; `RGBD` is always among them.

    `covered_shares` and `hidden_share` are those of `Layers`.
    """

    camera: PictureSource
    inputs: Mapping[Input, CapturedInput]
    covered_shares: tuple[float, ...] = ()
    hidden_share: float = 0.0
    checks: tuple[Check, ...] = ()
    warnings: tuple[str, ...] = ()

    def cache_key(self) -> dict[str, Any]:
        """Return all values that affect the capture."""
        return self.camera.cache_key()

    @property
    def rgbd(self) -> RGBD:
        """The picture of the front surface."""
        return self.inputs[RGBD].rgbd

    def merged(self, last: Capture, share: float) -> Capture:
        """The capture with all samples, from those of the `last` round; see `merged_mean`."""
        inputs = {}
        for key, captured in last.inputs.items():
            pairs = zip(self.inputs[key].parts or (), captured.parts or (), strict=True)
            inputs[key] = CapturedInput.of(
                [_with_palette(b, merged_mean(a.palette, b.palette, share)) for a, b in pairs]
            )
        failed = [check for check in self.checks if not check.passed]
        return replace(last, inputs=inputs, checks=(*failed, *last.checks))


def capture_relic(camera: DepthCamera, inputs: Collection[Input], *, run: Run) -> Capture:
    """Capture the last round of colour and depth, and of the other inputs, with finite values."""
    capture = _add_input(Capture(camera, {}), RGBD, "RGB-D", capture_rgbd(camera, run=run))
    for views in sorted(views for views in inputs if isinstance(views, str)):
        parts = capture_cameras(camera, views, run=run)
        capture = _add_input(capture, views, f"RGB-D of {views} cameras", parts)
    if LayeredRGBD in inputs:
        return _add_layers(capture, capture_layers(camera, run=run))
    run.skipped.add(
        "layers behind the picture", "nothing", "peeling the scene", "no algorithm reads them"
    )
    return capture


def nonfinite_checks(name: str, count: int) -> list[Check]:
    """A failed check if pixels are not finite; otherwise empty."""
    return [check(f"{name}: pixels not finite", count, "<=", 0, "taken as black")] if count else []


def capture_nonempty(camera: DepthCamera, inputs: Collection[Input], *, run: Run) -> Capture:
    """Capture as `capture_relic`; raises `SceneError` if the camera's picture is empty."""
    capture = capture_relic(camera, inputs, run=run)
    if not capture.rgbd.covered.any():
        raise SceneError(
            f"{camera.scene.file.path}: the depth camera's picture is empty; "
            "check the scene's shapes"
        )
    return capture


def _all_samples(samples: int, camera: DepthCamera) -> tuple[str, str, str]:
    return samples_traced(samples, math.prod(camera.shape), camera.rounds, EMPTY_RAYS)


@stage(
    "RGB-D picture",
    code=RENDERING,
    result_types=(RGBD,),
    timer="capture RGB-D",
    describe=_all_samples,
)
def capture_rgbd(camera: DepthCamera) -> tuple[RGBD, ...]:
    """Capture independent parts of the colour's samples, with the same depth and coverage."""
    from inim.render.ground_truth import capture_parts

    return capture_parts(
        camera.scene.fitted,
        camera.scene.display,
        pixels_per_pitch=camera.pixels_per_pitch,
        seed=seed_of("capture", camera.seed),
        **last_round(camera.rounds),
        **camera.scene.render_options,
    )


def _camera_samples(samples: int, camera: DepthCamera, views: str) -> tuple[str, str, str]:
    pixels = math.prod((*camera.shape, len(camera_directions(views))))
    return samples_traced(samples, pixels, camera.rounds, EMPTY_RAYS)


@stage(
    "RGB-D pictures of {views} cameras",
    code=GENERATING,
    result_types=(RGBD, LayeredRGBD, Layer),
    timer="capture cameras",
    describe=_camera_samples,
)
def capture_cameras(camera: DepthCamera, views: str) -> tuple[RGBD, ...]:
    """Capture the pictures of an arrangement of cameras and merge them, as independent parts.

    The cameras see along rays of the display: the corners of the arrangement along those of the
    corner pixels of an elemental image.
    """
    parts: list[list[CameraRGBD]] = [[] for _ in range(split_samples(camera.rounds[-1])[0])]
    for name, slopes, pictures in camera_pictures(camera, views):
        place = Camera.orthographic(slopes, camera.shape, camera.pixel_mm)
        for part, picture in zip(parts, pictures, strict=True):
            depth = np.where(picture.covered, picture.depth_mm, np.inf)
            part.append(CameraRGBD(picture.color.astype(np.float32), depth, place, name))
    colourings = [CameraRGBDs(tuple(part)) for part in parts]
    return tuple(merge_colourings(colourings, camera.scene.display, camera.pixels_per_pitch))


def camera_pictures(
    camera: DepthCamera, views: str
) -> Iterator[tuple[str, tuple[float, float], tuple[RGBD, ...]]]:
    """Capture the pictures of an arrangement of cameras.

    Yields the camera's name, the slopes of its rays to the right and upwards, and the independent
    parts of its picture.
    """
    from inim.render.ground_truth import capture_parts

    display = camera.scene.display
    half_pixel = display.pixel_pitch_mm / (2 * display.gap_mm)
    right, up = (max(slope - half_pixel, 0.0) for slope in display.layout.outward_slopes())
    for number, (x, y) in enumerate(camera_directions(views)):
        slopes = x * right, y * up
        pictures = capture_parts(
            camera.scene.fitted,
            display,
            pixels_per_pitch=camera.pixels_per_pitch,
            seed=seed_of("capture", camera.seed) + _SEED_STEP * number,
            slopes=slopes,
            **last_round(camera.rounds),
            **camera.scene.render_options,
        )
        yield f"camera {x:+g} {y:+g}", slopes, pictures


@stage(
    "layers behind the picture",
    code=RENDERING,
    result_types=(Layers, LayeredRGBD, Layer),
    timer="capture layers",
    describe=(
        "captured, all that exist",
        "layers that do not exist",
        "peeling ends when no surface is left",
    ),
)
def capture_layers(camera: DepthCamera) -> Layers:
    """Capture all solids along the camera's rays, with independent parts of their colours."""
    from inim.render import ground_truth
    from inim.render.depth_peeling import MOST_LAYERS, peel

    scene, observer = camera.scene, camera.scene.renderer.observer
    seed = seed_of("layers", camera.seed)
    peeled = peel(
        scene.fitted, scene.display, pixels_per_pitch=camera.pixels_per_pitch, observer=observer
    )
    count, spp = split_samples(camera.rounds[-1])
    first = sum(camera.rounds[:-1]) // count
    parts = tuple(
        ground_truth.capture_layers(
            scene.fitted, peeled, spp=spp, seed=REPLICATES * seed + part, first=first,
            observer=observer,
        )
        for part in range(count)
    )  # fmt: skip
    shares = tuple(float(solid.mean()) for solid in peeled.covered)
    return Layers(parts, shares, peeled.cut_share, peeled.hidden_share, MOST_LAYERS)


def _add_layers(capture: Capture, layers: Layers) -> Capture:
    """Return the capture with its layers, nonfinite colours replaced."""
    first, warnings = layers.parts[0], []
    solids = ", ".join(f"{share:.2%}" for share in layers.covered_shares)
    detail = f"solids cover {solids} of the pixels, nearest first; the others are their sides"
    if layers.hidden_share:
        detail += f"; {layers.hidden_share:.2%} of the deeper layers are removed: no ray meets them"
    layers_check = check("RGB-D: layers", float(len(first.layers)), ">=", 1, detail)
    if layers.cut_share >= _LEAST_CUT_SHARE:
        warnings.append(
            f"RGB-D: {layers.cut_share:.2%} of the covered pixels have more than "
            f"{layers.max_solids} solids; the solids behind these are left out"
        )
    capture = replace(
        capture,
        covered_shares=layers.covered_shares,
        hidden_share=layers.hidden_share,
        checks=(*capture.checks, layers_check),
        warnings=(*capture.warnings, *warnings),
    )
    return _add_input(capture, LayeredRGBD, "RGB-D layers", layers.parts)


def _add_input(capture: Capture, key: Input, name: str, parts: tuple[RGBD, ...]) -> Capture:
    """Return the capture with an input and its check, nonfinite colours replaced."""
    palettes, nonfinite = replace_nonfinite(*(part.palette for part in parts))
    finite = CapturedInput.of([*map(_with_palette, parts, palettes)])
    return replace(
        capture,
        inputs={**capture.inputs, key: finite},
        checks=(*capture.checks, *nonfinite_checks(name, nonfinite)),
    )


def _mean_picture(pictures: Sequence[RGBD]) -> RGBD:
    """Return pictures that differ in colour only as one, with their mean colours."""
    palettes = [picture.palette for picture in pictures]
    return _with_palette(pictures[0], np.mean(palettes, axis=0))


def _with_palette(rgbd: RGBD, palette: np.ndarray) -> RGBD:
    """Return the picture with the colours of all layers replaced by a `palette`."""
    if not isinstance(rgbd, LayeredRGBD):
        return replace(rgbd, color=palette)
    color, *colors = np.split(palette, len(rgbd.layers))
    deeper = [replace(layer, color=c) for layer, c in zip(rgbd.deeper, colors, strict=True)]
    return replace(rgbd, color=color, deeper=tuple(deeper))


# A lower coverage hardly changes an 8-bit image and counts as empty.
_MIN_COVERAGE = 0.01
_BINS = 10


@stage("translucency of the splats", code=RENDERING, timer="translucency")
def measure_translucency(camera: DepthCamera) -> dict[str, Any]:
    """Measure the translucency that a depth map cannot represent, for `scene.splats`."""
    from inim.render.ground_truth import capture_absorption

    fitted = camera.scene.fitted
    absorption, mm_per_unit = capture_absorption(
        fitted, camera.scene.display, pixels_per_pitch=camera.pixels_per_pitch
    )
    coverage = 1 - absorption.left.astype(np.float64)
    nonempty = coverage >= _MIN_COVERAGE
    pixels = max(1, int(np.count_nonzero(nonempty)))

    def share(mask: np.ndarray) -> float:
        return int(np.count_nonzero(mask & nonempty)) / pixels

    counts = np.histogram(coverage[nonempty], _BINS, (0, 1))[0]
    dense = nonempty & np.isfinite(absorption.most)
    spread = (
        np.abs(absorption.most[dense] - absorption.tenth[dense]).astype(np.float64) * mm_per_unit
    )
    return {
        "count": fitted.splats,
        "touched_fraction": float(nonempty.mean()),
        "mean_coverage": float(coverage[nonempty].mean()) if nonempty.any() else None,
        "coverage_histogram": (counts / pixels).tolist(),
        "without_depth_fraction": share(~np.isfinite(absorption.half)),
        "never_opaque_fraction": share(~np.isfinite(absorption.most)),
        "depth_spread_mm": float(np.median(spread)) if dense.any() else None,
        "depth_spread_p95_mm": float(np.quantile(spread, 0.95)) if dense.any() else None,
        "counted_twice_fraction": share(absorption.twice),
    }
