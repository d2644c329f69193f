"""Views of a run as products of matrices and panel light, against the display in the renderer.

Expected: for every kind of display, a view equals the rendered one of the same samples up to
rounding, with its exposure and the panel's light; its bits depend neither on the EIA's noise nor on
pixels that it does not observe.
"""

from functools import partial

import numpy as np
import pytest

from inim.display import Display, Viewpoint
from inim.display.lens import white_exposure
from inim.display.misalignment import misaligned, parse_misalignment
from inim.display.panel import seen_light
from inim.image.noisy_image import NoisyEIA
from inim.pipeline.stages.reconstruction import DisplayViews, Optics, reconstruct_views
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.stages.stage import Run
from inim.system.process.observer import Observer
from tests.conftest import small_display

pytestmark = pytest.mark.usefixtures("renderer")

EYES = (
    Viewpoint("centre", 0.0, 0.0, 150.0),
    Viewpoint("eye", 4.0, -3.0, 150.0, pupil_mm=3.0, focus_mm=150.0),
)
PANEL_LIGHT = {
    "black_level": 0.02, "white_point_k": 5000.0, "veiling_glare": 0.05, "ambient_reflection": 0.01,
}  # fmt: skip
LENTICULAR = {
    "lattice": "lenticular", "rotation_deg": 12.0, "subpixels": "rgb-stripe", "lens_rows": 1,
    "panel_rows": 80, "panel_columns": 96,
}  # fmt: skip


def display_views(display: Display, lens_model: str = "thick", spp: int = 16) -> DisplayViews:
    optics = Optics(display, lens_model, 4, spp, seed=7)
    return DisplayViews(EYES, optics, Renderer("auto", Observer()), run=Run())


def random_eia(display: Display, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).random((*display.eia_shape, 3), np.float32)


@pytest.mark.parametrize(
    ("lens_model", "changes", "misalignment"),
    [
        ("pinhole", {}, ""),
        ("thin", {"fill_factor": 0.8, "aperture": "round"}, ""),
        ("thick", PANEL_LIGHT, ""),
        ("thick", {"abbe_number": 30.0, **PANEL_LIGHT}, "rotation_deg=0.3,shift_x_mm=0.05"),
        ("thick", {"subpixels": "rgb-stripe", "pixel_fill": 0.8}, "tilt_x_deg=0.2"),
        ("thick", LENTICULAR, ""),
    ],
)
def test_view_equals_the_rendered_one(lens_model, changes, misalignment):
    from inim.render.reconstruct import DisplayScene

    display = misaligned(small_display(**changes), parse_misalignment(misalignment))
    eia, views = random_eia(display), display_views(display, lens_model)
    products = reconstruct_views("mine", NoisyEIA((eia, None)), views, run=Run())
    scene = DisplayScene(eia, display, lens_model)
    for eye in EYES:
        light = scene.view(eye, pixels_per_lens=4, spp=16, seed=7)
        expected = seen_light(np.float32(white_exposure(display, lens_model)) * light, display)
        assert expected.max() > 0.1
        np.testing.assert_allclose(products[eye.name].image, expected, rtol=0, atol=4e-6)


def test_bits_of_a_view_depend_neither_on_noise_nor_on_pixels_that_it_does_not_observe():
    display = small_display()
    eia, views = random_eia(display), display_views(display)
    assert views.observed is not None
    assert 0 < views.observed.mean() < 1
    elsewhere = np.where(views.observed[..., None], eia, np.float32(9))
    noise = np.float32(0.01) * (random_eia(display, 2) - np.float32(0.5))
    show = partial(reconstruct_views, "mine", views=views, run=Run())
    plain, other, noisy = (
        show(NoisyEIA(arrays)) for arrays in ((eia, None), (elsewhere, None), (eia, noise))
    )
    only_noise = show(NoisyEIA((noise, None)))
    for eye in EYES:
        assert np.array_equal(plain[eye.name].image, other[eye.name].image)
        assert np.array_equal(plain[eye.name].image, noisy[eye.name].image)
        difference = noisy[eye.name].noise - only_noise[eye.name].image
        assert np.abs(difference).max() < 1e-6, "a view is linear in its EIA"
