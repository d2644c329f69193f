"""Documents about a user's own pictures: several cameras, and a report without a ground truth."""

from __future__ import annotations

import math
from typing import Annotated

from inim.scores.document_parts import (
    VIEW_SCORES,
    PictureShape,
    RunReport,
    Scores,
    check_names,
    check_scores,
)
from inim.scores.metrics import MAIN
from inim.system.document import Document, Part, doc


class FittedPicture(PictureShape):
    """The picture as fitted to the display."""

    layers: int  #: Number of layers; 1: the front surface alone.
    covered_fraction: float  #: Share of the pixels that show something, 0 to 1.
    depth_min_mm: float  #: Farthest depth, z in mm.
    depth_max_mm: float  #: Nearest depth, z in mm.
    notes: list[str]  #: For a photograph with depth inside: its contents and its framing.


class PictureView(Part):
    """Scores of a view against two references."""

    to_picture: Scores  #: Against the picture itself, warped to the viewpoint.
    to_exact: Scores  #: Against the view of the exact EIA.

    def __post_init__(self) -> None:
        check_scores("to_picture", self.to_picture, VIEW_SCORES)
        check_scores("to_exact", self.to_exact, VIEW_SCORES)


class PictureAlgorithm(Part):
    """Results of an algorithm."""

    seconds: float  #: Seconds to prepare and generate the EIA.
    #: Share of the compared panel pixels that show another pixel of the picture than the exact one,
    #: 0 to 1; null: the algorithm does not report its sources, or there is no oracle.
    wrong_source: float | None
    #: Share of the lensed panel pixels that show nothing, 0 to 1; null: unknown.
    hole_fraction: float | None
    not_finite: float  #: Share of the panel pixels with values that are not finite, 0 to 1.
    brightest: float  #: Largest value of the EIA, linear; 1 is the panel's white.
    views: dict[str, PictureView]  #: Scores of its views, by viewpoint.


class PictureDocument(RunReport, tag="inim.picture/2"):
    """Report of a picture without a scene.

    `report.json` in the folder of `inim validate` on a user's own picture (fitted, or colour
    and `--depth`): all scores that need no ground truth.
    """

    picture: FittedPicture
    #: Panel pixels, drawn at random, whose source was compared with the exact one; 0: the display
    #: has no oracle.
    oracle_pixels: int
    #: View of the exact EIA against the picture, warped to the viewpoint, by viewpoint.
    exact: dict[str, Scores]
    #: Share of the picture's window that shows something, 0 to 1, by viewpoint.
    met_fraction: dict[str, float]
    algorithms: dict[str, PictureAlgorithm]  #: Results by algorithm, under its name with options.
    not_scored: list[str]  #: Missing scores and reasons, a text each.

    def __post_init__(self) -> None:
        check_names([*self.viewpoint_names, *self.algorithms])
        for viewpoint in self.viewpoint_names:
            if viewpoint not in self.exact or viewpoint not in self.met_fraction:
                raise ValueError(f"exact: has no scores of {viewpoint[:40]!a}")
            check_scores(f"exact.{viewpoint[:40]!a}", self.exact[viewpoint], VIEW_SCORES)
            for name, result in self.algorithms.items():
                if viewpoint not in result.views:
                    raise ValueError(f"algorithms.{name}: has no view {viewpoint[:40]!a}")

    @property
    def best_algorithm(self) -> str | None:
        """The algorithm whose views are most like the exact EIA's, on average."""
        scores = {
            name: [view.to_exact[MAIN.on_relic_key] for view in result.views.values()]
            for name, result in self.algorithms.items()
        }
        numbers = {name: [v for v in values if v is not None] for name, values in scores.items()}
        means = {name: sum(v) / len(v) if v else -math.inf for name, v in numbers.items()}
        return max(means, key=lambda name: means[name], default=None)


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
