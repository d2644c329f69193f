"""Orientation: mirrors, occlusion, parallax, focus. A flipped picture passes many tests."""

import numpy as np
import pytest

from inim.display import Viewpoint
from inim.generators import generate
from tests.conftest import scene_text, small_display, sphere, square

pytestmark = pytest.mark.usefixtures("renderer")

RED, GREEN = "0.8,0.05,0.05", "0.05,0.8,0.05"


_rendered: dict = {}


def truth_of(open_fitted, text, display, viewpoint, spp=64, seed=1):
    """RGB-D, true EIA, true view of a scene; the same ones are rendered once."""
    from inim.render.ground_truth import capture, pickup, true_view

    fitted = open_fitted(text, display)
    captured = (text, display, spp, seed)
    if captured not in _rendered:
        rgbd = capture(fitted, display, pixels_per_pitch=5, spp=spp, seed=seed)
        _rendered[captured] = rgbd, pickup(fitted, display, spp=spp, seed=seed + 1).image
    if (view := (*captured, viewpoint)) not in _rendered:
        _rendered[view] = true_view(
            fitted, display, viewpoint, pixels_per_lens=4, spp=spp, seed=seed + 2
        )[0].image
    rgbd, eia = _rendered[captured]
    return rgbd, eia.copy(), _rendered[view].copy()


def seen_through(eia, display, viewpoint, lens_model="pinhole", seed=0):
    from inim.render.reconstruct import reconstruct

    return reconstruct(eia, display, viewpoint, lens_model, spp=64, seed=seed)


def is_red(image):
    return (image[..., 0] > 0.1) & (image[..., 0] > 3 * image[..., 1])


def is_green(image):
    return (image[..., 1] > 0.1) & (image[..., 1] > 3 * image[..., 0])


@pytest.mark.parametrize("size", [(12, 10, 8), (11, 9, 7)])
def test_a_mirror_symmetric_scene_gives_mirror_symmetric_pictures(open_fitted, size):
    """A mirrored picture differs from its original no more than another seed does."""
    display = small_display(*size)
    # A sphere with a smaller one on either side and above and below: symmetric both ways.
    around = [(5, 0, 1), (-5, 0, 1), (0, 5, 1), (0, -5, 1)]
    text = scene_text(sphere((0, 0, 0), 4), *(sphere(place, 1.0, RED) for place in around))
    first, other = (_all_pictures(open_fitted, text, display, seed) for seed in (1, 100))
    for name, picture in first.items():
        noise = np.abs(picture - other[name]).mean()
        for axis in (0, 1):
            mirrored = np.flip(other[name], axis)
            error = np.abs(picture - mirrored).mean()
            assert error < 1.25 * noise + 1e-4, (name, axis)
            shifted = np.abs(picture - np.roll(mirrored, 1, axis)).mean()
            assert shifted > 1.25 * error, (name, axis, "a pixel's shift would have been seen")


def _all_pictures(open_fitted, text, display, seed):
    centre = Viewpoint("centre", 0, 0, 120)
    rgbd, eia, view = truth_of(open_fitted, text, display, centre, spp=256, seed=seed)
    return {
        "true EIA": eia,
        "true view": view,
        "template": generate(rgbd, display, "template"),
        "wang2024": generate(rgbd, display, "wang2024"),
        "view of the true EIA": seen_through(eia, display, centre, seed=seed),
        "thick view": seen_through(eia, display, centre, "thick", seed=seed),
    }


# The same pair of squares in a display with real images, in front, and with virtual ones, behind.
REAL = {}
VIRTUAL = {"focal_length_mm": 3.3, "gap_mm": 3.0}


@pytest.mark.parametrize("mode", [REAL, VIRTUAL], ids=["real", "virtual"])
@pytest.mark.parametrize("algorithm", ["template", "wang2024", "truth"])
def test_the_nearer_of_two_overlapping_squares_hides_the_other(open_fitted, mode, algorithm):
    display = small_display(16, 16, pixels=9, **mode)
    centre = Viewpoint("centre", 0, 0, 200)
    text = scene_text(square((0, 0, 0), 5, GREEN), square((0, 0, 4), 2, RED))
    rgbd, eia, view = truth_of(open_fitted, text, display, centre)
    if algorithm != "truth":
        eia = generate(rgbd, display, algorithm)
    image = seen_through(eia, display, centre)
    middle = image[28:36, 28:36]
    assert is_red(view[28:36, 28:36]).all(), "the scene itself"
    assert is_red(middle).mean() > 0.9, "the nearer square is red"
    assert is_green(image).sum() > 200, "the farther one is seen around it"


