"""`report.json` of one's own picture: scores without a ground truth."""

from __future__ import annotations

import math
from typing import Annotated

from inim.documents.document import Part, doc
from inim.documents.parts import (
    VIEW_SCORES,
    PictureShape,
    RunReport,
    Scores,
    check_names,
    check_scores,
)
from inim.metrics.headline import MAIN


class FittedPicture(PictureShape):
    """The picture as fitted to the display."""

    layers: Annotated[int, doc("Number of layers; 1: the front surface alone.")]
    covered_fraction: Annotated[float, doc("Share of the pixels that show something, 0 to 1.")]
    depth_min_mm: Annotated[float, doc("Farthest depth, z in mm.")]
    depth_max_mm: Annotated[float, doc("Nearest depth, z in mm.")]
    notes: Annotated[
        list[str], doc("For a photograph with depth inside: its contents and its framing.")
    ]


class PictureView(Part):
    """Scores of a view against two references."""

    to_picture: Annotated[Scores, doc("Against the picture itself, warped to the viewpoint.")]
    to_exact: Annotated[Scores, doc("Against the view of the exact EIA.")]

    def __post_init__(self) -> None:
        check_scores("to_picture", self.to_picture, VIEW_SCORES)
        check_scores("to_exact", self.to_exact, VIEW_SCORES)


class PictureAlgorithm(Part):
    """Results of an algorithm."""

    seconds: Annotated[float, doc("Seconds to prepare and generate the EIA.")]
    wrong_source: Annotated[
        float | None,
        doc(
            "Share of the compared panel pixels that show another pixel of the picture than the "
            "exact one, 0 to 1; null: the algorithm does not report its sources, or there is no "
            "oracle."
        ),
    ]
    hole_fraction: Annotated[
        float | None,
        doc("Share of the lensed panel pixels that show nothing, 0 to 1; null: unknown."),
    ]
    not_finite: Annotated[
        float, doc("Share of the panel pixels with values that are not finite, 0 to 1.")
    ]
    brightest: Annotated[float, doc("Largest value of the EIA, linear; 1 is the panel's white.")]
    views: Annotated[dict[str, PictureView], doc("Scores of its views, by viewpoint.")]


class PictureDocument(RunReport, tag="inim.picture/2"):
    """Report of a picture without a scene.

    `report.json` in the folder of `inim validate` on a user's own picture (fitted, or colour
    and `--depth`): all scores that need no ground truth.
    """

    picture: FittedPicture
    oracle_pixels: Annotated[
        int,
        doc(
            "Panel pixels, drawn at random, whose source was compared with the exact one; 0: the "
            "display has no oracle."
        ),
    ]
    exact: Annotated[
        dict[str, Scores],
        doc("View of the exact EIA against the picture, warped to the viewpoint, by viewpoint."),
    ]
    met_fraction: Annotated[
        dict[str, float],
        doc("Share of the picture's window that shows something, 0 to 1, by viewpoint."),
    ]
    algorithms: Annotated[
        dict[str, PictureAlgorithm], doc("Results by algorithm, under its name with options.")
    ]
    not_scored: Annotated[list[str], doc("Missing scores and reasons, a text each.")]

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
