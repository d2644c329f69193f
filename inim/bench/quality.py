"""How wrong a picture is, in three ways: its sources, its EIA, what the viewer sees of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from inim import metrics
from inim.bench.contenders import (
    Contender,
    hole_share,
    linear_picture,
    wrong_source_share,
)
from inim.display import Display, Viewpoint
from inim.generators import Sources, find_sources
from inim.lens import white_exposure
from inim.rgbd import RGBD
from inim.settings import Settings

__all__ = ["Judge", "Looks", "make_judge"]


@dataclass(frozen=True)
class Looks:
    """How EIAs are looked at.

    Attributes
    ----------
    display : Display
    viewpoints : sequence of Viewpoint
    lens_model : str
    pixels_per_lens, spp, seed : int
    """

    display: Display
    viewpoints: Sequence[Viewpoint]
    lens_model: str = "thick"
    pixels_per_lens: int = 4
    spp: int = 64
    seed: int = 0

    @classmethod
    def of(cls, display: Display, viewpoints: Sequence[Viewpoint], settings: Settings) -> Looks:
        """As validation does with these settings."""
        return cls(
            display,
            viewpoints,
            settings.lens_model,
            settings.view_pixels_per_lens,
            settings.reconstruction_spp,
            settings.seed,
        )

    def at(self, eia: np.ndarray) -> list[np.ndarray]:
        """Views of an EIA, exposed so that the panel's white looks white."""
        from inim.render.reconstruct import DisplayScene

        exposure = white_exposure(self.display, self.lens_model)
        shown = DisplayScene(eia, self.display, self.lens_model)
        sampling: dict[str, Any] = {
            "pixels_per_lens": self.pixels_per_lens,
            "spp": self.spp,
            "seed": self.seed,
        }
        return [shown.view(v, **sampling) * exposure for v in self.viewpoints]


@dataclass(frozen=True)
class Judge:
    """What pictures are compared with.

    Attributes
    ----------
    rgbd : RGBD
        Display-ready.
    exact : Sources
        By the exact traversal.
    eia : (rows, columns, 3) float32
        Ground truth, linear RGB.
    looks : Looks
    ceiling : list of array
        Views of the ground-truth EIA.
    """

    rgbd: RGBD
    exact: Sources
    eia: np.ndarray
    looks: Looks
    ceiling: list[np.ndarray]

    def errors(self, contender: Contender) -> dict[str, Any]:
        """Errors of the very picture that was timed, under the names of bench.json."""
        made = linear_picture(contender.out)
        sources = contender.sources()
        return {
            "wrong_source": wrong_source_share(sources, self.exact),
            "hole_fraction": hole_share(sources, contender.out, self.exact),
            "averaged_share": contender.averaged_share(),
            "eia_ssim": metrics.ssim(self.eia, made),
            "eia_psnr_db": metrics.psnr_db(self.eia, made),
            "view_ssim_to_ceiling": self.view_ssim(self.looks.at(made)),
        }

    def noise_floor(self, first: np.ndarray, second: np.ndarray) -> dict[str, float]:
        """One half of the ground truth's samples against the other, by the same measures."""
        seen = zip(self.looks.at(first), self.looks.at(second), strict=True)
        return {
            "eia_ssim": metrics.ssim(first, second),
            "eia_psnr_db": metrics.psnr_db(first, second),
            "view_ssim_to_ceiling": float(np.mean([metrics.ssim(a, b) for a, b in seen])),
        }

    def view_ssim(self, views: Sequence[np.ndarray]) -> float:
        """Mean SSIM to the ceiling over the viewpoints."""
        pairs = zip(self.ceiling, views, strict=True)
        return float(np.mean([metrics.ssim(reference, view) for reference, view in pairs]))


def make_judge(rgbd: RGBD, eia: np.ndarray, looks: Looks) -> Judge:
    """A judge of pictures made from a display-ready RGB-D picture."""
    exact = find_sources(rgbd, looks.display, "template")
    return Judge(rgbd, exact, eia, looks, looks.at(eia))
