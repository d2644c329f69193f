"""`cameras`: the exact first hit in the merged RGB-D pictures of several cameras.

The pictures are merged into the layers that `layered` reads (`inim.generators.raycast.merge`). A
single picture has the columns of `template`.
"""

from __future__ import annotations

import numpy as np

from inim.display import Display
from inim.generators.base import PictureShape, SourceGenerator
from inim.generators.registry import algorithm
from inim.image.rgbd import CameraRGBDs


@algorithm(exact=True, reads=CameraRGBDs, colour="smooth", fill="auto", color="#08519c", marker="X")
def prepare(
    display: Display,
    shape: PictureShape,
    pixel_mm: float,
    *,
    views: int | str = "5",  # noqa: ARG001
    samples: int | str = "auto",
    mask: np.ndarray | None = None,
) -> SourceGenerator:
    """Exact first hits in the merged pictures of several cameras.

    Parameters
    ----------
    display, shape, pixel_mm, mask :
        See `inim.generators.prepare`.
    views : str
        Cameras in front of a scene; see `inim.image.rgbd.camera_directions`. Pictures that are
        given have their own.
    samples : {"auto", 1, 2, 4}
        As for `template`.

    Raises
    ------
    UsageError
        Another number of samples, or rays so long that they are a slip.
    """
    from inim.generators.raycast.columns import LAYERS
    from inim.generators.raycast.strips import first_hits

    return first_hits("cameras", display, shape, pixel_mm, LAYERS, samples, mask)
