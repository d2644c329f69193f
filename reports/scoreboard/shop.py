"""Light field of the 27 x 27 rendered views of "shop", whose camera positions are published.

    python -m reports.scoreboard.shop light-fields/shop -o FOLDER/shop

The views are those of https://github.com/linusmossberg/light-field-renderer (MIT licence), 960 x
640, cameras in steps of 30.8 mm, their axes parallel. A window that moves by a whole number of
pixels from view to view brings the middle of the scene to disparity 0. The rest is averaged in
linear light over squares of pixels, so that an elemental image array of all views fits in memory.

The views have no depth. The middle view's disparity is estimated from the true views by a plane
sweep. The cost of a disparity is the difference between the middle view and the views that it moves
onto the middle view. It is averaged over each of four halves of the views, the least of the four
averages is used, and a window smooths it. All methods read the same estimate.
"""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, median_filter
from scipy.ndimage import shift as moved

from inim.image.color import linear_from_srgb, to_srgb
from inim.image.files.light_field import write_hci
from inim.image.files.picture import write_pfm

_NAME = re.compile(r".*_(\d\d)_(\d\d)_.*\.jpg")
_SIDE = 27
# Shift of the window from view to view, and range of disparities, in pixels of the stored views.
_CONVERGED, _LEAST, _MOST = 4, 0.0, 9.0
_SQUARE = 4
_PLANES = 145
# Views up to this far from the middle one are compared with it: all of its row and column.
_NEAR = 13
_WINDOW = 1.5
_SOURCE = "https://github.com/linusmossberg/light-field-renderer, scene by Alex Treviño after a "
_SOURCE += "concept by Anaïs Maamar; disparity: estimated from the true views by a plane sweep"
_LICENCE = "repository: MIT; scene: not stated"


def sweep(views: np.ndarray, disparities: np.ndarray, near: int = _NEAR) -> np.ndarray:
    """Estimate the middle view's disparity.

    Parameters
    ----------
    views : (n, n, H, W, 3) uint8
        Row 0 from the uppermost eye, column 0 from the leftmost.
    disparities : (planes,) float
        Candidates, evenly spaced.
    near : int
        Views up to this far from the middle one are compared with it.

    Returns
    -------
    (H, W) float32, pixels to the next view
    """
    middle = views.shape[0] // 2
    reference = views[middle, middle].astype(np.float32)
    offsets = [(s * k, 0) for k in range(1, near + 1) for s in (-1, 1)]
    offsets += [(0, across) for across, _ in offsets]
    halves = [[o for o in offsets if sign * o[axis] > 0] for axis in (0, 1) for sign in (-1, 1)]
    costs = []
    for disparity in disparities:
        far = {o: _difference(views, reference, o, disparity) for o in offsets}
        means = [np.mean([far[o] for o in half], axis=0) for half in halves]
        costs.append(gaussian_filter(np.min(means, axis=0), _WINDOW))
    cost = np.stack(costs)
    best = np.clip(cost.argmin(axis=0), 1, len(disparities) - 2)
    # Minimum of the parabola through the least cost and its neighbours.
    before, least, after = (np.take_along_axis(cost, (best + d)[None], 0)[0] for d in (-1, 0, 1))
    bend = before - 2 * least + after
    part = np.where(bend > 0, (before - after) / (2 * np.where(bend > 0, bend, 1)), 0)
    step = disparities[1] - disparities[0]
    estimate = disparities[best] + np.clip(part, -0.5, 0.5) * step
    smooth: np.ndarray = median_filter(estimate, 3).astype(np.float32)
    return smooth


def _difference(
    views: np.ndarray, reference: np.ndarray, offset: tuple[int, int], disparity: float
) -> np.ndarray:
    """Difference between the middle view and a view that a disparity moves onto it."""
    middle = views.shape[0] // 2
    view = views[middle + offset[0], middle + offset[1]].astype(np.float32)
    shift = (disparity * offset[0], disparity * offset[1], 0)
    there: np.ndarray = np.abs(moved(view, shift, order=1, mode="nearest") - reference).sum(axis=-1)
    return there


def main() -> None:
    """Convert the stored views and estimate the disparity."""
    from PIL import Image

    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="stored views")
    parser.add_argument("-o", "--out", type=Path, required=True)
    args = parser.parse_args()
    rim = _CONVERGED * (_SIDE // 2)
    views = {}
    for path in sorted(args.folder.glob("*.jpg")):
        # Rows are numbered from the lowest camera, columns from the rightmost.
        match = _NAME.fullmatch(path.name)
        assert match
        row, column = _SIDE - 1 - int(match[1]), _SIDE - 1 - int(match[2])
        whole = np.asarray(Image.open(path).convert("RGB"))
        # A point at disparity d moves against the camera.
        top = rim - _CONVERGED * (row - _SIDE // 2)
        left = rim - _CONVERGED * (column - _SIDE // 2)
        high, wide = ((n - 2 * rim) // _SQUARE * _SQUARE for n in (whole.shape[0], whole.shape[1]))
        cut = whole[top : top + high, left : left + wide]
        squares = cut.reshape(high // _SQUARE, _SQUARE, wide // _SQUARE, _SQUARE, 3)
        light = linear_from_srgb(squares.astype(np.float32) / 255).mean(axis=(1, 3))
        views[row, column] = to_srgb(light)
    grid = np.stack([np.stack([views[r, c] for c in range(_SIDE)]) for r in range(_SIDE)])
    tried = np.linspace(_LEAST - _CONVERGED, _MOST - _CONVERGED, _PLANES) / _SQUARE
    disparity = sweep(grid, tried)
    args.out.mkdir(parents=True, exist_ok=True)
    write_hci(args.out, grid)
    write_pfm(args.out / "estimated.pfm", disparity)
    about = {"source": _SOURCE, "licence": _LICENCE}
    (args.out / "source.json").write_text(json.dumps(about, ensure_ascii=False), "utf-8")


if __name__ == "__main__":
    main()
