"""Simulation of integral-imaging displays: render, generate, reconstruct, score.

Importing this package loads no large package and sets no renderer variant; each name below is
loaded when first used.
"""

from __future__ import annotations

from inim.version import __version__

# A program that imports nothing else here heeds signals some milliseconds earlier.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from inim.display import DISPLAYS as DISPLAYS
    from inim.display import Display as Display
    from inim.display.viewpoint import Viewpoint as Viewpoint
    from inim.files.image import read_rgbd as read_rgbd
    from inim.generators import generate as generate
    from inim.image.rgbd import RGBD as RGBD
    from inim.pipeline.launch import validate as validate
    from inim.render.reconstruct import reconstruct as reconstruct
    from inim.render.variant import register_plugins as register_plugins
    from inim.report import Report as Report

_HOME = {
    "DISPLAYS": "inim.display",
    "Display": "inim.display",
    "RGBD": "inim.image.rgbd",
    "Report": "inim.report",
    "Viewpoint": "inim.display",
    "generate": "inim.generators",
    "read_rgbd": "inim.files.image",
    "reconstruct": "inim.render.reconstruct",
    "register_plugins": "inim.render.variant",
    "validate": "inim.pipeline.launch",
}

__all__ = [*_HOME, "__version__"]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'inim' has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
