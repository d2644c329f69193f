"""The ground truth of a run: everything the contenders are compared with."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from inim.cache.store import Record
from inim.display import Display, Viewpoint
from inim.display.panel import SUBPIXELS
from inim.files.image import write_png, write_rgbd
from inim.half_buffers import HalfBuffers
from inim.pipeline.deciding import capture_parts, display_parts, picture_seed, scene_parts
from inim.pipeline.ledger import Ledger
from inim.pipeline.reconstruct import Seen, reconstruct_views
from inim.rgbd import RGBD, Layer, LayeredRGBD
from inim.row_bands import row_bands

__all__ = [
    "BLACK",
    "CLIPPED_SHARE",
    "GroundTruth",
    "render_pickup",
    "render_truth",
    "share_outside",
]

#: A truth view or EIA whose brightest value is below this shows nothing.
BLACK = 1e-4
#: Above this share of clipped pixels, scores say more about exposure than about the algorithm.
CLIPPED_SHARE = 0.01

_BLACK_FOR_CERTAIN = (
    "rays that meet no shape's box are black for certain; samples have addresses, so the others "
    "keep every bit"
)
_NOT_OBSERVED = "no asked-for view has a sample there; "


@dataclass(frozen=True)
class GroundTruth:
    """Everything the contenders are compared with.

    Attributes
    ----------
    scene : dict
        What the report says of the scene: number of shapes, fit.
    rgbd : RGBD
        The picture generators start from.
    captures : (RGBD, RGBD)
        The two independent halves of its colour's samples.
    eia : HalfBuffers
        Black where the run observes nothing of it.
    clipped : float
        Share of its pixels that no panel shows.
    views : dict of str to HalfBuffers
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

    scene: dict[str, Any]
    rgbd: RGBD
    captures: tuple[RGBD, RGBD]
    eia: HalfBuffers
    views: dict[str, HalfBuffers]
    relic: dict[str, np.ndarray]
    ceiling: dict[str, Seen]
    clipped: float
    layered: LayeredRGBD | None = None
    layered_captures: tuple[LayeredRGBD, ...] = ()

    def input(self, *, layers: bool) -> tuple[RGBD, tuple[RGBD, ...]]:
        """What a contender is given, and its two halves."""
        if layers and self.layered is not None:
            return self.layered, self.layered_captures
        return self.rgbd, self.captures


def render_truth(job: Ledger) -> GroundTruth:
    """Render the RGB-D picture, the true EIA, the true views; look at the true EIA."""
    scene = _scene(job)
    captures, eia = _capture(job), _pickup(job)
    color = np.float32(0.5) * (captures[0].color + captures[1].color)
    rgbd = replace(captures[0], color=color.astype(np.float32))
    layered: LayeredRGBD | None = None
    halves: tuple[LayeredRGBD, ...] = ()
    if any(contender.wants_layers for contender in job.plan.contenders):
        first, second = halves = _capture_layers(job)
        layered = _recoloured(first, np.float32(0.5) * (first.palette + second.palette))
    else:
        job.memo.tell(
            "layers behind the picture", "nothing", "peeling the scene", "no algorithm reads them"
        )
    views: dict[str, HalfBuffers] = {}
    relic: dict[str, np.ndarray] = {}
    for viewpoint in job.plan.viewpoints:
        views[viewpoint.name], relic[viewpoint.name] = _view(job, viewpoint)
    ceiling = reconstruct_views(job, eia.image, eia.noise, "ceiling")
    image = eia.image  # of an 8K panel 0.4 GB: made once
    with job.stage("write pictures"):
        _save(job, rgbd, layered, image, views)
    _check(job, rgbd, image, views)
    clipped = share_outside(image)
    return GroundTruth(scene, rgbd, captures, eia, views, relic, ceiling, clipped, layered, halves)


def share_outside(eia: np.ndarray) -> float:
    """Share of pixels that are below black or brighter than the panel's white."""
    rows = row_bands(*eia.shape[:2])
    outside = (np.count_nonzero(_any_colour((eia[r] < 0) | (eia[r] > 1))) for r in rows)
    return float(sum(outside) / (eia.shape[0] * eia.shape[1]))


def _any_colour(which: np.ndarray) -> np.ndarray:
    """As `any(axis=-1)`, which takes six times as long over three."""
    found: np.ndarray = which[..., 0] | which[..., 1] | which[..., 2]
    return found


def _effort(job: Ledger) -> dict[str, Any]:
    return {"skip": job.skip, "observer": job.listener}


def _traced(job: Ledger, before: int, whole: int, why: str = _BLACK_FOR_CERTAIN) -> Any:
    """Samples that a product took, of so many in whole, as `Memo.recall` tells them."""

    def told() -> tuple[str, str, str]:
        done = job.listener.samples - before
        reason = why if done < whole else "every pixel may show something"
        return f"{_millions(done)} samples traced", f"{_millions(whole - done)} samples", reason

    return told


def _millions(samples: int) -> str:
    return f"{samples / 1e6:.3g} million" if samples >= 1e5 else f"{samples}"


