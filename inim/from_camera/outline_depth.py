"""Depth of a picture without depth, from the outline of its subject.

The outline is found where the subject stands out from a smooth background, or is given as a mask.
Two depths follow from it at once, without a learned model:

* **Relief**: the subject bulges towards the viewer like a balloon of its outline. The square of its
  height is the solution of Poisson's equation with zeros at the outline (Joshi and Carr,
  "Repoussé", SBIM 2008). A disc becomes a hemisphere, a long bar a half-cylinder whose height is
  1.4 times half its width.
* **Layers**: the subject is a flat layer before a flat background.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from inim.errors import UsageError

# The outline and the relief are computed at no more than these sizes: both are smooth inside.
_OUTLINE_PX = 512
_RELIEF_PX = 256
# Rim of the picture that shows the background, as a share of its sides.
_RIM = 0.04
# Fits of the background; each leaves out rim pixels that differ more than usual from the last.
_FITS = 6
_USUAL = 2.5
# A pixel stands out from this multiple of the rim's deviation on, and from this distance in RGB,
# in 8-bit codes.
_STANDS_OUT = 4.0
_MIN_DIFFERENCE = 10.0
# Least share of the rim that a smooth background explains, and of the other colours that the
# largest region has. Rooms and streets have less.
_MIN_RIM_SHARE = 0.6
_MIN_LARGEST = 0.6
# Share of the picture that a subject may cover.
_SUBJECT_SHARES = (0.02, 0.9)
# Larger holes show the background, such as below a handle; as a share of the subject.
_MAX_HOLE = 0.01
# Nearness at the outline of a relief: its background lies this far behind it.
_OUTLINE_NEARNESS = 0.25


def find_subject(color: NDArray[np.uint8], name: str) -> NDArray[np.bool_]:
    """Find the pixels of a picture's subject, (H, W) bool.

    The background's colours are quadratic functions of the place, fitted to the rim of the picture.
    The subject is the largest connected region of other colours, without its small holes.

    * `color`: (H, W, 3) uint8 sRGB.
    * `name`: the picture's name, for messages.

    Raises `UsageError`: no subject stands out.
    """
    from scipy import ndimage

    step = max(1, -(-max(color.shape) // _OUTLINE_PX))
    small = color[step // 2 :: step, step // 2 :: step].astype(np.float64)
    difference, noise, rim_share = _difference_to_background(small)
    threshold = max(_STANDS_OUT * noise, _MIN_DIFFERENCE)
    # Unlike a mean, a median of the neighbours leaves edges in place.
    foreground = ndimage.median_filter(difference, size=3) > threshold
    foreground = ndimage.binary_opening(foreground, iterations=2)
    labels, count = ndimage.label(foreground)
    subject = labels == np.argmax(np.bincount(labels.ravel())[1:]) + 1 if count else foreground
    is_one = subject.sum() >= _MIN_LARGEST * foreground.sum()
    holes, _ = ndimage.label(ndimage.binary_fill_holes(subject) & ~subject)
    sizes = np.bincount(holes.ravel())
    subject |= (holes > 0) & (sizes[holes] < _MAX_HOLE * subject.sum())
    least, most = _SUBJECT_SHARES
    if not (rim_share >= _MIN_RIM_SHARE and is_one and least <= subject.mean() <= most):
        raise UsageError(
            f"{name}: no subject stands out from a smooth background; give --mask FILE, a picture "
            "of the same shape that is white where the subject is, or --method model"
        )
    return _resize(subject.astype(np.float64), color.shape[:2], step) > 0.5


def relief(subject: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Nearness of a relief: 0 in the background, then from the outline on up to 1, (H, W) float32.

    Where the picture's edge cuts the subject, the relief goes on.

    * `subject`: (H, W) bool, with at least one pixel.
    """
    from scipy import sparse
    from scipy.sparse.linalg import spsolve

    step = max(1, -(-max(subject.shape) // _RELIEF_PX))
    small = subject[step // 2 :: step, step // 2 :: step]
    if not small.any():
        small, step = subject, 1
    number = np.full(small.shape, -1)
    number[small] = np.arange(small.sum())
    entries: list[tuple[np.ndarray, np.ndarray]] = []
    neighbours = np.zeros(small.shape)
    for axis, shift in ((0, 1), (0, -1), (1, 1), (1, -1)):
        beside = np.roll(number, -shift, axis)
        # What lies beyond the picture's edge is as high as its edge.
        edge = [slice(None), slice(None)]
        edge[axis] = slice(-1, None) if shift == 1 else slice(0, 1)
        beside[tuple(edge)] = -2
        neighbours += beside != -2
        inside = small & (beside >= 0)
        entries.append((number[inside], beside[inside]))
    rows, columns = (np.concatenate(part) for part in zip(*entries, strict=True))
    count = int(small.sum())
    # A subject that fills the picture has no outline: the tiny term makes it flat.
    diagonal = neighbours[small] + 1e-9
    matrix = sparse.coo_array((-np.ones(len(rows)), (rows, columns)), (count, count)).tocsc()
    squares = np.zeros(small.shape)
    squares[small] = spsolve(matrix + sparse.diags_array(diagonal, format="csc"), np.ones(count))
    height = np.sqrt(np.maximum(_resize(squares, subject.shape, step), 0)) * subject
    nearness = _OUTLINE_NEARNESS + (1 - _OUTLINE_NEARNESS) * height / height.max()
    return np.where(subject, nearness, 0).astype(np.float32)


def layers(subject: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Nearness of a flat subject before a flat background: 1 and 0, (H, W) float32."""
    return subject.astype(np.float32)


class OutlineMethod(NamedTuple):
    """Depth from an outline, and the nearness at the ends of a display's depth range.

    A relief is as deep as half the range: of six relics, the views are then closest to the true
    ones (see `reports/depth`). A layer is in the middle.
    """

    nearness: Callable[[NDArray[np.bool_]], NDArray[np.float32]]
    near: float
    far: float


#: Methods by name.
METHODS = {
    "relief": OutlineMethod(relief, 1.625, -0.375),
    "layers": OutlineMethod(layers, 2.0, 0.0),
}


def _difference_to_background(color: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Distance of colours to a smooth background that is fitted to the rim.

    Also returns its root mean square in the background of the rim, and that part's share of the
    rim.
    """
    rows, columns = color.shape[:2]
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    rim = np.maximum(abs(x), abs(y)) > 1 - 2 * _RIM
    is_background = np.ones(int(rim.sum()), bool)
    for _ in range(_FITS):
        fit = np.linalg.lstsq(terms[rim][is_background], color[rim][is_background], rcond=None)[0]
        distance = np.linalg.norm(color - terms @ fit, axis=-1)
        usual = _USUAL * float(np.median(distance[rim]))
        is_background = distance[rim] <= max(usual, _MIN_DIFFERENCE / 2)
    noise = float(np.sqrt((distance[rim][is_background] ** 2).mean()))
    share = float((distance[rim] <= max(_STANDS_OUT * noise, _MIN_DIFFERENCE)).mean())
    return distance, noise, share


def _resize(values: np.ndarray, shape: tuple[int, ...], step: int) -> np.ndarray:
    """Bilinear interpolation at all pixels of a picture of which each `step`-th is given."""
    for axis, size in enumerate(shape):
        places = ((np.arange(size) - step // 2) / step).clip(0, values.shape[axis] - 1)
        below = np.minimum(places.astype(int), max(values.shape[axis] - 2, 0))
        above = np.minimum(below + 1, values.shape[axis] - 1)
        share = np.expand_dims(places - below, 1 - axis)
        values = values.take(below, axis) * (1 - share) + values.take(above, axis) * share
    return values
