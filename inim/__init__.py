"""Simulation of integral-imaging displays: render, generate, reconstruct, score.

Importing this package loads no large package and sets no renderer variant; each name below is
loaded when first used.
"""

from __future__ import annotations

from inim.apps import FUNCTIONS
from inim.system.version import __version__

# A program that imports nothing else here heeds signals some milliseconds earlier.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from inim.apps.export.export import export as export
    from inim.apps.inspect.findings import inspect as inspect
    from inim.apps.own_picture.stream import CameraFit as CameraFit
    from inim.apps.pickup.elemental_images import pickup as pickup
    from inim.apps.sweep.run import sweep as sweep
    from inim.display import DISPLAYS as DISPLAYS
    from inim.display import Display as Display
    from inim.display.viewpoint import Viewpoint as Viewpoint
    from inim.generators import generate as generate
    from inim.image.color import to_srgb as to_srgb
    from inim.image.files.image import read_rgbd as read_rgbd
    from inim.image.files.image import save_image as save_image
    from inim.image.rgbd import RGBD as RGBD
    from inim.pipeline.launch import validate as validate
    from inim.pipeline.scene_images import capture as capture
    from inim.pipeline.scene_images import render_eia as render_eia
    from inim.pipeline.scene_images import render_view as render_view
    from inim.render.reconstruct import reconstruct as reconstruct
    from inim.render.scene_files.new_scene import new_scene as new_scene
    from inim.render.variant import register_plugins as register_plugins
    from inim.report import Report as Report
    from inim.report.score_table import compare_algorithms as compare_algorithms
    from inim.scores.metrics import score as score

_HOME = {
    "DISPLAYS": "inim.display",
    "Display": "inim.display",
    "RGBD": "inim.image.rgbd",
    "Report": "inim.report",
    "Viewpoint": "inim.display",
    "capture": "inim.pipeline.scene_images",
    "compare_algorithms": "inim.report.score_table",
    "generate": "inim.generators",
    "new_scene": "inim.render.scene_files.new_scene",
    "read_rgbd": "inim.image.files.image",
    "reconstruct": "inim.render.reconstruct",
    "register_plugins": "inim.render.variant",
    "render_eia": "inim.pipeline.scene_images",
    "render_view": "inim.pipeline.scene_images",
    "save_image": "inim.image.files.image",
    "score": "inim.scores.metrics",
    "to_srgb": "inim.image.color",
    "validate": "inim.pipeline.launch",
    **FUNCTIONS,
}

__all__ = [
    "DISPLAYS",
    "RGBD",
    "Display",
    "Report",
    "Viewpoint",
    "__version__",
    "capture",
    "compare_algorithms",
    "generate",
    "new_scene",
    "read_rgbd",
    "reconstruct",
    "register_plugins",
    "render_eia",
    "render_view",
    "save_image",
    "score",
    "to_srgb",
    "validate",
    *FUNCTIONS,
]


if not TYPE_CHECKING:  # a checker would accept any name

    def __getattr__(name: str) -> Any:
        if name not in _HOME:
            raise AttributeError(f"module 'inim' has no attribute {name!r}")
        from importlib import import_module

        value = getattr(import_module(_HOME[name]), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
