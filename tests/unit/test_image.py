"""Pictures in and out, whole or not at all; scores against known values."""

import math

import numpy as np
import OpenEXR
import pytest
from PIL import Image
from skimage.metrics import structural_similarity

from inim.image.color import srgb_from_linear, srgb_to_uint8
from inim.image.files import image
from inim.image.noisy_image import NoisyImage
from inim.image.rgbd import RGBD
from inim.scores import metrics
from inim.scores.regression.scores import view_scores
from inim.system.errors import FileError, UsageError
from inim.system.process.atomic_file import write_atomically

RANDOM = np.random.default_rng(3)


def picture(rows=9, columns=13):
    return RANDOM.random((rows, columns, 3)).astype(np.float32)


def test_exr_and_rgbd_come_back_bit_for_bit(tmp_path):
    linear = picture() * 50
    image.write_exr(tmp_path / "a.exr", linear)
    assert np.array_equal(image.read_exr(tmp_path / "a.exr"), linear)
    covered = RANDOM.random((9, 13)) > 0.5
    depth = np.where(covered, RANDOM.random((9, 13)) * 40, 0).astype(np.float32)
    rgbd = RGBD(linear, depth, covered, 0.2)
    image.write_rgbd(tmp_path / "b.exr", rgbd)
    again = image.read_rgbd(tmp_path / "b.exr")
    assert np.array_equal(again.color, rgbd.color)
    assert np.array_equal(again.covered, covered)
    assert np.array_equal(again.depth_mm[covered], depth[covered])
    assert again.pixel_mm == rgbd.pixel_mm


def test_the_rgbd_file_has_a_colour_part_and_a_depth_part(tmp_path):
    covered = np.array([[True, False]])
    rgbd = RGBD(np.ones((1, 2, 3)), np.array([[5.0, 7.0]]), covered, 1.0)
    image.write_rgbd(tmp_path / "a.exr", rgbd)
    parts = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True).parts
    assert [sorted(p.channels) for p in parts] == [["A", "B", "G", "R"], ["Z"]]
    depth = parts[1].channels["Z"].pixels
    assert depth[0, 0] == 5 and math.isnan(depth[0, 1]), "background is no depth"


def test_png_is_srgb_and_upright(tmp_path):
    linear = np.zeros((2, 3, 3), np.float32)
    linear[0, 2] = (1.0, 0.21404114, 0.0)
    image.write_png(tmp_path / "a.png", linear)
    codes = np.asarray(Image.open(tmp_path / "a.png"))
    assert codes.dtype == np.uint8 and codes.shape == (2, 3, 3)
    assert tuple(codes[0, 2]) == (255, 128, 0), "linear 0.214 is middle grey"
    assert codes.sum() == 383


def test_srgb_is_the_standard_s_at_known_points():
    points = {0.0: 0.0, 0.0031308: 0.0404499, 0.18: 0.4613561, 0.5: 0.7353570, 1.0: 1.0, 7.0: 1.0}
    for linear, expected in points.items():
        assert srgb_from_linear(np.array([linear]))[0] == pytest.approx(expected, abs=2e-6)
    assert srgb_to_uint8(np.array([0.5 / 255, 0.51 / 255, -1, 2])).tolist() == [0, 1, 0, 255]


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    (tmp_path / "a.png").write_text("old")

    def fail(path):
        path.write_text("half")
        raise OSError(28, "No space left on device")

    with pytest.raises(FileError, match=r"a\.png.*No space left"):
        write_atomically(tmp_path / "a.png", fail)
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]
    assert (tmp_path / "a.png").read_text() == "old"


@pytest.mark.parametrize("shape", [(11, 11), (40, 57), (256, 200)])
def test_ssim_is_scikit_image_s_own_number(shape):
    rng = np.random.default_rng(3)
    a, b = (rng.random((*shape, 3)).astype(np.float32) for _ in range(2))
    b[3:-2, : shape[1] // 2] = a[3:-2, : shape[1] // 2]
    codes = srgb_from_linear(a), srgb_from_linear(b)
    (ssim,) = (metric for metric in metrics.all_metrics() if metric.name == "ssim")
    expected = structural_similarity(*codes, **ssim.settings)
    assert metrics.ssim(a, b) == pytest.approx(expected, abs=1e-6)
    assert metrics.score(a, b)["ssim"] == metrics.eia_scores(a, b)["ssim"] == metrics.ssim(a, b)
    images = NoisyImage.from_image(a), NoisyImage.from_image(b)
    assert view_scores(*images, keys=["ssim"])["ssim"].value == pytest.approx(expected, abs=1e-6)
    assert abs(metrics.ssim_map(a, b).mean() - expected) > 1e-4, "its map's mean is another number"


def test_the_relic_s_region_has_the_pixels_within_ssim_s_window_of_it():
    relic = np.zeros((30, 40), bool)
    relic[14, 20] = relic[0, 39] = True
    a = np.zeros((30, 40, 3), np.float32)  # black, so that no change is lost in rounding
    b = a.copy()
    b[relic] += 0.5
    region = metrics.relic_region(relic)
    assert np.array_equal(region, metrics.ssim_map(a, b) < 1)
    assert region.sum() == 11 * 11 + 6 * 6
    assert metrics.score(a, b, region)["ssim_on_relic"] < metrics.score(a, b)["ssim"]


def test_score_on_the_relic_leaves_out_the_border_that_the_whole_one_does():
    rng = np.random.default_rng(4)
    a, b = (rng.random((40, 40, 3)).astype(np.float32) for _ in range(2))
    everywhere = metrics.score(a, b, np.ones((40, 40), bool))
    for metric in metrics.all_metrics():
        assert everywhere[metric.on_relic_key] == pytest.approx(everywhere[metric.key], rel=1e-12)
    border = np.ones((40, 40), bool)
    border[5:-5, 5:-5] = False
    assert math.isnan(metrics.ssim(a, b, border))


def test_scores_of_equal_pictures_are_perfect_and_worse_ones_lower():
    a = picture(32, 32)
    assert metrics.score(a, a) == {"ssim": 1.0, "psnr_db": math.inf, "flip": 0.0}
    near, far = (np.clip(a + d, 0, 1).astype(np.float32) for d in (0.02, 0.2))
    for name, sign in (("ssim", 1), ("psnr_db", 1), ("flip", -1)):
        assert sign * metrics.score(a, near)[name] > sign * metrics.score(a, far)[name]


@pytest.mark.parametrize("scorer", [metrics.ssim, metrics.psnr_db, metrics.flip])
def test_pictures_that_are_not_comparable_are_refused(scorer):
    a = picture(16, 16)
    with pytest.raises(UsageError, match="compared"):
        scorer(a, a[:8])
    b = a.copy()
    b[3, 3] = np.nan
    with pytest.raises(UsageError, match="1 pixels that are not finite; replace them"):
        scorer(a, b)
