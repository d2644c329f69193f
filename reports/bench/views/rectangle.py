"""What views are measured by: a rectangle with the EIA for its texture, by the stock renderer.

The least that any view of a panel costs: as many camera rays as the view has samples, one
intersection and one texel each, the stock film; no lens, and nothing of this program.
"""

from __future__ import annotations

import math

import mitsuba as mi
import numpy as np

from inim.display import Display


class TexturedRectangle:
    """A glowing picture of a display's size, seen from straight ahead.

    Parameters
    ----------
    picture : (rows, columns, 3) float32
    display : Display
        Its array's size is the rectangle's.
    distance_mm : float
        Of the camera, whose frame the rectangle fills across.
    pixels_per_lens : int
        Resolution of the view, as of a reconstruction.
    """

    def __init__(
        self, picture: np.ndarray, display: Display, distance_mm: float, pixels_per_lens: int
    ) -> None:
        half_x, half_y = display.width_mm / 2, display.height_mm / 2
        texture = {
            "type": "bitmap",
            "bitmap": mi.Bitmap(np.ascontiguousarray(picture[::-1], np.float32)),
            "raw": True,
            "filter_type": "nearest",
        }
        self._scene = mi.load_dict(
            {
                "type": "scene",
                # As views of a display: what the camera sees is the light itself.
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
                    "film": {
                        "type": "hdrfilm",
                        "width": display.lens_columns * pixels_per_lens,
                        "height": display.lens_rows * pixels_per_lens,
                        "rfilter": {"type": "box"},
                        "component_format": "float32",
                        "pixel_format": "rgb",
                    },
                },
            }
        )

    def view(self, spp: int, seed: int) -> np.ndarray:
        """One rendering, (rows, columns, 3) float32, on the host."""
        picture: np.ndarray = np.asarray(mi.render(self._scene, spp=spp, seed=seed))
        return picture
