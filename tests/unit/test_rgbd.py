"""An RGB-D picture is consistent, or is not made."""

from typing import Any

import numpy as np
import pytest

from inim.image.rgbd import RGBD
from inim.system.errors import UsageError

COLOR = np.linspace(0, 1, 2 * 3 * 3).reshape(2, 3, 3)
DEPTH = np.arange(6.0).reshape(2, 3)
COVERED = np.array([[1, 1, 0], [1, 1, 1]], bool)


def picture(**changes: Any) -> RGBD:
    return RGBD(
        **{"color": COLOR, "depth_mm": DEPTH, "covered": COVERED, "pixel_mm": 0.25, **changes}
    )


def test_values_are_float32_and_bool_and_do_not_change():
    rgbd = picture(covered=COVERED.astype(int))
    assert rgbd.color.dtype == rgbd.depth_mm.dtype == np.float32
    assert rgbd.covered.dtype == bool
    for name in ("color", "depth_mm", "covered"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(rgbd, name)[0, 0] = 0
    with pytest.raises(AttributeError):
        rgbd.pixel_mm = 1.0  # type: ignore[misc]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"color": COLOR[..., :2]}, r"of shape \(2, 3, 2\)"),
        ({"color": COLOR[..., 0]}, r"of shape \(2, 3\)"),
        ({"color": COLOR[:0], "depth_mm": DEPTH[:0], "covered": COVERED[:0]}, r"shape \(0, 3, 3\)"),
        ({"depth_mm": DEPTH.T}, r"depth_mm \(3, 2\)"),
        ({"covered": COVERED[:1]}, r"covered \(1, 3\)"),
        ({"pixel_mm": 0.0}, r"pixel_mm = 0\.0"),
        ({"pixel_mm": -1.0}, r"pixel_mm = -1\.0"),
        ({"pixel_mm": np.nan}, r"pixel_mm = nan"),
        ({"pixel_mm": np.inf}, r"pixel_mm = inf"),
        ({"depth_mm": np.full((2, 3), np.nan)}, r"5 covered pixels have no finite depth"),
        ({"depth_mm": np.full((2, 3), -np.inf)}, r"5 covered pixels have no finite depth"),
    ],
)
def test_inconsistent_picture_is_refused_with_the_value(changes, message):
    with pytest.raises(UsageError, match=message):
        picture(**changes)


def test_depth_of_an_uncovered_pixel_may_be_anything():
    depth = np.where(COVERED, DEPTH, np.nan)
    assert np.isnan(picture(depth_mm=depth).depth_mm[0, 2])
