"""Inputs of `inim.generate` and `inim.reconstruct`: values and names alike, and wrong ones named.

Expected: a preset's name, a display file and a `Display` give the same EIA and view; what would
silently give a wrong picture is refused with the remedy, or warned of.
"""

import warnings

import numpy as np
import pytest

import inim
from inim.display import DISPLAYS, Viewpoint
from inim.display.viewpoint import parse_viewpoints, viewpoint_of
from inim.system.errors import InimError, UsageError
from tests.conftest import small_display

NOMINAL = DISPLAYS["nominal"]
SMALL = NOMINAL.replace(lens_columns=6, lens_rows=5)
FILE = """<scene version="3.0.0"><default name="inim.lens_columns" value="6"/>
<default name="inim.lens_rows" value="5"/></scene>"""
EIA = np.full((*NOMINAL.eia_shape, 3), 0.5, np.float32)


def picture(
    depth_mm: float = 33.0, color: float = 0.5, display: inim.Display = NOMINAL
) -> inim.RGBD:
    """A flat picture of one colour."""
    shape = display.capture_shape(5)
    colors = np.full((*shape, 3), color, np.float32)
    return inim.RGBD(colors, np.full(shape, depth_mm), np.ones(shape, bool), display.pitch_mm / 5)


def test_a_display_is_a_value_a_name_or_a_file(tmp_path):
    path = tmp_path / "mine.xml"
    path.write_text(FILE)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        eia = inim.generate(picture(), "nominal", "gu2020")
        mine = inim.generate(picture(display=SMALL), path)
    assert np.array_equal(eia, inim.generate(picture(), NOMINAL, "gu2020"))
    assert np.array_equal(mine, inim.generate(picture(display=SMALL), SMALL))
    assert np.array_equal(mine, inim.generate(picture(display=SMALL), str(path)))


@pytest.mark.parametrize("text", ["centre", "mine=10 -5", "mine=10 -5 600"])
def test_a_viewpoint_is_a_value_or_its_text(renderer, text):
    eye = viewpoint_of(text, NOMINAL)
    options = {"pixels_per_lens": 1, "spp": 2}
    view = inim.reconstruct(EIA, "nominal", text, **options)
    assert np.array_equal(view, inim.reconstruct(EIA, NOMINAL, eye, **options))


def test_a_viewpoint_is_a_position_in_millimetres(renderer):
    options = {"pixels_per_lens": 1, "spp": 2}
    view = inim.reconstruct(EIA, NOMINAL, (-20, 5.5, 400), **options)
    eye = Viewpoint("eye", -20, 5.5, 400)
    assert np.array_equal(view, inim.reconstruct(EIA, NOMINAL, eye, **options))
    names = [eye.name for eye in parse_viewpoints([(-20, 5.5, 400), (0, 0, 400)], NOMINAL)]
    assert names == ["-20_5.5_400", "0_0_400"]


@pytest.mark.parametrize(
    ("eia", "display", "viewpoint", "says"),
    [
        ((EIA * 255).astype(np.uint8), "nominal", "centre", "eia: is uint8; give linear RGB"),
        (EIA * np.nan, "nominal", "centre", "values are not finite; replace them"),
        (EIA[1:], "nominal", "centre", "needs"),
        (EIA, "nominl", "centre", "did you mean nominal"),
        (EIA, 3, "centre", "display: 3 is a int; give a Display"),
        (EIA, "nominal", "center", "did you mean centre"),
        (EIA, "nominal", Viewpoint("far", 900, 0, 300), "outside the viewing zone"),
        (EIA, "nominal", (0, 400), r"viewpoints: 0 is a int; .* or \(x, y, z\) in mm"),
        (EIA, "gone.xml", "centre", "gone.xml: no such file"),
    ],
)
def test_wrong_inputs_of_reconstruct_are_one_line(renderer, eia, display, viewpoint, says):
    with pytest.raises(InimError, match=says) as raised:
        inim.reconstruct(eia, display, viewpoint)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("rgbd", "says"),
    [
        (picture(color=np.nan), "pixels have colours that are not finite; mend them"),
        (np.zeros((9, 9, 3)), "rgbd: is a ndarray; give an inim.RGBD"),
    ],
)
def test_wrong_pictures_of_generate_are_one_line(rgbd, says):
    with pytest.raises(UsageError, match=says):
        inim.generate(rgbd, "nominal")


def test_depth_in_metres_is_warned_of():
    with pytest.warns(UserWarning, match=r"100% of it is outside .* depths are 0.033 to 0.033"):
        inim.generate(picture(depth_mm=0.033, display=small_display()), small_display())
