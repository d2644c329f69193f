"""Input document of several cameras' pictures."""

from typing import Annotated

from inim.system.document import Document, Part, doc

Intrinsics = Annotated[
    tuple[float, float, float, float],
    doc("Focal lengths and principal point fx, fy, cx, cy, in pixels of the colour picture."),
]
Vector = tuple[float, float, float]


class PlacedPicture(Part):
    """A colour and a depth picture, with the place of their camera."""

    color: str  #: Colour picture, in the folder of the document.
    depth: str  #: Depth picture, in the folder of the document.
    intrinsics: Intrinsics | None = None  #: Of this camera, if it has its own.
    #: Position of the camera in mm; x to the right, y down, z away.
    position_mm: Vector = (0.0, 0.0, 0.0)
    #: Rotation matrix, by rows: its columns are the camera's right, down and forward directions.
    #: Without it, the camera looks along z.
    rotation: tuple[Vector, Vector, Vector] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class CamerasDocument(Document, tag="inim.cameras/1"):
    """RGB-D pictures from several cameras.

    Input of `inim generate`, written by the user. The display shows the scene as the first camera
    sees it. Positions and rotations of all cameras are in one frame, which may be that of the first
    camera.
    """

    intrinsics: Intrinsics | None = None  #: Of all cameras without their own.
    pictures: list[PlacedPicture]  #: Two to nine pictures, the front view first.
