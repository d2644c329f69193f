"""Statistics of images: what a later run's images are compared with."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from inim.display import Display
from inim.image.buffers import HalfBuffers
from inim.pipeline.stages.stage import SCORING, Run, stage
from inim.regression import (
    Fingerprint,
    HalfBuffer,
    ScoreEstimate,
    TileStatistics,
    eia_tile,
    tile_statistics,
    view_tile,
)

#: A half of an image's samples.
Half = np.ndarray | HalfBuffer


@dataclass(frozen=True)
class Statistics:
    """What later runs can be compared with, of one method or of the ground truth.

    Attributes
    ----------
    pictures : dict of str to TileStatistics
    scores : dict of str to dict of str to ScoreEstimate
        By ``NAME/VIEWPOINT``.
    fingerprints : dict of str to Fingerprint
    """

    pictures: dict[str, TileStatistics] = field(default_factory=dict)
    scores: dict[str, dict[str, ScoreEstimate]] = field(default_factory=dict)
    fingerprints: dict[str, Fingerprint] = field(default_factory=dict)


@stage("tile statistics", code=SCORING, makes=(TileStatistics,))
def _tiles(halves: tuple[Half, Half], tile: tuple[int, int], generated: bool) -> TileStatistics:
    return tile_statistics(*halves, tile, generated=generated)


def eia_statistics(
    name: str,
    halves: tuple[Half, Half],
    display: Display,
    *,
    whole: bool,
    generated: bool,
    run: Run,
) -> dict[str, TileStatistics]:
    """Statistics of an EIA by the two halves of its samples; none of one made in part.

    Parameters
    ----------
    name : str
    halves : two (rows, columns, 3)
    display : Display
    whole : bool
        Whether all of it was made.
    generated : bool
        See `inim.regression.tile_statistics`.
    run : Run
    """
    if not whole:
        return {}
    tile = eia_tile(display.eia_shape, (display.lens_rows, display.lens_columns))
    return {name: _tiles(halves, tile, generated, run=run)}


def view_statistics(view: HalfBuffers, run: Run) -> TileStatistics:
    """Statistics of a rendered view."""
    return _tiles((view.first, view.second), view_tile(view.first.shape[:2]), False, run=run)
