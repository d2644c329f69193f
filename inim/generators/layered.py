"""`layered`: the exact first hit in a layered depth image.

Definition. As in `inim.generators.template`, but a pixel's column is solid only from each layer's
front to its back (`inim.image.rgbd.LayeredRGBD`), and a ray without a hit is a hole.

For a picture without layers, the result is that of `template`.
"""

from inim.generators.base import PanelRays, SourceFinder
from inim.generators.options import NoOptions
from inim.generators.registry import algorithm
from inim.image.rgbd import LayeredRGBD


@algorithm(
    NoOptions, exact=True, reads=LayeredRGBD, samples="auto", colour="smooth", fill="auto",
    color="#6a51a3", marker="P",
)  # fmt: skip
def prepare(rays: PanelRays, _: NoOptions) -> SourceFinder:
    """Exact first hits in all layers of a scene."""
    from inim.generators.raycast.columns import LAYERS
    from inim.generators.raycast.strips import first_hits

    return first_hits("layered", rays, LAYERS)
