"""Light fields with true views: each algorithm, from the middle view, next to other programs.

    python -m reports.scoreboard.run FOLDER ... --rvs RVS -o reports/scoreboard

Folders are light fields (`reports.scoreboard.field`). Their pictures are not committed, only the
scores. ``--rvs`` is the executable of MPEG's Reference View Synthesizer
(`reports.scoreboard.rivals`); without it, its row is missing.

The middle view and its disparity are the picture. The display has a lens for each picture pixel and
a panel pixel for each view, so an EIA is a light field, and its sub-aperture views are compared
with the true views. All views have 8 bits.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import inim
from inim.generators import HOLE, algorithm_names, parse_algorithm
from inim.generators.steps import RayGenerator
from inim.image.color import linear_from_srgb
from inim.image.files.light_field import sub_aperture_views
from inim.image.rgbd import CameraRGBDs
from inim.scores.metrics import find, score_maps
from reports.scoreboard.field import LightField, Place, Views, codes, read
from reports.scoreboard.page import NEAREST, page
from reports.scoreboard.rivals import copy, nearest, rvs, splat
from reports.study import Study

#: Kinds of pixels of the true views: the middle view shows their surface; a nearer surface hides
#: it there; or it is beyond the edge of the middle view.
KINDS = ("shown", "uncovered", "beyond_edge")
_FILL, _FAST = ":fill=hidden", ":samples=1:colour=nearest"
# Options that are scored in addition to the defaults. Most of the panel of `li2012` is holes, so a
# fill would hide the algorithm.
_OPTIONS = {
    "template": (
        _FAST,
        f"{_FAST}{_FILL}",
        f":colour=nearest{_FILL}",
        ":colour=linear",
    ),
    "layered": (f":colour=nearest{_FILL}",),
    "gu2020": (_FILL,),
    "wang2024": (":matching=ray", f":matching=ray{_FILL}"),
}


def algorithms() -> list[str]:
    """All installed algorithms except those that read several cameras: one view is given."""
    return [n for n in algorithm_names() if parse_algorithm(n).reads is not CameraRGBDs]


def methods() -> list[str]:
    """All algorithms with their default options and with the options of `_OPTIONS`."""
    return [name + option for name in algorithms() for option in ("", *_OPTIONS.get(name, ()))]


class Scores:
    """Comparison of views with the true views of a light field."""

    def __init__(self, field: LightField) -> None:
        self._field = field
        self._true = {place: _linear(view) for place, view in field.views.items()}
        self._left = _left(field)
        holes = sub_aperture_views(self._left, field.display)
        self._kinds = {place: _kinds(field, place, holes[place] == HOLE) for place in field.views}

    def pixel_share(self) -> dict[str, float]:
        """Share of each kind of pixel in the true views."""
        by_view = [np.bincount(k.ravel(), minlength=len(KINDS)) for k in self._kinds.values()]
        counts = np.sum(by_view, axis=0)
        return dict(zip(KINDS, (counts / counts.sum()).tolist(), strict=True))

    def of(self, views: Views) -> dict[str, Any]:
        """Scores over all views, of the worst, by distance, and shares of the squared error.

        PSNR belongs to the mean squared error and is null for equal pictures. SSIM is the mean
        over views.
        """
        ssim = find("ssim")
        assert ssim is not None
        by_view: dict[Place, tuple[float, float]] = {}
        squared, pixels = np.zeros(len(KINDS)), np.zeros(len(KINDS))
        for place, view in views:
            maps = score_maps(self._true[place], _linear(view), ("ssim", "psnr_db"))
            errors, kinds = maps["psnr_db"], self._kinds[place].ravel()
            squared += np.bincount(kinds, errors.ravel(), len(KINDS))
            pixels += np.bincount(kinds, minlength=len(KINDS))
            by_view[place] = float(errors.mean()), ssim.score(maps["ssim"])
        if by_view.keys() != self._true.keys():
            raise ValueError(f"{len(by_view)} views; the light field has {len(self._true)}")
        worst = max(by_view, key=lambda place: by_view[place][0])
        rings = sorted({self._field.ring(place) for place in by_view})
        total = squared.sum()
        return {
            **_mean(list(by_view.values())),
            "shown_psnr_db": _decibels(squared[0] / pixels[0]),
            "worst_view": {"place": list(worst), **_mean([by_view[worst]])},
            "by_distance": {
                str(ring): _mean([by_view[p] for p in by_view if self._field.ring(p) == ring])
                for ring in rings
            },
            "error_share": dict(zip(KINDS, (squared / (total or 1)).tolist(), strict=True)),
        }

    def nearest_fill(self) -> Views:
        """First hits, with each hole filled from the nearest pixel of its own view."""
        palette = self._field.middle.reshape(-1, 3)
        for place, view in self._field.of_eia(self._left):
            yield place, palette[view[nearest(view == HOLE)]]


def measure(field: LightField, program: Path | None = None) -> dict[str, Any]:
    """Score every method on a light field, and RVS if there is an executable."""
    scores = Scores(field)
    scores_by_method: dict[str, Any] = {}
    by_digest: dict[str, dict[str, Any]] = {}
    for name, views, digest in _views(field, scores, program):
        # Equal panels have equal scores.
        scores_by_method[name] = by_digest.get(digest) or scores.of(views)
        by_digest[digest or name] = scores_by_method[name]
    low, high = float(field.disparity.min()), float(field.disparity.max())
    return {
        "name": field.name,
        "source": field.source,
        "licence": field.licence,
        "side": field.side,
        "views": len(field.views),
        "view_px": [field.rgbd.shape[1], field.rgbd.shape[0]],
        "disparity": field.disparity_file,
        "disparity_range_px": [low, high],
        "pixel_share": scores.pixel_share(),
        "methods": scores_by_method,
    }


def _views(
    field: LightField, scores: Scores, program: Path | None
) -> Iterator[tuple[str, Views, str]]:
    """Name and views of each method, and the digest of its panel if it has one."""
    yield "copy", copy(field), ""
    yield "splat", splat(field), ""
    if program:
        yield "rvs", rvs(field, program), ""
    yield NEAREST, scores.nearest_fill(), ""
    for name in methods():
        eia = codes(inim.generate(field.rgbd, field.display, name))
        yield name, field.of_eia(eia), hashlib.sha256(eia.data).hexdigest()


def _linear(view: np.ndarray) -> np.ndarray:
    linear: np.ndarray = linear_from_srgb(view.astype(np.float32) / 255)
    return linear


def _mean(scored: list[tuple[float, float]]) -> dict[str, float | None]:
    squared, similar = np.mean(scored, axis=0)
    return {"psnr_db": _decibels(squared), "ssim": float(similar)}


def _decibels(squared: float) -> float | None:
    # Equal 8-bit codes differ by rounding after conversion to linear light and back.
    return None if squared < (1e-3 / 255) ** 2 else float(-10 * np.log10(squared))


def _left(field: LightField) -> np.ndarray:
    """Sources of the panel, with holes where the picture does not determine them."""
    shape, pixel = field.rgbd.shape, field.rgbd.pixel_mm
    template = parse_algorithm("template:samples=1:fill=none")
    return RayGenerator(template, field.display, shape, pixel, leave_holes=True).sources(field.rgbd)


def _kinds(field: LightField, place: Place, holes: np.ndarray) -> np.ndarray:
    """Index of the kind of each pixel; a hole is beyond the edge if its ray leaves the picture."""
    rows, columns = np.indices(holes.shape)
    down, across = field.offset(place)
    leaves = np.zeros(holes.shape, bool)
    for disparity in (field.disparity.min(), field.disparity.max()):
        row, column = rows + disparity * down, columns + disparity * across
        leaves |= (row < 0) | (row > holes.shape[0] - 1)
        leaves |= (column < 0) | (column > holes.shape[1] - 1)
    kinds: np.ndarray = holes * (1 + (holes & leaves))
    return kinds


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the light fields and RVS."""
    parser.add_argument("folders", nargs="+", type=Path, help="light fields")
    parser.add_argument("--rvs", type=Path, help="executable of MPEG's RVS")


STUDY = Study(
    "reports.scoreboard.run", "Scoreboard: light fields with true views", __doc__, arguments,
    lambda args: {f.resolve().name: {"folder": f, "program": args.rvs} for f in args.folders},
    lambda folder, program: measure(read(folder), program), page,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.main())
