"""What a view costs by each lens model, against a textured rectangle by the stock renderer.

    python -m reports.bench.views.run -o reports/bench/views

The rectangle is the least that any view of a panel costs.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from inim.display.viewpoint import parse_viewpoints
from inim.lens import FULL
from inim.report.bench import milliseconds, times
from inim.report.labels import number, per_cent
from inim.report.study import PagePart, Table
from inim.scene.two_spheres import two_spheres_eia
from inim.timing import Rounds, Timing, ratios, threads, time_calls
from reports.bench.parts import items, part
from reports.bench.study import new_parser, run_study, square_display

RECTANGLE = "textured rectangle"
_MODELS = ("pinhole", "thin", "thick")
# Renders a view with a seed.
Render = Callable[[int], np.ndarray]

# The mesh takes seconds for what the others do in tenths; its time is proportional to its samples.
_FULL_SPP = 8


def bench_views(
    rounds: Rounds,
    listener: Any,
    lenses: int = 64,
    pixels_per_lens: int = 8,
    spp: int = 64,
    full_spp: int = _FULL_SPP,
) -> dict[str, Any]:
    """Time one view of the two spheres by each lens model, all in turn with the rectangle.

    Parameters
    ----------
    rounds : Rounds
    listener : Observer
    lenses : int
        Along a side, 17 pixels each.
    pixels_per_lens, spp : int
        Of the view.
    full_spp : int
        Of the `full` model, whose time is scaled up to `spp`.

    Returns
    -------
    dict
        Under the names of bench.json. `view_ms` is a model's time at `spp`, `ratio` that in
        times of the rectangle, `thick_ratio` in times of `thick`; `noise` is the standard deviation
        of one sample of a view pixel, rms over the view, and `equal_noise_ms` the time in which
        `full` would reach the noise of `thick`.
    """
    from inim.render.reconstruct import DisplayScene
    from reports.bench.views.rectangle import TexturedRectangle

    listener.stage("views: get ready")
    display = square_display(lenses)
    eye = parse_viewpoints("centre", display)[0]
    eia = two_spheres_eia(display)
    rectangle = TexturedRectangle(eia, display, eye.z_mm, pixels_per_lens)

    def renderer(model: str) -> Render:
        shown = DisplayScene(eia, display, model)
        count = full_spp if model == FULL else spp
        return lambda seed: shown.view(eye, pixels_per_lens=pixels_per_lens, spp=count, seed=seed)

    renders: dict[str, Render] = {RECTANGLE: lambda seed: rectangle.view(spp, seed)}
    renders |= {model: renderer(model) for model in _MODELS}
    listener.stage("views: time")
    with threads(rounds.threads):
        timings = time_calls(_calls(renders), rounds)
        # Apart, against `thick`: while the mesh is there, the renderer compiles its lights and
        # materials into every scene's kernel.
        renders[FULL] = renderer(FULL)
        apart = time_calls(_calls({name: renders[name] for name in ("thick", FULL)}), rounds)
    noise = {name: _noise(render) * spp**0.5 for name, render in renders.items()}
    noise[FULL] *= (full_spp / spp) ** 0.5
    models = [_times(timings[name], spp, spp) | {"name": name} for name in timings]
    for found in models:
        found |= ratios(timings[found["name"]], timings[RECTANGLE])
        found["thick_ratio"] = ratios(timings[found["name"]], timings["thick"])["ratio"]
    models.append(_full(apart, models[-1], full_spp, spp))
    for found in models:
        found |= {"noise": noise[found["name"]], "equal_noise_ms": None}
        listener.line(
            f"{found['name']:{len(RECTANGLE)}}  {found['view_ms']:9.2f} ms  "
            f"{found['ratio']:7.2f} rectangles  {found['noise']:.4f} noise of a sample"
        )
    # Samples for equal noise go with the noise's square.
    equal = (noise[FULL] / noise["thick"]) ** 2
    models[-1]["equal_noise_ms"] = models[-1]["view_ms"] * equal
    return {
        "display": {"parameters": display.parameters(), "derived": display.derived_quantities()},
        "rows": lenses * pixels_per_lens,
        "columns": lenses * pixels_per_lens,
        "spp": spp,
        "algorithms": models,
    }


def _calls(renders: Mapping[str, Render]) -> dict[str, Callable[[], Any]]:
    return {name: partial(render, 0) for name, render in renders.items()}


def _noise(render: Render) -> float:
    """Standard deviation of a view pixel, from two views of unlike seeds, rms over the view."""
    apart = render(1).astype(np.float64) - render(2)
    return float(np.sqrt((apart**2).mean() / 2))


def _times(timing: Timing, taken: int, spp: int) -> dict[str, Any]:
    return {"spp": taken, **timing.as_data(), "view_ms": 1e3 * timing.median_s * spp / taken}


def _full(
    apart: Mapping[str, Timing], thick: Mapping[str, Any], taken: int, spp: int
) -> dict[str, Any]:
    """The mesh's time in turn with `thick`, and by way of it in times of the rectangle."""
    found = {"name": FULL, **_times(apart[FULL], taken, spp)}
    to_thick = ratios(apart[FULL], apart["thick"])
    for key, value in to_thick.items():
        found[key] = value * spp / taken * thick[key]
    found["thick_ratio"] = to_thick["ratio"] * spp / taken
    return found


# -- the report ---------------------------------------------------------------------------------


def parts_of(data: Mapping[str, Any]) -> list[PagePart]:
    """The table of views."""
    lead = (
        "One view of the two spheres on 64 × 64 lenses. The rectangle has the same picture for "
        "its texture, and is rendered by the stock camera, integrator and film. The noise of a "
        "sample is what it adds to a view pixel, root mean square."
    )
    remark = (
        "Views: in turn with the textured rectangle; the mesh of `full` apart, in turn with "
        "`thick`: while it is there, the renderer compiles its lights and materials into every "
        "scene's kernel."
    )
    return [PagePart("views", "Views", lead, [_table(part(data, "views"))], remarks=[remark])]


def _table(views: Mapping[str, Any]) -> Table:
    heads = [
        "lens model", "ms per view", "rectangles", "by fastest", "times thick", "samples timed",
        "ms as timed",
        "spread", "runs", "noise of a sample", "ms at the noise of thick",
    ]  # fmt: skip
    rows = [
        [
            c["name"],
            milliseconds(c["view_ms"]),
            times(c["ratio"]),
            times(c["ratio_min"]),
            times(c["thick_ratio"]),
            str(c["spp"]),
            milliseconds(c["median_ms"]),
            f"± {per_cent(c['spread'], 1)}",
            str(c["runs"]),
            number(c["noise"], 4),
            milliseconds(c["equal_noise_ms"]),
        ]
        for c in items(views, "algorithms")
    ]
    caption = (
        f"One view of {views['columns']} × {views['rows']} pixels, {views['spp']} samples each "
        "(fewer timed: scaled up)"
    )
    return Table(caption, heads, rows)


# -- the command --------------------------------------------------------------------------------


def main() -> int:
    """Carry out the study; the exit code."""
    args = new_parser(__doc__, "bench-views").parse_args()
    return run_study(args, "reports.bench.views.run", "Bench: views", _measure, parts_of)


def _measure(rounds: Rounds, listener: Any, folder: Path) -> dict[str, Any]:  # noqa: ARG001
    return {"views": bench_views(rounds, listener)}


if __name__ == "__main__":
    sys.exit(main())
