"""The columns of one picture, which end where their surface does or are solid.

Expected: backs by the rule, in plain loops; sources as defined, in rational numbers, by two oracles
that share no code; what is seen past an object's rim is what lies behind it, or goes on behind it,
and an EIA nearer to the truth than with solid columns.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from inim.errors import UsageError
from inim.generators import HOLE, find_sources, generate, prepare
from inim.generators.oracle import exact_hits
from inim.generators.raycast.columns import STEEPEST, THICKNESS_PX, surface_backs
from inim.generators.registry import properties
from inim.image.color import srgb_from_linear
from inim.image.rgbd import RGBD
from inim.scene.two_spheres import two_spheres, two_spheres_eia
from tests import oracle
from tests.conftest import small_display

SOLID = "template:columns=solid"


def smooth(display, per_pitch, seed=3):
    """Hills and a step, as scenes have: mostly connected neighbours, some jumps, some holes."""
    shape, pixel = display.capture_shape(per_pitch), display.capture_pixel_mm(per_pitch)
    random = np.random.default_rng(seed)
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    low, high = display.depth_range_mm
    wave = np.sin(columns / 3) * np.cos(rows / 4) + 1.6 * (columns > shape[1] // 2)
    depth = np.float32(low + (high - low) * (wave + 1.0) / 3.6)
    covered = (rows + columns) % 11 > 1
    color = random.random((*shape, 3), dtype=np.float32)
    return RGBD(color, depth, covered, pixel)


def test_backs_are_those_of_the_rule():
    rgbd = smooth(small_display(8, 7), 3)
    found = surface_backs(rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
    rows, columns = rgbd.shape
    ended_by = {"neighbour": 0, "thickness": 0, "jump": 0}
    for i in range(rows):
        for j in range(columns):
            if not rgbd.covered[i, j]:
                assert found[i, j] == math.inf
                continue
            here = float(rgbd.depth_mm[i, j])
            low = here - THICKNESS_PX * rgbd.pixel_mm
            kind = "thickness"
            for p in range(max(0, i - 1), min(rows, i + 2)):
                for q in range(max(0, j - 1), min(columns, j + 2)):
                    beside = float(rgbd.depth_mm[p, q])
                    far = math.hypot(p - i, q - j) * rgbd.pixel_mm
                    if rgbd.covered[p, q] and beside < low:
                        if here - beside <= STEEPEST * far:
                            low, kind = beside, "neighbour"
                        else:
                            ended_by["jump"] += 1
            ended_by[kind] += 1
            assert math.isclose(found[i, j], low, rel_tol=1e-6, abs_tol=1e-5)
    assert min(ended_by.values()) > 5, ended_by  # or the test says nothing about one of them


REAL, VIRTUAL = {}, {"focal_length_mm": 3.3, "gap_mm": 3.0}
NON_INTEGER = {"pixel_pitch_mm": 0.13, "panel_columns": 40}


@pytest.mark.parametrize("columns", ["surface", "solid"])
@pytest.mark.parametrize(
    "changes", [REAL, VIRTUAL, NON_INTEGER], ids=["real", "virtual", "non-integer"]
)
def test_every_pixel_shows_the_column_of_the_definition(changes, columns):
    display = small_display(5, 4, 7, **changes)
    rgbd = smooth(display, 3)
    found = find_sources(rgbd, display, f"template:columns={columns}")
    assert np.array_equal(found, oracle.exact_sources(rgbd, display, columns))
    assert exact_hits(rgbd, display, columns).wrong_share(found) == 0
    other = find_sources(rgbd, display, SOLID if columns == "surface" else "template")
    assert ((found != other) & (found >= 0)).any(), "no ray passed behind a column and met another"


def plate_before_a_wall(display, per_pitch=3, *, hole=False):
    """A wall over all of the picture, or but for its left, and a plate before its middle."""
    shape, pixel = display.capture_shape(per_pitch), display.capture_pixel_mm(per_pitch)
    low, high = display.depth_range_mm
    depth = np.full(shape, low + 0.1 * (high - low), np.float32)
    middle = tuple(slice(n // 2 - 5, n // 2 + 5) for n in shape)
    depth[middle] = high - 0.1 * (high - low)
    covered = np.ones(shape, bool)
    if hole:
        covered[:, : shape[1] // 2 - 5] = False
    color = np.zeros((*shape, 3), np.float32)
    color[..., 2] = 1.0
    color[middle] = (1.0, 0.0, 0.0)
    return RGBD(color, depth, covered, pixel)


def test_background_goes_on_behind_what_hides_it():
    display = small_display(9, 9, 9)
    rgbd = plate_before_a_wall(display)
    shown, solid = generate(rgbd, display), generate(rgbd, display, SOLID)
    lensed = display.lensed
    # Solid, the plate smears over what it hides; ended, the wall takes the place of most of that.
    assert (shown[lensed][:, 0] > 0).sum() < 0.8 * (solid[lensed][:, 0] > 0).sum()
    sources = find_sources(rgbd, display)
    wall = (sources >= 0) & (rgbd.color.reshape(-1, 3)[np.maximum(sources, 0), 2] > 0)
    behind = wall & (generate(rgbd, display, SOLID)[..., 0] > 0)
    assert behind.any()
    # Only rays that leave over the picture's border may show nothing.
    inside = np.zeros_like(lensed)
    inside[27:-27, 27:-27] = True
    assert not (sources[inside & lensed] == HOLE).any()


def test_nothing_goes_on_behind_what_hides_it():
    """A ray that passed over open ground last shows the ground, which is black."""
    display = small_display(9, 9, 9)
    rgbd = plate_before_a_wall(display, hole=True)
    sources = find_sources(rgbd, display)
    right = oracle.exact_sources(rgbd, display)
    assert np.array_equal(sources, right)
    closed = find_sources(plate_before_a_wall(display), display)
    assert ((sources == HOLE) & (closed >= 0)).any()


@pytest.mark.parametrize("options", [":samples=4", ""])
@pytest.mark.parametrize("changes", [REAL, NON_INTEGER], ids=["real", "non-integer"])
def test_a_mask_shows_the_bits_of_the_whole(options, changes):
    display = small_display(6, 5, 9, **changes)
    rgbd = smooth(display, 3)
    whole = generate(rgbd, display, "template" + options)
    mask = np.zeros(display.eia_shape, bool)
    mask[::7, ::5] = True
    part = generate(rgbd, display, "template" + options, mask=mask)
    assert np.array_equal(part[mask], whole[mask])
    assert not part[~mask].any()


@pytest.mark.parametrize("columns", ["surface", "solid"])
@pytest.mark.parametrize("changes", [REAL, NON_INTEGER], ids=["real", "non-integer"])
def test_display_ready_and_linear_show_the_same_sources(changes, columns):
    display = small_display(6, 5, 9, **changes)
    rgbd = smooth(display, 3)
    index = np.arange(rgbd.depth_mm.size, dtype=np.uint32).reshape(rgbd.shape) + 1
    words = RGBD(
        index.view(np.uint8).reshape(*rgbd.shape, 4), rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm
    )
    algorithm = f"template:columns={columns}"
    shown = generate(words, display, algorithm).view(np.uint32)[..., 0].astype(np.int64) - 1
    sources = find_sources(rgbd, display, algorithm)
    assert np.array_equal(np.where(shown < 0, HOLE, shown)[display.lensed], sources[display.lensed])


@pytest.mark.parametrize("columns", ["surface", "solid"])
def test_rays_that_share_nothing_agree_but_for_ties(columns):
    still, turned = small_display(8, 7, 11), small_display(8, 7, 11, rotation_deg=1e-9)
    assert not turned.is_separable
    rgbd = replace(smooth(still, 3), pixel_mm=0.2717)
    found = [find_sources(rgbd, d, f"template:columns={columns}") for d in (still, turned)]
    assert (found[0] != found[1])[still.lensed].mean() < 0.02


def test_nearer_to_the_truth_than_solid_columns():
    display = small_display(24, 24, 17)
    rgbd = two_spheres(display, display.capture_shape(5), display.capture_pixel_mm(5))
    truth = srgb_from_linear(two_spheres_eia(display))

    def psnr(algorithm):
        shown = generate(rgbd, display, algorithm)[..., :3] / 255  # 8 bits, sRGB
        return -10 * math.log10(np.mean((shown - truth) ** 2))

    gain = psnr("template:samples=4") - psnr(f"{SOLID}:samples=4")
    assert gain > 4, gain


def test_an_algorithm_says_which_columns_it_shows():
    assert properties("template").columns == "surface" and properties("template").exact
    assert properties(SOLID).columns == "solid" and properties(SOLID).exact
    assert properties("layered").columns == "layers"
    with pytest.raises(UsageError, match="columns = 'open': use surface or solid"):
        prepare(small_display(), "template:columns=open", shape=(60, 70), pixel_mm=0.2)