@pytest.mark.parametrize("mode", [REAL, VIRTUAL], ids=["real", "virtual"])
@pytest.mark.parametrize("source", ["template", "truth", "view"])
def test_the_nearer_square_moves_against_the_eye(open_fitted, mode, source):
    """The nearer square is farther right than the farther one for the left eye."""
    display = small_display(16, 16, pixels=9, **mode)
    text = scene_text(square((0, 0, 0), 5, GREEN), square((0, 0, 4), 1.5, RED))
    offset = {}
    for name, place in (
        ("left", (-10, 0)),
        ("right", (10, 0)),
        ("up", (0, 10)),
        ("down", (0, -10)),
    ):
        viewpoint = Viewpoint(name, *place, 200)
        rgbd, eia, view = truth_of(open_fitted, text, display, viewpoint)
        if source == "template":
            eia = generate(rgbd, display, "template")
        image = view if source == "view" else seen_through(eia, display, viewpoint)
        offset[name] = _centroid(is_red(image)) - _centroid(is_red(image) | is_green(image))
    rows, columns = 0, 1
    assert offset["left"][columns] > 0.3 and offset["right"][columns] < -0.3
    assert offset["up"][rows] > 0.3, "from above, the nearer square stands lower: a larger row"
    assert offset["down"][rows] < -0.3


def _centroid(mask):
    assert mask.any()
    return np.array([indices.mean() for indices in np.nonzero(mask)])


@pytest.mark.parametrize(
    ("lens_model", "bar", "source"), [("pinhole", 3.0, "truth"), ("thick", 1.5, "template")]
)
def test_a_flat_plate_at_the_central_depth_plane_is_sharp(open_fitted, lens_model, bar, source):
    """Bars of 2.5 panel pixels' images are seen at the CDP; far off it a lens blurs them.

    At twice the CDP's distance the aperture, 1 mm, smears a point over 1 mm of the plate. Pinholes
    sample at their pitch and have no focus: they get wider bars and no blur.
    """
    count = round(16 / bar) + 1
    bars = [
        square((bar * (i - count // 2), 0, 0), (bar / 2, 8), "0.8" if i % 2 else "0.05")
        for i in range(count)
    ]
    centre = Viewpoint("centre", 0, 0, 220)
    at = small_display(18, 18, pixels=17)
    # A depth range beyond the focus puts the plate there.
    off = at.replace(depth_min_mm=60.0, depth_max_mm=70.0)
    likeness = {}
    for name, display in (("at", at), ("off", off)):
        rgbd, eia, view = truth_of(open_fitted, scene_text(*bars), display, centre)
        if source == "template":
            eia = generate(rgbd, display, "template")
        image = seen_through(eia, display, centre, lens_model)
        likeness[name] = np.corrcoef(_profile(view), _profile(image))[0, 1]
    assert likeness["at"] > 0.7
    if lens_model == "thick":
        assert likeness["off"] < likeness["at"] - 0.3


def _profile(image):
    """Brightness along the middle rows, the ends left out."""
    rows, columns = image.shape[:2]
    middle = image[rows // 2 - 4 : rows // 2 + 4, columns // 5 : -columns // 5, 1]
    return middle.mean(axis=0)


@pytest.mark.parametrize("lens_model", ["pinhole", "thick"])
def test_the_reconstruction_shows_the_eia_upright_and_unmirrored(lens_model):
    """Every lens shows one flat colour: the view must be that picture, the right way round."""
    display = small_display(7, 5, pixels=8)
    letter = np.zeros((5, 7, 3), np.float32)
    letter[:, 1] = letter[0, 1:5] = letter[2, 1:4] = 1.0  # an F: no symmetry at all
    eia = letter.repeat(8, axis=0).repeat(8, axis=1)
    image = seen_through(eia, display, Viewpoint("centre", 0, 0, 400), lens_model)
    by_lens = image.reshape(5, 4, 7, 4, 3).mean(axis=(1, 3))
    weight = by_lens.max()
    assert np.abs(by_lens / weight - letter).max() < 0.08, "crosstalk at the seams aside"
    expected = 1.0 if lens_model == "pinhole" else (4 * 1.4917 / 2.4917**2) ** 2
    assert weight == pytest.approx(expected, rel=2e-3), "Fresnel loss of two faces, no other"
