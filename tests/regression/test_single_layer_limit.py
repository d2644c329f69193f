"""Limit of a single RGB-D picture.

Expected behaviour: on a two-sphere scene, four samples per pixel of solid columns come within
0.3 dB of what unlimited samples reach, and that limit is the picture's missing data: with true
colours wherever the picture knows what a ray meets, and the template's elsewhere, the score is the
same.
Columns that end are far beyond that limit.
"""

import numpy as np
import pytest

from inim.display import DISPLAYS
from inim.generators import find_sources, generate
from inim.scores import metrics
from tests.conftest import scene_text, sphere

NOMINAL = DISPLAYS["nominal"]
SOLID = "template:columns=solid:colour=nearest"
# Four times the linear resolution of the default capture.
PER_PITCH = 20


@pytest.mark.slow
def test_four_samples_reach_the_single_layer_limit(open_fitted):
    from inim.render.ground_truth import capture, pickup
    from inim.render.rays import pickup_rays
    from inim.render.trace import first_surface

    near, far = sphere((5, 2, 8), 3.5, "0.2,0.5,0.8"), sphere((-4, -1, 0), 6, "0.8,0.3,0.2")
    fitted = open_fitted(scene_text(near, far), NOMINAL)
    truth = pickup(fitted, NOMINAL, spp=128, seed=1).image
    rgbd = capture(fitted, NOMINAL, pixels_per_pitch=PER_PITCH, spp=16, seed=3)
    psnr = {n: metrics.psnr_db(truth, generate(rgbd, NOMINAL, SOLID, samples=n)) for n in (1, 2, 4)}
    limit = metrics.psnr_db(truth, _many_samples(rgbd, 8))
    assert psnr[1] < psnr[2] < psnr[4] <= limit + 0.05
    assert psnr[4] > limit - 0.3
    surface = metrics.psnr_db(truth, generate(rgbd, NOMINAL, samples=4))
    print(
        f"two spheres: solid {psnr[4]:.2f} dB, its limit {limit:.2f} dB, surface {surface:.2f} dB"
    )
    assert surface > limit + 10

    # The limit by what the picture lacks: rays that meet nothing, or what the camera never saw.
    camera = fitted.camera(pickup_rays(NOMINAL, fitted.start_mm))
    covered, points = first_surface(fitted.scene, fitted.integrator, camera)
    eia = generate(rgbd, NOMINAL, SOLID, samples=4)
    side = ~covered & (eia.sum(axis=-1) > 0.02)
    unseen = covered.copy()
    unseen[covered] = ~_seen(rgbd, points, fitted.fit.display_from_world)
    known_elsewhere = np.where((side | unseen)[..., None], eia, truth)
    assert metrics.psnr_db(truth, known_elsewhere) == pytest.approx(limit, abs=0.3)


def _many_samples(rgbd, fold):
    """The template's picture from fold x fold rays a pixel, on a panel so much finer."""
    low, high = NOMINAL.depth_range_mm
    finer = NOMINAL.replace(pixel_pitch_mm=1 / (17 * fold), depth_min_mm=low, depth_max_mm=high)
    sources = find_sources(rgbd, finer, SOLID).reshape(1088, fold, 1088, fold)
    palette = np.concatenate([rgbd.color.reshape(-1, 3), np.zeros((1, 3), np.float32)])
    total = np.zeros((1088, 1088, 3))
    for a in range(fold):
        for b in range(fold):
            total += palette[np.where(sources[:, a, :, b] >= 0, sources[:, a, :, b], -1)]
    return (total / fold**2).astype(np.float32)


def _seen(rgbd, points, display_from_world):
    """True where the picture holds the point that a ray meets, within a pixel and 0.5 mm."""
    at = points @ display_from_world[:3, :3].T + display_from_world[:3, 3]
    rows, columns = rgbd.shape
    is_in_picture = np.zeros(len(points), bool)
    column = np.floor(at[:, 0] / rgbd.pixel_mm + columns / 2).astype(int)
    row = np.floor(rows / 2 - at[:, 1] / rgbd.pixel_mm).astype(int)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            r, c = np.clip(row + down, 0, rows - 1), np.clip(column + right, 0, columns - 1)
            is_in_picture |= rgbd.covered[r, c] & (np.abs(rgbd.depth_mm[r, c] - at[:, 2]) < 0.5)
    return is_in_picture
