"""`template:columns=surface`: columns that end where their surface does.

Expected: backs by the rule, in plain loops; sources as defined, in rational numbers; what is seen
past an object's rim is what lies behind it, and an EIA nearer to the truth than with solid columns.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from inim.color import srgb_from_linear
from inim.errors import UsageError
from inim.generators import HOLE, find_sources, generate, prepare
from inim.generators.raycast.surfaces import STEEPEST, THICKNESS_PX, surface_backs, with_backs
from inim.generators.registry import properties
from inim.rgbd import RGBD
from inim.scene.two_spheres import two_spheres, two_spheres_eia
from tests.conftest import small_display
from tests.unit.test_layered import exact

SURFACE = "template:columns=surface"


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
                assert found[i, j] == 0
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


@pytest.mark.parametrize(
    "changes",
    [{}, {"focal_length_mm": 3.3, "gap_mm": 3.0}, {"pixel_pitch_mm": 0.13, "panel_columns": 40}],
    ids=["real", "virtual", "non-integer"],
)
def test_every_pixel_shows_the_column_of_the_definition(changes):
    display = small_display(5, 4, 7, **changes)
    rgbd = smooth(display, 3)
    found = find_sources(rgbd, display, SURFACE)
    wanted = exact(with_backs(rgbd), display)
    assert np.array_equal(found, wanted)
    solid = find_sources(rgbd, display, "template")
    behind = (found != solid) & (found >= 0)
    assert behind.any(), "no ray passed behind a column and met another"


@pytest.mark.parametrize("options", [":samples=4", ""])
def test_a_mask_shows_the_bits_of_the_whole(options):
    display = small_display(6, 5, 9)
    rgbd = smooth(display, 3)
    whole = generate(rgbd, display, SURFACE + options)
    mask = np.zeros(display.eia_shape, bool)
    mask[::7, ::5] = True
    part = generate(rgbd, display, SURFACE + options, mask=mask)
    assert np.array_equal(part[mask], whole[mask])
    assert not part[~mask].any()


def test_display_ready_and_linear_show_the_same_sources():
    display = small_display(6, 5, 9)
    rgbd = smooth(display, 3)
    index = np.arange(rgbd.depth_mm.size, dtype=np.uint32).reshape(rgbd.shape) + 1
    words = RGBD(
        index.view(np.uint8).reshape(*rgbd.shape, 4), rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm
    )
    shown = generate(words, display, SURFACE).view(np.uint32)[..., 0].astype(np.int64) - 1
    sources = find_sources(rgbd, display, SURFACE)
    assert np.array_equal(np.where(shown < 0, HOLE, shown)[display.lensed], sources[display.lensed])


def test_arrays_that_are_turned_have_it_too():
    display = small_display(6, 5, 9, rotation_deg=1.3)
    rgbd = smooth(display, 3)
    found = find_sources(rgbd, display, SURFACE)
    solid = find_sources(rgbd, display, "template")
    assert (found == HOLE).sum() > (solid == HOLE).sum()


def test_nearer_to_the_truth_than_solid_columns():
    display = small_display(24, 24, 17)
    rgbd = two_spheres(display, display.capture_shape(5), display.capture_pixel_mm(5))
    truth = srgb_from_linear(two_spheres_eia(display))

    def psnr(algorithm):
        shown = generate(rgbd, display, algorithm)[..., :3] / 255  # 8 bits, sRGB
        return -10 * math.log10(np.mean((shown - truth) ** 2))

    gain = psnr(f"{SURFACE}:samples=4") - psnr("template:samples=4")
    assert gain > 4, gain


def test_it_promises_no_first_hits_in_solid_columns():
    assert properties("template").exact
    assert not properties(SURFACE).exact
    with pytest.raises(UsageError, match="columns = 'open': use solid or surface"):
        prepare(small_display(), "template:columns=open", shape=(60, 70), pixel_mm=0.2)
