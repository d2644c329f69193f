"""Statistics of images: what a later run's images are compared with."""

from __future__ import annotations

from dataclasses import dataclass, field

from inim.display import Display
from inim.image.noisy_image import NoisyImage
from inim.pipeline.stages.stage import SCORING, Run, stage
from inim.regression import (
    Fingerprint,
    ScoreEstimate,
    TileStatistics,
    eia_tile,
    tile_statistics,
    view_tile,
)


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
def _tiles(image: NoisyImage, tile: tuple[int, int], generated: bool) -> TileStatistics:
    return tile_statistics(image, tile, generated=generated)


def eia_statistics(
    name: str,
    eia: NoisyImage,
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
    eia : NoisyImage
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
    return {name: _tiles(eia, tile, generated, run=run)}


def view_statistics(view: NoisyImage, run: Run) -> TileStatistics:
    """Statistics of a rendered view."""
    return _tiles(view, view_tile(view.shape), False, run=run)
