"""Cost of a view with each lens model, relative to a textured rectangle in the stock renderer.

    python -m reports.bench.views.run -o reports/bench/views

The rectangle has the smallest cost of any view of a panel.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from inim.apps.bench.page import milliseconds
from inim.display import Display
from inim.display.lens import FULL
from inim.display.viewpoint import parse_viewpoints
from inim.pipeline.timing import Rounds, Timing, ratios, threads, time_calls
from inim.render.scene_files.two_spheres import two_spheres_eia
from inim.report.labels import number, per_cent
from inim.report.study import PagePart
from reports.bench.study import add_rounds, doubts, rounds_of, square_display, times
from reports.study import Results, Study, entry, table

RECTANGLE = "textured rectangle"
_MODELS = ("pinhole", "thin", "thick")
# Renders a view with a seed.
Render = Callable[[int], np.ndarray]

# The mesh of `full` takes seconds per view, the others tenths of a second. Time is proportional to
# the number of samples.
_FULL_SPP = 8


def bench_views(
    rounds: Rounds,
    lenses: int = 64,
    pixels_per_lens: int = 8,
    spp: int = 64,
    full_spp: int = _FULL_SPP,
) -> dict[str, Any]:
    """Time one view of the two spheres with each lens model, alternating with the rectangle.

    The display has `lenses` along a side, 17 pixels each; `full_spp` are the samples per pixel of
    the `full` model, whose time is scaled up to `spp`. `view_ms` is a model's time at `spp`;
    `ratio` and `thick_ratio` are this time divided by that of the rectangle and of `thick`; `noise`
    is the standard deviation of one sample of a view pixel, rms over the view; `equal_noise_ms` is
    the time in which `full` reaches the noise of `thick`.
    """
    from inim.render.reconstruct import DisplayScene

    display = square_display(lenses)
    eye = parse_viewpoints("centre", display)[0]
    eia = two_spheres_eia(display)

    def renderer(model: str) -> Render:
        scene = DisplayScene(eia, display, model)
        count = full_spp if model == FULL else spp
        return lambda seed: scene.view(eye, pixels_per_lens=pixels_per_lens, spp=count, seed=seed)

    renders: dict[str, Render] = {
        RECTANGLE: textured_rectangle(eia, display, eye.z_mm, pixels_per_lens, spp)
    }
    renders |= {model: renderer(model) for model in _MODELS}
    with threads(rounds.threads):
        timings = time_calls(_calls(renders), rounds)
        # Separately, alternating with `thick`: while the mesh exists, the renderer compiles its
        # lights and materials into the kernel of every scene.
        renders[FULL] = renderer(FULL)
        full_timings = time_calls(_calls({name: renders[name] for name in ("thick", FULL)}), rounds)
    noise = {name: _noise(render) * spp**0.5 for name, render in renders.items()}
    noise[FULL] *= (full_spp / spp) ** 0.5
    models = [
        _times(name, timing, spp, spp)
        | ratios(timing, timings[RECTANGLE])
        | {"thick_ratio": ratios(timing, timings["thick"])["ratio"]}
        for name, timing in timings.items()
    ]
    models.append(_full_times(full_timings, models[-1], full_spp, spp))
    for model in models:
        model |= {"noise": noise[model["name"]], "equal_noise_ms": None}
    # The number of samples for equal noise is proportional to the noise squared.
    sample_ratio = (noise[FULL] / noise["thick"]) ** 2
    models[-1]["equal_noise_ms"] = models[-1]["view_ms"] * sample_ratio
    return {
        "rows": lenses * pixels_per_lens,
        "columns": lenses * pixels_per_lens,
        "spp": spp,
        "algorithms": models,
    }


def textured_rectangle(
    picture: np.ndarray, display: Display, distance_mm: float, pixels_per_lens: int, spp: int
) -> Render:
    """Function that renders a luminous picture of the lens array's size, seen from the front.

    This is the smallest cost of any view of a panel: one camera ray per sample, each with one
    intersection and one texel, and the stock film. It has no lens and uses no code of this project.
    """
    import mitsuba as mi

    half_x, half_y = display.width_mm / 2, display.height_mm / 2
    bitmap = mi.Bitmap(np.ascontiguousarray(picture[::-1], np.float32))
    texture = {"type": "bitmap", "bitmap": bitmap, "raw": True, "filter_type": "nearest"}
    film = {
        "type": "hdrfilm", "rfilter": {"type": "box"},
        "component_format": "float32", "pixel_format": "rgb",
        "width": display.lens_columns * pixels_per_lens,
        "height": display.lens_rows * pixels_per_lens,
    }  # fmt: skip
    scene = mi.load_dict(
        {
            "type": "scene",
            # As for views of a display: only directly visible light.
            "integrator": {"type": "path", "max_depth": 1},
            "rectangle": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().scale([half_x, half_y, 1]),
                "emitter": {"type": "area", "radiance": texture},
            },
            "camera": {
                "type": "perspective",
                "fov": math.degrees(2 * math.atan(half_x / distance_mm)),
                "fov_axis": "x",
                "to_world": mi.ScalarTransform4f().look_at(
                    [0, 0, distance_mm], [0, 0, 0], [0, 1, 0]
                ),
                "film": film,
            },
        }
    )
    return lambda seed: np.asarray(mi.render(scene, spp=spp, seed=seed))


def _calls(renders: Mapping[str, Render]) -> dict[str, Callable[[], Any]]:
    return {name: partial(render, 0) for name, render in renders.items()}


def _noise(render: Render) -> float:
    """Standard deviation of a view pixel, from two views with different seeds, as an rms."""
    difference = render(1).astype(np.float64) - render(2)
    return float(np.sqrt((difference**2).mean() / 2))


def _times(name: str, timing: Timing, timed_spp: int, spp: int) -> dict[str, Any]:
    view_ms = 1e3 * timing.median_s * spp / timed_spp
    return {"name": name, "spp": timed_spp, **timing.as_data(), "view_ms": view_ms}


def _full_times(
    timings: Mapping[str, Timing], thick: Mapping[str, Any], timed_spp: int, spp: int
) -> dict[str, Any]:
    """Times of `full`, timed with `thick`; its ratio to the rectangle is the product of ratios."""
    to_thick = {
        key: ratio * spp / timed_spp
        for key, ratio in ratios(timings[FULL], timings["thick"]).items()
    }
    to_rectangle = {key: ratio * thick[key] for key, ratio in to_thick.items()}
    full = _times(FULL, timings[FULL], timed_spp, spp)
    return full | to_rectangle | {"thick_ratio": to_thick["ratio"]}


def page(results: Results) -> tuple[list[str], list[PagePart]]:
    """Remarks and the table of views."""
    views = results["views"]
    remarks = [
        "One view of the two spheres on 64 × 64 lenses. The rectangle has the same picture as its "
        "texture and uses the stock camera, integrator and film. The noise of a sample is the "
        "root mean square standard deviation of a view pixel with one sample.",
        "Views were timed alternating with the textured rectangle. The mesh of `full` was timed "
        "separately, alternating with `thick`: while it exists, the renderer compiles its lights "
        "and materials into the kernel of every scene.",
    ]
    columns = {
        "lens model": entry("name"),
        "ms per view": entry("view_ms", text=milliseconds),
        "× rectangle": entry("ratio", text=times),
        "by fastest": entry("ratio_min", text=times),
        "× thick": entry("thick_ratio", text=times),
        "samples timed": entry("spp"),
        "ms as timed": entry("median_ms", text=milliseconds),
        "spread": lambda c: f"± {per_cent(c['spread'], 1)}",
        "runs": entry("runs"),
        "noise of a sample": entry("noise", text=partial(number, digits=4)),
        "ms at the noise of thick": entry("equal_noise_ms", text=milliseconds),
    }
    caption = (
        f"One view of {views['columns']} × {views['rows']} pixels with {views['spp']} samples "
        "each; times of fewer samples are scaled up"
    )
    tables = [table(caption, views["algorithms"], columns)]
    return remarks, [PagePart("views", "Views", "", tables)]


def measure(**rounds: Any) -> dict[str, Any]:
    """Measure with the renderer on the processor."""
    from inim.render import variant

    variant.use("llvm")
    return bench_views(Rounds(**rounds))


STUDY = Study(
    "reports.bench.views.run", "Bench: views", __doc__, add_rounds,
    lambda args: {"views": rounds_of(args)}, measure, page,
    code=("inim/display", "inim/render", "inim/pipeline/timing.py"), stem="bench", doubts=doubts,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.main())
