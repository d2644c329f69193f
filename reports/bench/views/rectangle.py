"""Reference for the cost of views: a rectangle textured with the EIA, in the stock renderer.

It has the smallest cost of any view of a panel: one camera ray per sample, each with one
intersection and one texel, and the stock film. It has no lens and uses no code of this project.
"""

from __future__ import annotations

import math

import mitsuba as mi
import numpy as np

from inim.display import Display


class TexturedRectangle:
    """A luminous picture of a display's size, seen from the front.

    Parameters
    ----------
    picture : (rows, columns, 3) float32
    display : Display
        The rectangle has the size of its lens array.
    distance_mm : float
        Distance of the camera. The rectangle fills the width of its image.
    pixels_per_lens : int
        Resolution of the view, as in a reconstruction.
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
        """Render one view, (rows, columns, 3) float32, on the host."""
        picture: np.ndarray = np.asarray(mi.render(self._scene, spp=spp, seed=seed))
        return picture
