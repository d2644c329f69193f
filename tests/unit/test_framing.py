"""`--fit auto`: the subject, its depth range and its place are found where there is one."""

from pathlib import Path

import numpy as np
import pytest

from inim.apps.own_picture.depth_values import DepthValues
from inim.apps.own_picture.framing import choose_framing
from inim.apps.own_picture.picture import CameraPicture, ColorDepth
from inim.display import DISPLAYS
from tests.conftest import small_display


def values(depth, near_is_large=False, has_unit=True):
    return DepthValues(np.asarray(depth, np.float32), near_is_large, has_unit, 0.0, ())


def box(rows=300, columns=400, at=(120, 220), size=(60, 80), near=500.0, far=3000.0):
    """A box before a wall, its front bulging by 50."""
    depth = np.full((rows, columns), far)
    y, x = (slice(a, a + s) for a, s in zip(at, size, strict=True))
    bulge = np.sin(np.linspace(0, np.pi, size[1]))[None]
    depth[y, x] = near + 50 * (1 - bulge)
    return depth


def test_the_subject_is_the_part_in_front_of_the_background():
    framing = choose_framing(values(box()), 2.0)
    assert framing.near == pytest.approx(500, abs=1)
    nearness = 1 / 500, 1 / 550
    # A flat subject is given a tenth of the picture's range, and half of that behind it.
    extent = max(nearness[0] - nearness[1], 0.1 * (1 / 500 - 1 / 3000))
    assert framing.far == pytest.approx(1 / (nearness[1] - extent / 2), rel=0.01)
    assert 500 < framing.subject_depth < 550
    assert "nearer than" in framing.notes["subject"]


@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.5])
@pytest.mark.parametrize("at", [(0, 0), (120, 160), (240, 320)])
def test_cover_has_the_display_s_shape_and_the_whole_subject(aspect, at):
    framing = choose_framing(values(box(at=at)), aspect)
    high = framing.rows.stop - framing.rows.start
    wide = framing.columns.stop - framing.columns.start
    assert wide / high == pytest.approx(aspect, rel=0.01)
    assert high == 300 or wide == 400  # as much as there is
    if "none" in framing.notes["subject"]:  # in the corner the rim weighs little
        assert at != (120, 160)
        return
    assert framing.rows.start <= at[0]
    assert at[0] + 60 <= framing.rows.stop
    assert framing.columns.start <= at[1]
    assert at[1] + 80 <= framing.columns.stop


def test_a_subject_that_cover_cuts_is_in_the_middle_and_a_note_names_the_loss():
    framing = choose_framing(values(box(at=(20, 150), size=(260, 100))), 4.0)
    assert framing.columns == slice(0, 400)
    assert framing.rows.stop - framing.rows.start == 100
    assert abs(framing.rows.start + 50 - (20 + 130)) <= 5
    assert "% of the subject; --fit contain shows all" in framing.notes["crop"]


@pytest.mark.parametrize("kind", ["ramp", "flat", "noise"])
def test_where_there_is_no_subject_all_depths_are_mapped(kind):
    rng = np.random.default_rng(1)
    nearness = {
        "ramp": np.tile(np.linspace(1, 2, 300)[:, None], (1, 400)),
        "flat": np.full((300, 400), 1.5),
        "noise": rng.normal(5, 0.5, (300, 400)),
    }[kind]
    framing = choose_framing(values(1000 / nearness), 2.0)
    depth = (1000 / nearness).astype(np.float32)
    # Half a percent of the weight at either end, which is less than that of the pixels at the rim.
    assert ((depth >= framing.near) & (depth <= framing.far)).mean() > 0.95
    assert framing.rows == slice(50, 250) and framing.columns == slice(0, 400)
    assert framing.notes["subject"].startswith("none")


def test_missing_depth_and_a_mirror_change_nothing():
    depth = box()
    depth[:40] = np.nan
    a, b = choose_framing(values(depth), 2.0), choose_framing(values(depth[:, ::-1]), 2.0)
    assert (a.near, a.far, a.rows) == (b.near, b.far, b.rows)
    assert abs(a.columns.start - (400 - b.columns.stop)) <= 1


def test_a_finger_at_the_rim_is_no_subject():
    depth = box()
    depth[:20, :20] = 100
    framing = choose_framing(values(depth), 2.0)
    assert framing.near == pytest.approx(500, abs=1)


@pytest.mark.parametrize("near_is_large", [False, True])
def test_an_end_that_is_stated_alone_has_the_other_beyond_it(near_is_large):
    depth = box()
    depths = values(depth.max() + depth.min() - depth if near_is_large else depth, near_is_large)
    photograph = ColorDepth(
        np.zeros((*depth.shape, 3), np.uint8), depths, 1.0, (400, 300), 0.0, (), None
    )

    def ends(**stated):
        picture = CameraPicture(photo=Path("p.jpg"), orthographic=True, fit="auto", **stated)
        depth_map = picture.fit_to(photograph, small_display(), 1)[1]
        return depth_map.near, depth_map.far

    near, far = ends()
    farthest = float(depths.depth.min() if near_is_large else depths.depth.max())
    assert ends(near=near) == (near, far)
    # Behind what the framing takes for the far end, and in front of the background.
    behind = (far + (farthest - far) / 2, farthest)
    assert ends(near=behind[0]) == pytest.approx(behind)


@pytest.mark.parametrize(("shape", "is_turned"), [((40, 30), True), ((30, 40), False)])
def test_a_wide_display_is_turned_for_an_upright_picture_only(shape, is_turned):
    photograph = ColorDepth(
        np.zeros((*shape, 3), np.uint8), values(np.ones(shape)), 1.0, shape[::-1], 0.0, (), None
    )
    phone = DISPLAYS["phone"]
    display = CameraPicture(photo=Path("p.jpg")).orient(photograph, phone)
    assert display.eia_shape == (phone.eia_shape[::-1] if is_turned else phone.eia_shape)
    assert (display.height_mm > display.width_mm) == is_turned
