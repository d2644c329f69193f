"""Matrices of views: a view is linear in the EIA, because light adds up.

Row p, column q is the share of view pixel p that shows panel pixel q: the mean weight over samples
of the view pixel's area and of the pupil, with the same lens model, sub-pixels and dispersion as
the views of `inim.render.reconstruct`.
"""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse import coo_array, csr_array, vstack

from inim.display import Display
from inim.display.lens import lens_model as find_lens_model
from inim.display.viewpoint import Viewpoint
from inim.render.display_emitter import LensedPanel
from inim.render.rays import eye_rays
from inim.render.trace import FilmCamera, rays_per_pass, trace_samples
from inim.system.errors import UsageError
from inim.system.process.observer import Observer

# Samples whose entries are merged at once: 20 bytes each.
_SAMPLES_AT_ONCE = 2**22


def view_matrices(
    display: Display,
    viewpoint: Viewpoint,
    lens_model: str,
    *,
    pixels_per_lens: int | tuple[float, float],
    spp: int,
    seed: int,
    observer: Observer | None = None,
) -> list[csr_array]:
    """Matrices from panel pixels to the pixels of a view, in linear light.

    Parameters
    ----------
    display, viewpoint, lens_model, pixels_per_lens :
        As of the view; see `inim.render.reconstruct.reconstruct`.
    spp : int
        Samples per view pixel.
    seed : int
        With the seed and the samples of a view, the product with an EIA is that view.

    Returns
    -------
    list of (view pixels, panel pixels) float32
        One matrix for all colours, or three if dispersion or sub-pixels distinguish them.

    Raises
    ------
    UsageError
        The lens model is a mesh, whose rays scatter between the lenses.
    """
    model = find_lens_model(lens_model)
    model.check(display)
    if model.trace is None:
        raise UsageError(
            f"lens model {lens_model!r}: a view has no sparse matrix, because rays scatter between "
            f"the lenses; use {model.stand_in!r}"
        )
    started, panel = time.perf_counter(), LensedPanel(display, lens_model)
    camera = FilmCamera(eye_rays(display, viewpoint, pixels_per_lens, panel.start_mm), np.eye(4))

    def seen_pixels(index: Any, sampler: Any) -> list[tuple[Any, ...]]:
        (x, y), slopes = camera.lines(*camera.sample(index, sampler))
        return [tuple(pixel) for pixel in panel.find_pixels(x, y, *slopes)]

    pixels = np.arange(camera.shape[0] * camera.shape[1])
    step = max(1, min(_SAMPLES_AT_ONCE, rays_per_pass()) // spp)
    bands = [
        [
            _merge(result, spp, display.eia_shape)
            for result in trace_samples(seen_pixels, pixels[first : first + step], 0, spp, seed)
        ]
        for first in range(0, len(pixels), step)
    ]
    if observer:
        observer.record_rendering(time.perf_counter() - started, spp * len(pixels))
    return [vstack(colour, format="csr") for colour in zip(*bands, strict=True)]


def observed_columns(matrices: Sequence[csr_array]) -> tuple[np.ndarray, list[csr_array]]:
    """Panel pixels that a view observes, (panel pixels,) bool, and its matrices of these alone."""
    mask = np.zeros(matrices[0].shape[1], bool)
    for matrix in matrices:
        mask[matrix.indices] = True
    column = np.cumsum(mask, dtype=np.int32) - 1
    shape = matrices[0].shape[0], int(np.count_nonzero(mask))
    return mask, [csr_array((m.data, column[m.indices], m.indptr), shape) for m in matrices]


def _merge(result: tuple[Any, Any, Any], spp: int, eia_shape: tuple[int, int]) -> csr_array:
    """Matrix of some view pixels from the panel pixel, weight and mask of each sample."""
    place, weight, lit = (np.asarray(values) for values in result)
    lit = lit & (weight > 0)
    rows = np.repeat(np.arange(len(place) // spp), spp)
    shape = len(rows) // spp, eia_shape[0] * eia_shape[1]
    entries = weight[lit] / np.float32(spp), (rows[lit], place[lit])
    return coo_array(entries, shape).tocsr()
