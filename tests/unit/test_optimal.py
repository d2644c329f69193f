"""The optimal EIA against planted EIAs and closed forms.

Expected: a view is the product of its matrix and the EIA; a lens model that shows each view pixel
one panel pixel has a closed optimum; a planted EIA is found again from its own views; no change of
a panel pixel brings the views closer.
"""

import numpy as np
import pytest
from scipy.sparse import csr_array

from inim.display import Viewpoint
from inim.display.viewpoint import parse_viewpoints
from inim.image.color import linear_from_srgb, srgb_from_linear
from inim.pipeline.stages.optimal import LeastSquares
from inim.scores.metrics.psnr import psnr_db
from tests.conftest import small_display

PER_LENS = 4


def smooth_eia(display, seed=3):
    """Random panel image without extreme values, (rows, columns, 3) linear RGB."""
    random = np.random.default_rng(seed)
    return linear_from_srgb(random.uniform(0.2, 0.8, (*display.eia_shape, 3)).astype(np.float32))


def matrices_of(display, lens_model, eyes, spp=64, seed=5):
    from inim.render.view_matrix import view_matrices

    return [
        view_matrices(display, eye, lens_model, pixels_per_lens=PER_LENS, spp=spp, seed=seed)
        for eye in eyes
    ]


def apply(by_colour, eia):
    """View of an EIA by its matrices, (pixels, 3)."""
    light = eia.reshape(-1, 3)
    return np.stack([by_colour[k % len(by_colour)] @ light[:, k] for k in range(3)], axis=-1)


def mean_psnr(matrices, eia, views):
    return np.mean(
        [
            psnr_db(view[None], apply(m, eia)[None].astype(np.float32))
            for m, view in zip(matrices, views, strict=True)
        ]
    )


# --- The matrix ---------------------------------------------------------------------------------


@pytest.mark.usefixtures("renderer")
@pytest.mark.parametrize(
    ("lens_model", "changes"),
    [
        ("pinhole", {}),
        ("thin", {"fill_factor": 0.8, "aperture": "round"}),
        ("thick", {}),
        ("thick", {"abbe_number": 30.0}),
        ("thick", {"subpixels": "rgb-stripe", "pixel_fill": 0.8}),
        ("thick", {"rotation_deg": 2.0, "lattice": "hexagonal"}),
    ],
)
def test_view_is_product_of_matrix_and_eia(lens_model, changes):
    from inim.render.reconstruct import DisplayScene

    display, eia = small_display(**changes), smooth_eia(small_display(**changes))
    eye = Viewpoint("eye", 4.0, -3.0, 150.0, pupil_mm=3.0, focus_mm=150.0)
    options = {"pixels_per_lens": PER_LENS, "spp": 16, "seed": 7}
    view = DisplayScene(eia, display, lens_model).view(eye, **options)
    matrices = matrices_of(display, lens_model, [eye], spp=16, seed=7)[0]
    assert len(matrices) == (1 if not {"abbe_number", "subpixels"} & changes.keys() else 3)
    assert view.max() > 0.1
    assert np.allclose(apply(matrices, eia).reshape(view.shape), view, rtol=0, atol=2e-6)


# --- The optimum --------------------------------------------------------------------------------


def test_one_view_pixel_per_panel_pixel_shows_the_scene_itself():
    """Unit rays and values that a panel can show lose nothing."""
    random = np.random.default_rng(1)
    scene = random.uniform(0, 1, (6, 5, 3)).astype(np.float32)
    fit = LeastSquares([[csr_array(np.eye(30, dtype=np.float32))]], np.full_like(scene, 0.5))
    assert np.abs(srgb_from_linear(fit.solve([scene])) - srgb_from_linear(scene)).max() < 3e-3


def test_panel_pixel_of_several_view_pixels_is_the_mean_of_their_srgb_values():
    """The mean has the least squared error; light itself would average to something brighter."""
    random = np.random.default_rng(2)
    scene = random.uniform(0, 1, (1, 12, 3)).astype(np.float32)
    matrix = csr_array(np.repeat(np.eye(3, dtype=np.float32), 4, axis=0))
    best = LeastSquares([[matrix]], np.full((1, 3, 3), 0.3, np.float32)).solve([scene])
    expected = srgb_from_linear(scene).reshape(3, 4, 3).mean(axis=1)
    assert np.abs(srgb_from_linear(best)[0] - expected).max() < 3e-3


def test_unshown_pixels_keep_the_start_and_all_are_within_the_panel_s_range():
    """Two rays that share a pixel ask for a darker one than black next to it."""
    matrix = csr_array(np.array([[0.5, 0.5, 0, 0], [1, 0, 0, 0]], np.float32))
    view = np.array([[[0.1, 0.9, 0.2], [0.9, 0.1, 0.2]]], np.float32)
    start = np.full((1, 4, 3), 0.4, np.float32)
    start[0, 3] = 1.7
    best = LeastSquares([[matrix]], start).solve([view])
    assert best.min() >= 0
    assert best.max() <= 1
    assert best[0, 1, 0] == pytest.approx(0, abs=1e-6), "red: the second pixel would be negative"
    assert best[0, 1, 1] == pytest.approx(1, abs=1e-6), "green: it would exceed white"
    assert best[0, 1, 2] == pytest.approx(0.2, abs=5e-3), "blue can be shown"
    assert np.allclose(best[0, 2], 0.4)
    assert np.array_equal(best[0, 3], np.ones(3))


@pytest.mark.usefixtures("renderer")
@pytest.mark.parametrize("lens_model", ["pinhole", "thick"])
def test_planted_eia_is_found_from_its_own_views(lens_model):
    display = small_display()
    eyes = parse_viewpoints("centre,left,up", display)
    matrices, planted = matrices_of(display, lens_model, eyes), smooth_eia(display)
    views = [apply(m, planted).astype(np.float32) for m in matrices]
    best = LeastSquares(matrices, np.full_like(planted, 0.3)).solve([v[None] for v in views])
    assert mean_psnr(matrices, best, views) > 45
    # Panel pixels that make up at least one view pixel are determined.
    weight = sum(np.asarray(m.multiply(m).sum(axis=0)).ravel() for by in matrices for m in by)
    difference = srgb_from_linear(best) - srgb_from_linear(planted)
    error = np.abs(difference).reshape(-1, 3)[weight > 1]
    assert len(error) > 50
    assert np.median(error) < 0.02


@pytest.mark.usefixtures("renderer")
def test_no_other_eia_has_better_views():
    """Neither the start, nor changes of the optimum in random directions, nor another start."""
    display, random = small_display(), np.random.default_rng(4)
    eyes = parse_viewpoints("centre,right", display)
    matrices = matrices_of(display, "thick", eyes)
    shape = display.lens_rows * PER_LENS * display.lens_columns * PER_LENS
    views = [random.uniform(0, 1, (shape, 3)).astype(np.float32) for _ in eyes]
    start = smooth_eia(display)
    best = LeastSquares(matrices, start).solve([v[None] for v in views])
    score = mean_psnr(matrices, best, views)
    assert score > mean_psnr(matrices, start, views) + 0.5
    for size in (0.01, 0.1):
        change = random.normal(0, size, best.shape).astype(np.float32)
        other = linear_from_srgb(np.clip(srgb_from_linear(best) + change, 0, 1))
        assert mean_psnr(matrices, other, views) < score
    dark = LeastSquares(matrices, np.zeros_like(start)).solve([v[None] for v in views])
    assert mean_psnr(matrices, dark, views) == pytest.approx(score, abs=0.05)
