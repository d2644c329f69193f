"""Settings of README's moving picture and of the tutorial's report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class _Eye:
    """Path of the moving eye, and style of the film."""

    scene: str = "scenes/wine_coin.xml"
    algorithm: str = "layered"
    options: tuple[str, ...] = (
        *("--display", "fine", "--algorithms", "layered"),
        *("-D", "inim.view_pixels_per_lens=4"),
        *("-D", "inim.view_spp=64"),
        *("-D", "inim.fit_share=0.78"),
    )
    distance_mm: float = 542.7
    across_mm: float = 54
    up_mm: float = 22
    frames: int = 32
    frame_ms: int = 100
    lens: tuple[int, int] = (39, 46)
    captions: tuple[str, ...] = (
        "the scene", "the panel, magnified", "the panel through its lenses",
    )  # fmt: skip
    quality: int = 80
    # Style.
    space: int = 16
    below: int = 64
    text: int = 18
    ground: str = "#101012"
    ink: str = "#e6e6e6"
    rail: str = "#77777c"
    eye: str = "#f0b44c"
    # The report.
    report_scene: str = "scenes/amphora.xml"
    report_options: tuple[str, ...] = ("--display", "fine")  # the tutorial's command
    report_window: Mapping[str, Any] = field(
        default_factory=lambda: {"width": 1280, "height": 926, "deviceScaleFactor": 1.25}
    )


EYE = _Eye()
