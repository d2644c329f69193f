"""The document of a user's RGB-D pictures from several cameras."""

from __future__ import annotations

from typing import Annotated

from inim.documents.document import Document, Part, doc

Intrinsics = Annotated[
    tuple[float, float, float, float],
    doc("Focal lengths and principal point fx, fy, cx, cy, in pixels of the colour picture."),
]
Vector = tuple[float, float, float]


class PlacedPicture(Part):
    """A colour and a depth picture, with the place of their camera."""

    color: Annotated[str, doc("Colour picture, in the folder of the document.")]
    depth: Annotated[str, doc("Depth picture, in the folder of the document.")]
    intrinsics: Annotated[Intrinsics | None, doc("Of this camera, if it has its own.")] = None
    position_mm: Annotated[
        Vector, doc("Position of the camera in mm; x to the right, y down, z away.")
    ] = (0.0, 0.0, 0.0)
    rotation: Annotated[
        tuple[Vector, Vector, Vector],
        doc(
            "Rotation matrix, by rows: its columns are the camera's right, down and forward "
            "directions. Without it, the camera looks along z."
        ),
    ] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class CamerasDocument(Document, tag="inim.cameras/1"):
    """RGB-D pictures from several cameras.

    Input of `inim generate`, written by the user. The display shows the scene as the first camera
    sees it. Positions and rotations of all cameras are in one frame, which may be that of the first
    camera.
    """

    intrinsics: Annotated[Intrinsics | None, doc("Of all cameras without their own.")] = None
    pictures: Annotated[list[PlacedPicture], doc("Two to nine pictures, the front view first.")]
