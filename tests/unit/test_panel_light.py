"""Light of a real panel: black level, white point, reflected room light, veiling glare."""

import math

import numpy as np
import pytest

from inim.display import DISPLAYS, Viewpoint
from inim.display.panel import emitted_picture, seen_light, white_of
from inim.image.color import srgb_from_linear
from inim.pipeline.stages.reconstruction import DisplayedEIA, Optics
from inim.pipeline.stages.scene import Renderer
from inim.system.errors import DisplayError
from inim.system.process.observer import Observer
from tests.conftest import small_display

NOMINAL = DISPLAYS["nominal"]
PANEL = {"black_level": 0.01, "white_point_k": 9300.0}
EYE = Viewpoint("eye", 3.0, 2.0, 150.0)


def picture(shape, seed=1):
    return np.random.default_rng(seed).random((*shape, 3), np.float32)


def test_contrast_is_that_of_the_black_level():
    display = NOMINAL.replace(black_level=1 / 1000)
    black, white = (emitted_picture(np.full((1, 1, 3), v, np.float32), display) for v in (0, 1))
    assert white == pytest.approx(1)
    assert white / black == pytest.approx(1000)


def test_glare_keeps_the_mean_and_reflected_light_adds_to_it():
    view = picture((6, 7))
    display = NOMINAL.replace(veiling_glare=0.2, ambient_reflection=0.03)
    light = seen_light(view, display)
    means = view.mean(axis=(0, 1))
    assert light.dtype == np.float32
    assert light.mean(axis=(0, 1)) == pytest.approx(means + 0.03, rel=1e-5)
    assert light - 0.03 == pytest.approx(0.8 * view + 0.2 * means, rel=1e-5)


# CIE 15: chromaticities of D50, D55, D65 and D75.
@pytest.mark.parametrize(
    ("kelvin", "x", "y"),
    [
        (5003, 0.3457, 0.3585), (5503, 0.3324, 0.3474), (6504, 0.3127, 0.3290),
        (7504, 0.2990, 0.3149),
    ],
)  # fmt: skip
def test_white_point_is_that_of_daylight(kelvin, x, y):
    white = np.array(white_of(NOMINAL.replace(white_point_k=kelvin)))
    # Primaries and white of sRGB, IEC 61966-2-1.
    primaries = np.array([(0.64, 0.33, 0.03), (0.30, 0.60, 0.10), (0.15, 0.06, 0.79)]).T
    d65 = np.array([0.3127, 0.3290, 0.3583]) / 0.3290
    xyz = (primaries * np.linalg.solve(primaries, d65)) @ white
    assert xyz[:2] / xyz.sum() == pytest.approx((x, y), abs=2e-4)
    assert white.max() == 1


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("black_level", 1.0), ("black_level", -0.1), ("ambient_reflection", 1.5),
        ("veiling_glare", math.nan), ("white_point_k", 3000.0),
    ],
)  # fmt: skip
def test_impossible_light_is_refused_in_a_line(name, value):
    with pytest.raises(DisplayError, match=f"^{name} = .*: must be") as error:
        NOMINAL.replace(**{name: value})
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("model", "subpixels"),
    [("pinhole", "none"), ("thick", "none"), ("thick", "rgb-stripe"), ("full", "none")],
)
def test_renderer_emits_as_numpy_does(renderer, model, subpixels):
    """A view of the drive is the view of the emitted light on an ideal panel."""
    from inim.render.reconstruct import DisplayScene

    ideal = small_display(8, 6, pixels=8, subpixels=subpixels)
    panel = ideal.replace(**PANEL)
    eia = picture(ideal.eia_shape)
    views = [
        DisplayScene(image, display, model).view(EYE, pixels_per_lens=2, spp=16, seed=1)
        for image, display in ((eia, panel), (emitted_picture(eia, panel), ideal))
    ]
    assert views[0] == pytest.approx(views[1], abs=1e-6)
    assert np.abs(views[0] - DisplayScene(eia, ideal, model).view(
        EYE, pixels_per_lens=2, spp=16, seed=1
    )).max() > 0.01  # fmt: skip


def test_view_of_a_black_picture_is_as_bright_as_black_level_and_room(renderer):
    """The middle of the display counts, where all lenses show the panel."""
    display = small_display(8, 6, pixels=8, black_level=0.001, ambient_reflection=0.01)
    black = np.zeros((*display.eia_shape, 3), np.float32)
    optics = Optics(display, "thick", 4, 64, 0)
    view = DisplayedEIA(black, None, optics, Renderer("llvm", Observer())).view(
        Viewpoint("e", 0, 0, 400.0), 0
    )
    assert view[10:14, 14:18].mean() == pytest.approx(0.011, rel=0.01)
    assert srgb_from_linear(view).min() >= srgb_from_linear(np.array(0.01))
