"""An RGB-D picture is consistent, or is not made."""

from typing import Any

import numpy as np
import pytest

from inim.image.rgbd import RGBD, Layer, LayeredRGBD
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


def test_it_shows_its_size_and_the_depths_of_covered_pixels_alone():
    depth = np.full((1000, 500), np.nan)
    depth[3:997, 5:495], depth[501, 101] = 20, 12.5  # which is not in the thumbnail
    color = np.zeros((*depth.shape, 3))
    rgbd = RGBD(color, depth, np.isfinite(depth), 0.2)
    assert repr(rgbd) == "RGBD(500 x 1000 pixels of 0.2 mm, 97.4% covered, 12.5 to 20 mm)"
    html = rgbd._repr_html_()
    assert html.count("<img ") == 2
    assert html.endswith(f"<br>{rgbd!r}")
    assert len(html) < 20_000
    empty = picture(covered=np.zeros_like(COVERED))
    assert "empty" in repr(empty) and "empty" in empty._repr_html_()
    back, uncovered = np.full(depth.shape, -np.inf), np.zeros(depth.shape, bool)
    deeper = (Layer(rgbd.color, depth, back, uncovered),)
    layered = LayeredRGBD(color, depth, rgbd.covered, 0.2, back, deeper)
    assert repr(layered).startswith("LayeredRGBD(500 x 1000 pixels of 0.2 mm, 2 layers, 97.4%")


def test_depth_of_an_uncovered_pixel_may_be_anything():
    depth = np.where(COVERED, DEPTH, np.nan)
    assert np.isnan(picture(depth_mm=depth).depth_mm[0, 2])
