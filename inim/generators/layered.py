"""`layered`: the exact first hit in a layered depth image.

Definition. As in `inim.generators.template`, but a pixel's column is solid only from each layer's
front to its back (`inim.image.rgbd.LayeredRGBD`), and a ray without a hit is a hole.

For a picture without layers, the result is that of `template`.
"""

from __future__ import annotations

import numpy as np

from inim.display import Display
from inim.generators.base import PictureShape, SourceGenerator
from inim.generators.registry import algorithm
from inim.image.rgbd import LayeredRGBD


@algorithm(exact=True, reads=LayeredRGBD, colour="smooth", fill="auto", color="#6a51a3", marker="P")
def prepare(
    display: Display,
    shape: PictureShape,
    pixel_mm: float,
    *,
    samples: int | str = "auto",
    mask: np.ndarray | None = None,
) -> SourceGenerator:
    """Exact first hits in all layers of a scene.

    Parameters
    ----------
    display, shape, pixel_mm, mask :
        See `inim.generators.prepare`.
    samples : {"auto", 1, 2, 4}
        As for `template`.

    Raises
    ------
    UsageError
        Another number of samples, or rays so long that they are a slip.
    """
    from inim.generators.raycast.columns import LAYERS
    from inim.generators.raycast.strips import first_hits

    return first_hits("layered", display, shape, pixel_mm, LAYERS, samples, mask)
