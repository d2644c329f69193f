"""What decides the results of a run, by names that people can read."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from inim.cache.digest import code_digest
from inim.display import Display
from inim.lens import foreign_identity
from inim.provenance import versions

if TYPE_CHECKING:
    from inim.pipeline.ledger import Ledger

__all__ = [
    "capture_parts",
    "display_parts",
    "eia_parts",
    "look_parts",
    "picture_seed",
    "scene_parts",
    "score_parts",
]

# Parameters that matter behind the lens only: ground truth is traced through lens centres.
_OPTICS = frozenset(
    {
        "name",
        "refractive_index",
        "lens_thickness_mm",
        "curved_side",
        "conic",
        "asphere_a4",
        "asphere_a6",
        "abbe_number",
        "aperture",
        "fill_factor",
        "between_lenses",
    }
)
# What pictures and displays are.
_SHARED = ("color.py", "display", "half_buffers.py", "rgbd", "scene")
# What renders; not algorithms, reports or commands.
_RENDERING = ("render", "lens", "files", "generators/raycast/layers_in_view.py", *_SHARED)
_SCORING = ("metrics", "color.py", "row_bands.py", "regression")


# Each picture's seed is its own, so that adding a viewpoint changes no other picture. New ones go
# to the end.
_PICTURES = ("capture", "eia", "views", "pickup", "layers")


def picture_seed(picture: str, run_seed: int) -> int:
    """The seed of one of the run's rendered pictures."""
    return 1000 * (run_seed + 1) + _PICTURES.index(picture)


def scene_parts(job: Ledger, display: Display) -> dict[str, Any]:
    """What decides any picture of the scene before a display."""
    return {
        "scene": job.plan.file.look_sha256,
        "fit_share": job.plan.settings.fit_share,
        **display_parts(display),
        **_renderer(job),
    }


def display_parts(display: Display) -> dict[str, Any]:
    """What of a display decides the rays of its pixels, capture and viewers."""
    given = {k: v for k, v in display.given().items() if k not in _OPTICS}
    return {f"display {name}": value for name, value in given.items()}


def capture_parts(job: Ledger, picture: str) -> dict[str, Any]:
    """What decides the RGB-D picture, or all its layers; `picture` is the seed's name."""
    s = job.plan.settings
    return scene_parts(job, job.plan.display) | {
        "capture_pixels_per_pitch": s.capture_pixels_per_pitch,
        "capture_spp": s.capture_spp,
        "seed": picture_seed(picture, s.seed),
    }


def eia_parts(job: Ledger, algorithm: str, picture: str) -> dict[str, Any]:
    """What decides the EIA that one of the project's own generators makes of a picture."""
    return {
        "algorithm": algorithm,
        **{f"picture's {name}": value for name, value in capture_parts(job, picture).items()},
        **{f"display {name}": value for name, value in job.plan.display.given().items()},
        "panel pixels": job.observed,
        "generators": code_digest("generators", "regression/reference_eia.py", *_SHARED),
        "compiler": versions(("llvmlite", "numba", "numpy")),
    }


def look_parts(job: Ledger) -> dict[str, Any]:
    """What decides a look at any EIA on the display as it is mounted."""
    s = job.plan.settings
    return {
        **{f"display {name}": value for name, value in job.plan.mounted.given().items()},
        "lens_model": s.lens_model,
        "lens_model's package": foreign_identity(s.lens_model),
        "view_pixels_per_lens": s.view_pixels_per_lens,
        "reconstruction_spp": s.reconstruction_spp,
        "seed": s.seed,
        **_renderer(job),
    }


def score_parts() -> dict[str, Any]:
    """What decides scores, beside the pictures."""
    packages = ("flip-evaluator", "numpy", "scikit-image", "scipy")
    return {"program": code_digest(*_SCORING), "packages": versions(packages)}


def _renderer(job: Ledger) -> dict[str, Any]:
    backend = job.backend
    return {
        "program": code_digest(*_RENDERING),
        "packages": versions(("drjit", "mitsuba", "numpy", "OpenEXR", "trimesh")),
        "backend": [backend.variant, backend.libllvm_version, backend.device],
    }
