"""What an eye sees when a display shows an EIA."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from inim.display import Display
from inim.errors import UsageError
from inim.kernel import variant
from inim.kernel.display_emitter import display_shape
from inim.kernel.sensors import eye_rays, make_sensor
from inim.kernel.trace import radiance
from inim.lens import check_lens_model
from inim.viewpoint import Viewpoint, check_viewpoint

__all__ = ["DisplayScene", "reconstruct"]


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
        Must lie inside the viewing zone.
    lens_model : {"thick", "pinhole"}
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


class DisplayScene:
    """A display showing one EIA, ready to be looked at from many viewpoints.

    Parameters are those of `reconstruct`.
    """

    def __init__(self, eia: np.ndarray, display: Display, lens_model: str) -> None:
        if eia.shape != (*display.eia_shape, 3):
            raise UsageError(
                f"EIA of shape {eia.shape}; display {display.name} needs {(*display.eia_shape, 3)}"
            )
        check_lens_model(lens_model, display)
        self.display = display
        self._scene = mi.load_dict(
            {"type": "scene", "display": display_shape(eia, display, lens_model)}
        )
        # Nothing scatters: what the eye sees is the emitter itself.
        self._integrator = mi.load_dict({"type": "path", "max_depth": 1})

    def view(
        self,
        viewpoint: Viewpoint,
        *,
        pixels_per_lens: int,
        spp: int,
        seed: int,
        clock: Any = None,
        progress: Any = None,
    ) -> np.ndarray:
        """One view, (rows, columns, 3) float32; see `reconstruct`."""
        # Rays start a little in front of the array, not at the eye: coordinates stay small.
        rays = eye_rays(self.display, viewpoint.position_mm, pixels_per_lens, self.display.pitch_mm)
        sensor = make_sensor(rays, np.eye(4))
        return radiance(
            self._scene,
            self._integrator,
            sensor,
            spp=spp,
            seed=seed,
            clock=clock,
            progress=progress,
        )
