"""`cameras`: the exact first hit in the merged RGB-D pictures of several cameras.

The pictures are merged into the layers that `layered` reads (`inim.generators.raycast.merge`). A
single picture has the columns of `template`.
"""

from dataclasses import dataclass
from typing import Any

from inim.generators.base import PanelRays, SourceFinder
from inim.generators.options import option
from inim.generators.registry import algorithm
from inim.image.rgbd import CameraRGBDs, camera_directions


def _arrangement(_: str, value: Any) -> str:
    """Arrangement of cameras, which `camera_directions` checks."""
    camera_directions(str(value))
    return str(value)


@dataclass(frozen=True)
class CamerasOptions:
    """Options of `cameras`."""

    views: str = option(
        "5",
        "cameras in front of a scene: 5, or rows x columns such as 3x3; pictures that are given "
        "have their own",
        _arrangement,
    )


@algorithm(
    CamerasOptions, exact=True, reads=CameraRGBDs, samples="auto", colour="smooth", fill="auto",
    color="#08519c", marker="X",
)  # fmt: skip
def prepare(rays: PanelRays, _: CamerasOptions) -> SourceFinder:
    """Exact first hits in the merged pictures of several cameras."""
    from inim.generators.raycast.columns import LAYERS
    from inim.generators.raycast.strips import first_hits

    return first_hits("cameras", rays, LAYERS)
