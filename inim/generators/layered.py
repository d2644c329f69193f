"""`layered`: the exact first hit in a picture that knows what lies behind its front surface.

Definition. As `inim.generators.template`, but a pixel's column is solid only from each layer's
front down to its back (`inim.rgbd.LayeredRGBD`); see `inim.generators.raycast.solids`.

A picture without layers is solid all the way back, and shows what `template` shows.
"""

from __future__ import annotations

import numpy as np

from inim.display import Display
from inim.errors import UsageError
from inim.generators.base import PictureShape, SourceGenerator
from inim.generators.raycast.cells import check_ray_length
from inim.generators.registry import algorithm

__all__ = ["prepare"]

# Of usual pictures, with sides: what tables are made for is not known before a picture comes.
_LAYERS = 12


@algorithm(exact=True, reads_layers=True, color="#6a51a3", marker="P")
def prepare(
    display: Display,
    shape: PictureShape,
    pixel_mm: float,
    *,
    samples: int | str = 4,
    mask: np.ndarray | None = None,
) -> SourceGenerator:
    """Exact first hits in all layers of a scene.

    Parameters
    ----------
    display, shape, pixel_mm, mask :
        See `inim.generators.prepare`.
    samples : {1, 2, 4}
        As for `template`.

    Raises
    ------
    UsageError
        Another number of samples, or rays so long that they are a slip.
    """
    from inim.generators.raycast.solids import first_hits_in_solids

    if str(samples) not in ("1", "2", "4"):
        raise UsageError(f"layered: samples = {samples!r}; use 1, 2 or 4")
    check_ray_length("layered", display, shape, pixel_mm)
    return first_hits_in_solids(display, shape, pixel_mm, int(samples), mask, layers=_LAYERS)
