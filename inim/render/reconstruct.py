"""What an eye sees when a display shows an EIA."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from inim.display import Display
from inim.display.viewpoint import Viewpoint, check_viewpoint
from inim.errors import UsageError
from inim.lens import lens_model as find_lens_model
from inim.lens import white_exposure
from inim.observer import Observer
from inim.render import variant
from inim.render.display_emitter import LensedPanel
from inim.render.lens_mesh import LensMesh
from inim.render.rays import eye_rays
from inim.render.sensors import make_sensor
from inim.render.trace import Tracer, mean_light

__all__ = ["DisplayScene", "exposed_views", "observed_pixels", "reconstruct"]


def reconstruct(
    eia: np.ndarray,
    display: Display,
    viewpoint: Viewpoint,
    lens_model: str = "thick",
    *,
    pixels_per_lens: int = 4,
    spp: int = 64,
    seed: int = 0,
    backend: str = "auto",
) -> np.ndarray:
    """The view of a display from one eye position, ray traced through its lens array.

    Parameters
    ----------
    eia : (rows, columns, 3) float array
        Linear RGB, row 0 on top, of the display's `eia_shape`.
    display : Display
    viewpoint : Viewpoint
        Must lie inside the viewing zone, with its pupil.
    lens_model : str
        One of `inim.lens.lens_models`.
    pixels_per_lens : int
        Resolution of the view; it shows exactly the lens array.
    spp : int
        Samples per view pixel; few alias with the lens lattice.
    seed : int
    backend : {"auto", "llvm", "cuda"}

    Returns
    -------
    (lens_rows * pixels_per_lens, lens_columns * pixels_per_lens, 3) float32, linear RGB.

    Raises
    ------
    UsageError, ViewpointError, DisplayError, BackendError
    """
    variant.use(backend)
    check_viewpoint(viewpoint, display)
    scene = DisplayScene(eia, display, lens_model)
    return scene.view(viewpoint, pixels_per_lens=pixels_per_lens, spp=spp, seed=seed)


def exposed_views(
    eia: np.ndarray,
    display: Display,
    viewpoints: Sequence[Viewpoint],
    lens_model: str = "thick",
    *,
    pixels_per_lens: int = 4,
    spp: int = 64,
    seed: int = 0,
) -> list[np.ndarray]:
    """Views of one EIA, exposed so that the panel's white looks white; see `reconstruct`."""
    exposure = white_exposure(display, lens_model)
    shown = DisplayScene(eia, display, lens_model)
    return [
        shown.view(eye, pixels_per_lens=pixels_per_lens, spp=spp, seed=seed) * exposure
        for eye in viewpoints
    ]


def observed_pixels(
    display: Display,
    viewpoints: Sequence[Viewpoint],
    lens_model: str,
    *,
    pixels_per_lens: int,
    spp: int,
    seeds: Sequence[int],
    observer: Observer | None = None,
) -> np.ndarray | None:
    """Panel pixels that the views depend on: those that their very samples come from.

    Other pixels may hold anything, and the views are the same to the bit.

    Parameters
    ----------
    display, viewpoints, lens_model, pixels_per_lens, spp :
        As of the views; see `reconstruct`.
    seeds : ints
        Of all views that will be made.

    Returns
    -------
    (rows, columns) bool, or None
        None for a mesh, whose rays scatter between the lenses.
    """
    model = find_lens_model(lens_model)
    model.check(display)
    if model.trace is None:
        return None
    panel = LensedPanel.dark(display, lens_model)
    rows, columns = display.eia_shape
    marks = dr.zeros(mi.UInt32, rows * columns)

    def light(sensor: Any, pixel: Any, within: Any, pupil: Any, sampler: Any) -> Any:  # noqa: ARG001
        (x, y), (sx, sy) = sensor.lines_through(pixel, within, pupil)
        shares = []
        for place, weight, lit in panel.landings(x, y, sx, sy):
            dr.scatter(marks, mi.UInt32(1), place, lit & (weight > 0))
            shares.append(dr.select(lit, weight, 0.0))
        return mi.Color3f(*(shares * 3)[:3])

    for viewpoint in viewpoints:
        sensor = _sensor(display, viewpoint, pixels_per_lens, AnalyticLens.start_mm)
        for seed in seeds:
            mean_light(Tracer(light, sensor, seed, observer, planned=False), spp)
    return np.asarray(marks).reshape(rows, columns) > 0


def _sensor(display: Display, viewpoint: Viewpoint, pixels_per_lens: int, start_mm: float) -> Any:
    """The sensor of an eye before a display."""
    return make_sensor(eye_rays(display, viewpoint, pixels_per_lens, start_mm), np.eye(4))


class DisplayScene:
    """A display showing one EIA, ready for views from many viewpoints.

    Parameters are those of `reconstruct`.
    """

    def __init__(self, eia: np.ndarray, display: Display, lens_model: str) -> None:
        if eia.shape != (*display.eia_shape, 3):
            raise UsageError(
                f"EIA of shape {eia.shape}; display {display.name} needs {(*display.eia_shape, 3)}"
            )
        model = find_lens_model(lens_model)
        model.check(display)
        self.display = display
        if model.mesh is not None:
            self._shown: LensMesh | AnalyticLens = LensMesh(eia, display, model.mesh(display))
        else:
            self._shown = AnalyticLens(eia, display, lens_model)

    def view(
        self,
        viewpoint: Viewpoint,
        *,
        pixels_per_lens: int,
        spp: int,
        seed: int,
        observer: Observer | None = None,
    ) -> np.ndarray:
        """One view, (rows, columns, 3) float32; see `reconstruct`."""
        sensor = _sensor(self.display, viewpoint, pixels_per_lens, self._shown.start_mm)
        return mean_light(Tracer(self._shown.light, sensor, seed, observer), spp)


class AnalyticLens:
    """An EIA seen through lenses that are a formula.

    There is nothing but the display, so no ray needs a scene to find it: the sensor's rays start
    on the array itself, and the panel says what they bring.
    """

    start_mm = 0.0

    def __init__(self, eia: np.ndarray, display: Display, lens_model: str) -> None:
        self._panel = LensedPanel.of(eia, display, lens_model)

    def light(self, sensor: Any, pixel: Any, within: Any, pupil: Any, sampler: Any) -> Any:
        """See `inim.render.trace.Light`."""
        (x, y), (sx, sy) = sensor.lines_through(pixel, within, pupil)
        return self._panel.leaving(x, y, sx, sy)
