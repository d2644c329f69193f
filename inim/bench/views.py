"""What a view costs by each lens model, against a textured rectangle by the stock renderer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from inim.bench.scaling import square_display
from inim.display.viewpoint import parse_viewpoints
from inim.lens import FULL
from inim.pipeline.timing import Rounds, Timing, in_turn, ratios, threads
from inim.scene.two_spheres import two_spheres_eia

__all__ = ["RECTANGLE", "bench_views"]

RECTANGLE = "textured rectangle"
_MODELS = ("pinhole", "thin", "thick")
# A view from a seed.
Look = Callable[[int], np.ndarray]

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
        Under the names of bench.json. `view_ms` is a contender's time at `spp`, `ratio` that in
        times of the rectangle, `thick_ratio` in times of `thick`; `noise` is the standard deviation
        of one sample of a view pixel, rms over the view, and `equal_noise_ms` the time in which
        `full` would reach the noise of `thick`.
    """
    from inim.render.reconstruct import DisplayScene
    from inim.render.view_reference_kernel import TexturedRectangle

    listener.stage("views: get ready")
    display = square_display(lenses)
    eye = parse_viewpoints("centre", display)[0]
    eia = two_spheres_eia(display)
    rectangle = TexturedRectangle(eia, display, eye.z_mm, pixels_per_lens)

    def looking(model: str) -> Look:
        shown = DisplayScene(eia, display, model)
        count = full_spp if model == FULL else spp
        return lambda seed: shown.view(eye, pixels_per_lens=pixels_per_lens, spp=count, seed=seed)

    looks: dict[str, Look] = {RECTANGLE: lambda seed: rectangle.view(spp, seed)}
    looks |= {model: looking(model) for model in _MODELS}
    listener.stage("views: time")
    with threads(rounds.threads):
        times = in_turn(_calls(looks), rounds)
        # Apart, against `thick`: while the mesh is there, the renderer compiles its lights and
        # materials into every scene's kernel.
        looks[FULL] = looking(FULL)
        apart = in_turn(_calls({name: looks[name] for name in ("thick", FULL)}), rounds)
    noise = {name: _noise(look) * spp**0.5 for name, look in looks.items()}
    noise[FULL] *= (full_spp / spp) ** 0.5
    contenders = [_contender(times[name], spp, spp) | {"name": name} for name in times]
    for found in contenders:
        found |= ratios(times[found["name"]], times[RECTANGLE])
        found["thick_ratio"] = ratios(times[found["name"]], times["thick"])["ratio"]
    contenders.append(_full(apart, contenders[-1], full_spp, spp))
    for found in contenders:
        found |= {"noise": noise[found["name"]], "equal_noise_ms": None}
        listener.line(
            f"{found['name']:{len(RECTANGLE)}}  {found['view_ms']:9.2f} ms  "
            f"{found['ratio']:7.2f} rectangles  {found['noise']:.4f} noise of a sample"
        )
    # Samples for equal noise go with the noise's square.
    equal = (noise[FULL] / noise["thick"]) ** 2
    contenders[-1]["equal_noise_ms"] = contenders[-1]["view_ms"] * equal
    return {
        "display": {"given": display.given(), "derived": display.derived()},
        "rows": lenses * pixels_per_lens,
        "columns": lenses * pixels_per_lens,
        "spp": spp,
        "contenders": contenders,
    }


def _calls(looks: Mapping[str, Look]) -> dict[str, Callable[[], Any]]:
    return {name: partial(look, 0) for name, look in looks.items()}


def _noise(look: Look) -> float:
    """Standard deviation of a view pixel, from two views of unlike seeds, rms over the view."""
    apart = look(1).astype(np.float64) - look(2)
    return float(np.sqrt((apart**2).mean() / 2))


def _contender(timing: Timing, taken: int, spp: int) -> dict[str, Any]:
    return {"spp": taken, **timing.as_data(), "view_ms": 1e3 * timing.median_s * spp / taken}


def _full(
    apart: Mapping[str, Timing], thick: Mapping[str, Any], taken: int, spp: int
) -> dict[str, Any]:
    """The mesh's time as measured beside `thick`, and by way of it in times of the rectangle."""
    found = {"name": FULL, **_contender(apart[FULL], taken, spp)}
    to_thick = ratios(apart[FULL], apart["thick"])
    for key, value in to_thick.items():
        found[key] = value * spp / taken * thick[key]
    found["thick_ratio"] = to_thick["ratio"] * spp / taken
    return found
