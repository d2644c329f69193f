"""Compare views of a realistic panel with those of an ideal panel.

    python -m reports.panel.run scenes/amphora.xml -o reports/panel

The ground-truth EIA is on the panel, and an eye on the axis looks through the scene's lenses. Each
row changes one property of the display. Diffraction is not part of any lens model: here its pattern
on the panel blurs the EIA. Scores are not corrected for noise; all views have the same samples.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import convolve1d

import inim
from inim.apps.inspect.geometry import COVER_GLASS, diffraction_px
from inim.display import Display
from inim.display.layers import excess_mm
from inim.image.noisy_image import NoisyImage
from inim.pipeline.plan import make_plan
from inim.pipeline.request import Request
from inim.pipeline.stages.capture import capture_relic
from inim.pipeline.stages.ground_truth import render_ground_truth_eia, render_view
from inim.pipeline.stages.reconstruction import reconstruct_views
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.stages.stage import Run
from inim.scores.metrics import relic_region
from inim.scores.metrics.ssim import ssim
from inim.system.process.observer import Observer

ALGORITHM = "template"
# Panel pixels to either side that the pattern of diffraction reaches: 99.9 % of the light.
_REACH_PX = 8
_STEPS_PER_PX = 2000


@dataclass(frozen=True)
class Effect:
    """Property of a display that the ideal one does not have.

    `changes` are its parameters; `new_eia` is True if the ground-truth EIA is rendered for them;
    `gap_error_mm` is a wrong gap that the EIA does not take into account.
    """

    name: str
    changes: Mapping[str, Any]
    new_eia: bool = False
    gap_error_mm: float = 0.0
    diffracted: bool = False


GLASS = {"layers": COVER_GLASS}
EFFECTS = (
    Effect("black level 1:1000", {"black_level": 0.001}),
    Effect("reflected room light, 0.1 % of white", {"ambient_reflection": 0.001}),
    Effect("reflected room light, 1 % of white", {"ambient_reflection": 0.01}),
    Effect("veiling glare, 1 %", {"veiling_glare": 0.01}),
    Effect("white point 9300 K", {"white_point_k": 9300.0}),
    Effect("RGB stripes", {"subpixels": "rgb-stripe"}),
    Effect("RGB stripes, EIA rendered for them", {"subpixels": "rgb-stripe"}, new_eia=True),
    Effect("dispersion of PMMA, Abbe number 57.4", {"abbe_number": 57.4}),
    Effect("diffraction", {}, diffracted=True),
    Effect("0.5 mm of cover glass, part of the gap", GLASS),
    Effect("0.5 mm of cover glass, forgotten", GLASS, gap_error_mm=-excess_mm(COVER_GLASS)),
)


class Bench:
    """The scene's ground truth and the views of displays, in a run of the pipeline."""

    def __init__(self, scene: Path, viewpoint: str = "centre") -> None:
        self.plan = make_plan(Request(scene, Path("out/panel"), viewpoints=(viewpoint,)))
        self.run = Run()
        self.renderer = Renderer(self.plan.request.backend, Observer(), self.plan.rays_in_flight)
        self.camera = self.plan.camera(self.renderer)
        self.rgbd = capture_relic(self.camera, self.plan.inputs, run=self.run).rgbd
        self.eia = self.true_eia(self.plan.display)
        s = self.plan.settings
        sampling = (s.view_pixels_per_lens, s.view_spp, s.seed)
        scene_view, relic = render_view(
            self.camera.scene, self.plan.viewpoints[0], *sampling, run=self.run
        )
        self.scene_view, self.relic = scene_view.image, relic_region(relic)
        self.ideal = self.view(self.eia, self.plan.display)

    @cached_property
    def template(self) -> np.ndarray:
        """EIA of the generator."""
        return inim.generate(self.rgbd, self.plan.display, ALGORITHM)

    def true_eia(self, display: Display) -> np.ndarray:
        """Ground-truth EIA of a display."""
        s, scene = self.plan.settings, self.camera.scene
        return render_ground_truth_eia(scene, display, s.eia_spp, s.seed, None, run=self.run).image

    def view(self, eia: np.ndarray, display: Display) -> np.ndarray:
        """View of an EIA as the viewer sees it."""
        optics, eye = replace(self.plan.optics, display=display), self.plan.viewpoints[0]
        image = NoisyImage.from_image(eia, np.zeros_like(eia))
        views = reconstruct_views("view", image, [eye], optics, self.renderer, run=self.run)
        return views[eye.name].image

    def score(self, effect: Effect) -> dict[str, Any]:
        """SSIM with an effect: to the ideal view, to the scene, and of a generator's EIA."""
        design = self.plan.display
        display = design.with_fixed_panel().replace(
            gap_mm=design.gap_mm + effect.gap_error_mm, **effect.changes
        )
        true_eia = self.true_eia(display) if effect.new_eia else self.eia
        eias = [true_eia, self.template]
        if effect.diffracted:
            eias = [diffract(eia, display) for eia in eias]
        reference, template = (self.view(eia, display) for eia in eias)
        return {
            "effect": effect.name,
            "to_ideal_on_relic": ssim(self.ideal, reference, self.relic),
            "to_ideal": ssim(self.ideal, reference),
            "to_scene_on_relic": ssim(self.scene_view, reference, self.relic),
            "template_to_reference_on_relic": ssim(reference, template, self.relic),
        }