def _scene(job: Ledger) -> dict[str, Any]:
    """Number of shapes, fit."""

    def make() -> Record:
        fit = job.fitted.fit
        return Record(
            {},
            {
                "shapes": job.fitted.shapes,
                "fit": {
                    "scale_xy": fit.scale_xy,
                    "scale_z": fit.scale_z,
                    "display_from_world": fit.display_from_world.tolist(),
                },
            },
        )

    found: dict[str, Any] = job.memo.recall("scene", scene_parts(job, job.plan.display), make).facts
    return found


def _capture(job: Ledger) -> tuple[RGBD, RGBD]:
    """Two halves of the samples; depth and coverage are the same in both."""
    s, display = job.plan.settings, job.plan.display
    seed, before = picture_seed("capture", s.seed), job.listener.samples
    shape = job.plan.capture_shape
    parts = capture_parts(job, "capture")

    def make() -> Record:
        from inim.render.ground_truth import capture_halves

        first, second = capture_halves(
            job.fitted,
            display,
            pixels_per_pitch=s.capture_pixels_per_pitch,
            spp=s.capture_spp,
            seed=seed,
            **_effort(job),
        )
        pictures = {"depth_mm": first.depth_mm, "covered": first.covered}
        return Record({"first": first.color, "second": second.color, **pictures})

    with job.stage("capture RGB-D"):
        whole = 2 * max(1, s.capture_spp // 2) * shape[0] * shape[1]
        told = _traced(job, before, whole)
        found = job.memo.recall("RGB-D picture", parts, make, told=told).arrays
        one, other = job.finite("RGB-D", found["first"], found["second"])
        first = RGBD(one, found["depth_mm"], found["covered"], job.plan.capture_pixel_mm)
        return first, replace(first, color=other)


def _capture_layers(job: Ledger) -> tuple[LayeredRGBD, LayeredRGBD]:
    """Two halves of the samples of all layers; what was found of them goes to the checks."""
    s, display = job.plan.settings, job.plan.display
    seed = picture_seed("layers", s.seed)
    parts = capture_parts(job, "layers")

    def make() -> Record:
        from inim.render.depth_peeling import MOST_LAYERS, peel
        from inim.render.ground_truth import capture_layers

        peeled = peel(
            job.fitted,
            display,
            pixels_per_pitch=s.capture_pixels_per_pitch,
            observer=job.listener,
        )
        first, second = (
            capture_layers(
                job.fitted,
                peeled,
                spp=max(1, s.capture_spp // 2),
                seed=2 * seed + half,
                observer=job.listener,
            )
            for half in (0, 1)
        )
        arrays = {"first": first.palette, "second": second.palette}
        for k, layer in enumerate(first.layers):
            arrays |= {f"front{k}": layer.front_mm, f"back{k}": layer.back_mm}
            arrays |= {f"covered{k}": layer.covered}
        facts = {
            "layers": len(first.layers),
            "cut_share": peeled.cut_share,
            "hidden_share": peeled.hidden_share,
            "most": MOST_LAYERS,
        }
        return Record(arrays, facts)

    with job.stage("capture layers"):
        record = job.memo.recall("layers behind the picture", parts, make, told=lambda: _PEELED)
        first, second = (
            _layered(record, job.plan.capture_pixel_mm, half) for half in ("first", "second")
        )
        shares = ", ".join(f"{layer.covered.mean():.2%}" for layer in first.layers)
        detail = f"they cover {shares} of the pixels, nearest first"
        job.check("RGB-D: layers", float(len(first.layers)), ">=", 1, detail)
        if record.facts["hidden_share"]:
            job.memo.tell(
                "layers behind the picture",
                "those that a ray of the display can meet",
                f"{record.facts['hidden_share']:.2%} of what lies behind the front surface",
                "no ray of any panel pixel meets it",
            )
        if record.facts["cut_share"]:
            job.warnings.append(
                f"RGB-D: {record.facts['cut_share']:.2%} of the covered pixels have more than "
                f"{record.facts['most']} layers; what lies behind those is left out"
            )
        one, other = job.finite("RGB-D layers", first.palette, second.palette)
        return _recoloured(first, one), _recoloured(second, other)


_PEELED = (
    "captured, as many as there are",
    "layers that do not exist",
    "peeling ends where nothing is left",
)


def _layered(record: Record, pixel_mm: float, half: str) -> LayeredRGBD:
    """A half's picture from what was kept of it."""
    found, count = record.arrays, record.facts["layers"]
    layers = [
        Layer(color, found[f"front{k}"], found[f"back{k}"], found[f"covered{k}"])
        for k, color in enumerate(np.split(found[half], count))
    ]
    front = layers[0]
    return LayeredRGBD(
        front.color, front.front_mm, front.covered, pixel_mm, front.back_mm, tuple(layers[1:])
    )


def _recoloured(rgbd: LayeredRGBD, palette: np.ndarray) -> LayeredRGBD:
    """The picture with other colours for all its layers, as its `palette` has them."""
    color, *others = np.split(palette, len(rgbd.layers))
    deeper = [replace(layer, color=own) for layer, own in zip(rgbd.deeper, others, strict=True)]
    return replace(rgbd, color=color, deeper=tuple(deeper))


def _pickup(job: Ledger) -> HalfBuffers:
    with job.stage("ground-truth EIA"):
        name = "ground-truth EIA" if job.observed is None else "ground-truth EIA, where observed"
        eia, _ = render_pickup(job, job.plan.mounted, job.plan.settings.eia_spp, "eia", name)
        return HalfBuffers(*job.finite("truth/eia", eia.first, eia.second))


def render_pickup(
    job: Ledger, display: Display, spp: int, picture: str, name: str
) -> tuple[HalfBuffers, float]:
    """The EIA ray traced from the scene, with the seed of `picture`, where the run observes it.

    And the seconds that it took when it was made.

    The ground truth is made for the display as it is mounted, a contender for the one designed.
    """
    seed, before = picture_seed(picture, job.plan.settings.seed), job.listener.samples
    parts = scene_parts(job, job.plan.display) | {
        "array as mounted": display_parts(display),
        "eia_spp": spp,
        "seed": seed,
        "panel pixels": job.observed,
    }

    def make() -> Record:
        from inim.render.ground_truth import pickup

        asked = job.observed
        fitted, started = job.fitted, perf_counter()
        eia = pickup(fitted, display, spp=spp, seed=seed, asked=asked, **_effort(job))
        return Record({"first": eia.first, "second": eia.second}, perf_counter() - started)

    whole = 2 * max(1, spp // 2) * display.eia_shape[0] * display.eia_shape[1]
    whole *= len({(place.right, place.width) for place in SUBPIXELS[display.subpixels]})
    why = ("" if job.observed is None else _NOT_OBSERVED) + _BLACK_FOR_CERTAIN
    found = job.memo.recall(name, parts, make, told=_traced(job, before, whole, why))
    return HalfBuffers(found.arrays["first"], found.arrays["second"]), float(found.facts)


def _view(job: Ledger, viewpoint: Viewpoint) -> tuple[HalfBuffers, np.ndarray]:
    s, display = job.plan.settings, job.plan.display
    seed, before = picture_seed("views", s.seed), job.listener.samples
    parts = scene_parts(job, display) | {
        "viewpoint": [*viewpoint.position_mm, viewpoint.pupil_mm, viewpoint.focus_mm],
        "view_pixels_per_lens": s.view_pixels_per_lens,
        "view_spp": s.view_spp,
        "seed": seed,
    }

    def make() -> Record:
        from inim.render.ground_truth import true_view

        view, relic = true_view(
            job.fitted,
            display,
            viewpoint,
            pixels_per_lens=s.view_pixels_per_lens,
            spp=s.view_spp,
            seed=seed,
            **_effort(job),
        )
        return Record({"first": view.first, "second": view.second, "relic": relic})

    with job.stage("ground-truth views"):
        pixels = display.lens_rows * display.lens_columns * s.view_pixels_per_lens**2
        told = _traced(job, before, 2 * max(1, s.view_spp // 2) * pixels)
        name = f"true view: {viewpoint.name}"
        found = job.memo.recall(name, parts, make, told=told).arrays
        halves = job.finite(f"truth/{viewpoint.name}", found["first"], found["second"])
        return HalfBuffers(*halves), found["relic"]


def _save(
    job: Ledger,
    rgbd: RGBD,
    layered: LayeredRGBD | None,
    eia: np.ndarray,
    views: dict[str, HalfBuffers],
) -> None:
    low, high = job.plan.display.depth_range_mm
    grey = np.where(rgbd.covered, 0.1 + 0.9 * (rgbd.depth_mm - low) / (high - low), 0.0)

    def write_capture() -> None:
        write_rgbd(job.folder / "rgbd.exr", layered or rgbd, job.pictures.attributes)
        write_png(job.folder / "rgbd_color.png", rgbd.color)
        write_png(job.folder / "rgbd_depth.png", np.repeat(grey[..., None], 3, axis=-1))

    job.pictures.write(write_capture, rgbd.color.nbytes)
    job.pictures.save("truth/eia", eia)
    for name, truth in views.items():
        job.pictures.save(f"truth/{name}", truth.image)


def _check(job: Ledger, rgbd: RGBD, eia: np.ndarray, views: dict[str, HalfBuffers]) -> None:
    """A ground truth that shows nothing is a failure to report, not a picture to score."""
    job.check("RGB-D: covered share", float(rgbd.covered.mean()), ">=", 1e-6, "the relic is seen")
    pictures = {"truth/eia": eia, **{f"truth/{n}": t.image for n, t in views.items()}}
    for name, image in pictures.items():
        job.check(f"{name}: brightest value", float(image.max()), ">=", BLACK, "not black")
    clipped = {name: float(_any_colour(image > 1).mean()) for name, image in pictures.items()}
    worst = max(clipped, key=lambda name: clipped[name])
    if clipped[worst] > CLIPPED_SHARE:
        job.warnings.append(
            f"{worst}: {clipped[worst]:.1%} of the pixels are brighter than the panel's white and "
            "clipped; dim the scene's lights"
        )