def diffract(eia: np.ndarray, display: Display) -> np.ndarray:
    """EIA with each pixel's light spread by the diffraction of a lens's square aperture.

    Along each axis, the share of a pixel's light at another is the integral of the pattern, sinc^2,
    times the overlap of the two pixels.
    """
    first_zero_px = diffraction_px(display)
    x = np.linspace(-_REACH_PX - 1, _REACH_PX + 1, 2 * (_REACH_PX + 1) * _STEPS_PER_PX + 1)
    pattern = np.sinc(x / first_zero_px) ** 2
    offsets = np.arange(-_REACH_PX, _REACH_PX + 1)
    shares = np.array([(pattern * np.maximum(1 - np.abs(x - k), 0)).sum() for k in offsets])
    shares /= shares.sum()
    blurred: np.ndarray = eia
    for axis in (0, 1):
        blurred = convolve1d(blurred, shares.astype(np.float32), axis, mode="constant")
    return blurred


def write_page(data: Mapping[str, Any]) -> str:
    """Markdown page of the scores."""
    lines = [
        "# A realistic panel",
        "",
        f"Made by `python -m reports.panel.run {data['scene']} -o reports/panel`.",
        "",
        f"SSIM of the view on the axis through `{data['lens_model']}` lenses, on the relic unless",
        "stated. *Ideal view*: the ground-truth EIA on an ideal panel. *Scene*: the rendered view.",
        "*Reference*: the view of the ground-truth EIA with the same effect, compared with that of",
        "`template`. Scores are not corrected for noise.",
        "",
        "| effect | to the ideal view | whole view | to the scene | template to the reference |",
        "| --- | --: | --: | --: | --: |",
    ]
    keys = (
        *("to_ideal_on_relic", "to_ideal"),
        *("to_scene_on_relic", "template_to_reference_on_relic"),
    )
    lines += [
        f"| {row['effect']} | {' | '.join(f'{row[key]:.3f}' for key in keys)} |"
        for row in data["rows"]
    ]
    lines += [
        "",
        f"Diffraction spreads light by {data['diffraction_px']:.3f} panel pixels. Glass that is",
        "part of the gap leaves its air equivalent unchanged; forgotten glass shortens it.",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Score all effects and write the page and its data."""
    parser = argparse.ArgumentParser(prog="python -m reports.panel.run")
    parser.add_argument("scene", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    args = parser.parse_args()
    bench = Bench(args.scene)
    ideal = Effect("none", {})
    data = {
        "scene": args.scene.as_posix(),
        "lens_model": bench.plan.settings.lens_model,
        "diffraction_px": diffraction_px(bench.plan.display),
        "rows": [bench.score(effect) for effect in (ideal, *EFFECTS)],
    }
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "panel.json").write_text(json.dumps(data, indent=1) + "\n", "utf-8")
    (args.out / "panel.md").write_text(write_page(data), "utf-8")


if __name__ == "__main__":
    main()
